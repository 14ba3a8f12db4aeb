import cv2
import numpy as np
import pytest

from autolights.core.errors import DataError
from autolights.data import load_image_dataset
from autolights.train.image_cache import ImageCache

BLUE_BGR = (200, 10, 10)


@pytest.fixture
def images(tmp_path):
    for part in ("images/train", "labels/train"):
        (tmp_path / part).mkdir(parents=True)
    for i in range(4):
        cv2.imwrite(str(tmp_path / f"images/train/{i}.png"), np.full((80, 120, 3), BLUE_BGR, np.uint8))
        (tmp_path / f"labels/train/{i}.txt").write_text("")
    return load_image_dataset(tmp_path, "train", classes=["ball"])


def test_cache_shrinks_to_the_long_side(images):
    cache = ImageCache(images, long_side_px=60, budget_mb=1)

    assert cache[0].shape == (40, 60, 3)
    assert cache[0][0, 0].tolist() == list(reversed(BLUE_BGR))
    assert cache[0] is cache[0]


def test_an_image_that_does_not_decode_is_named(images):
    images.image_paths[3].write_bytes(b"not a picture")

    with pytest.raises(DataError, match=r"3\.png: not an image"):
        ImageCache(images, long_side_px=60, budget_mb=1)
