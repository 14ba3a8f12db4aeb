import re

import cv2
import numpy as np
import pytest

from autolights.core.errors import DataError
from autolights.data import load_image_dataset
from autolights.train.samples.image_cache import ImageCache

SIZE_WH = (120, 80)
BYTES = 60 * 40 * 3  # of an image that was shrunk to a long side of 60 px


@pytest.fixture
def images(tmp_path):
    """Four images, each of one grey but for its blue."""
    for part in ("images/train", "labels/train"):
        (tmp_path / part).mkdir(parents=True)
    for i in range(4):
        write(tmp_path / f"images/train/{i}.png", i)
        (tmp_path / f"labels/train/{i}.txt").write_text("")
    return load_image_dataset(tmp_path, "train", classes=["ball"])


def write(path, value):
    cv2.imwrite(str(path), np.full((SIZE_WH[1], SIZE_WH[0], 3), (200, value, value), np.uint8))


def colours(cache):
    return [cache[i][0, 0].tolist() for i in range(len(cache.images))]


@pytest.fixture
def read_count(images, monkeypatch):
    """How many images have been decoded so far."""
    reads = []
    read = type(images).read
    monkeypatch.setattr(type(images), "read", lambda self, index: reads.append(index) or read(self, index))
    return lambda: len(reads)


@pytest.mark.parametrize("on_disk", [False, True])
@pytest.mark.parametrize("budget_mb", [0, 1])
def test_images_are_shrunk_to_the_long_side_whatever_the_budget(images, tmp_path, on_disk, budget_mb):
    cache = ImageCache(images, long_side_px=60, budget_mb=budget_mb, folder=tmp_path / "cache" if on_disk else None)

    assert cache.sizes_wh.tolist() == [[60, 40]] * 4
    assert cache[3].shape == (40, 60, 3)
    assert colours(cache) == [[i, i, 200] for i in range(4)]


def test_the_budget_bounds_what_is_kept(images, read_count):
    cache = ImageCache(images, long_side_px=600, budget_mb=2)  # 0.72 MB each: two fit
    before = read_count()

    colours(cache)

    assert read_count() - before == 2


def test_a_second_run_reads_the_file_until_an_image_changes(images, tmp_path, read_count):
    folder = tmp_path / "cache"

    def cached():
        before = read_count()
        cache = ImageCache(images, long_side_px=60, budget_mb=1, folder=folder)
        return colours(cache), read_count() - before

    assert cached() == ([[i, i, 200] for i in range(4)], 4)
    assert cached() == ([[i, i, 200] for i in range(4)], 0)
    write(images.image_paths[2], 77)
    assert cached() == ([[i, i, 200] for i in (0, 1, 77, 3)], 4)
    assert cached()[1] == 0
    assert len(list(folder.glob("*.pixels"))) == 1


def test_a_pixel_file_that_was_cut_is_written_again(images, tmp_path):
    folder = tmp_path / "cache"
    ImageCache(images, long_side_px=60, budget_mb=1, folder=folder)
    (file,) = folder.glob("*.pixels")
    file.write_bytes(file.read_bytes()[: 2 * BYTES])

    assert colours(ImageCache(images, long_side_px=60, budget_mb=1, folder=folder)) == [[i, i, 200] for i in range(4)]


@pytest.mark.parametrize("on_disk", [False, True])
def test_bad_images_are_left_out_and_named_each_time(images, tmp_path, capsys, on_disk):
    images.image_paths[1].write_bytes(b"not a picture")
    whole = images.image_paths[3].read_bytes()
    images.image_paths[3].write_bytes(whole[: len(whole) // 2])
    folder = tmp_path / "cache" if on_disk else None

    for _ in range(2):
        cache = ImageCache(images, long_side_px=60, budget_mb=1, folder=folder, bad_share=0.5)
        assert colours(cache) == [[0, 0, 200], [2, 2, 200]]
        assert cache.sizes_wh.tolist() == [[60, 40]] * 2
        said = capsys.readouterr().err
        assert re.search(r"2 of 4 images cannot be used \(.*1\.png: .*3\.png: .*\); left out", said)
    with pytest.raises(DataError, match=r"2 of 4 images cannot be used .*bad_images=0\.49 is the largest share"):
        ImageCache(images, long_side_px=60, budget_mb=1, folder=folder, bad_share=0.49)
