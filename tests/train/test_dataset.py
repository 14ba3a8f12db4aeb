import re
import shutil

import cv2
import numpy as np
import pytest
import torch

from autolights.core.errors import DataError
from autolights.data import load_image_dataset
from autolights.train.config import TrainConfig
from autolights.train.dataset import EpochOrder, ImageCache, TrainingSamples, Visit, batch_loader, collate, iterate

MIRRORS = np.array([0, -1])


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Six images with a bright light each, class 0 or 1 by turns."""
    root = tmp_path_factory.mktemp("images")
    for part in ("images/train", "labels/train"):
        (root / part).mkdir(parents=True)
    rng = np.random.default_rng(3)
    for i in range(6):
        image = rng.integers(0, 60, (80, 120, 3), dtype=np.uint8)
        image[30:60, 20 + 10 * i : 30 + 10 * i] = 255
        cv2.imwrite(str(root / f"images/train/{i}.png"), image)
        (root / f"labels/train/{i}.txt").write_text(f"{i % 2} {(25 + 10 * i) / 120} {45 / 80} {10 / 120} {30 / 80}")
    return load_image_dataset(root, "train", classes=["ball", "arrow"])


def config(images, **settings):
    return TrainConfig(data=str(images.root), **{"batch": 4, "workers": 0, "image_size": 96, **settings})


def samples_of(images, **settings):
    return TrainingSamples(images, MIRRORS, config(images, **settings))


@pytest.mark.parametrize(
    "settings",
    [{"augment": {"mosaic": 0.0}}, {"augment": {"mosaic": 1.0}}, {"crops": {"size": 64}}],
    ids=["whole", "mosaic", "crops"],
)
def test_labels_lie_on_lights(images, settings):
    settings = {**settings, "augment": {**settings.get("augment", {}), "rotate_deg": 0, "jitter": 0, "blur": 0}}
    samples = samples_of(images, **settings)
    side_px = 64 if "crops" in settings else 96

    seen = 0
    for position in range(30):
        sample = samples[Visit(1, position, position % 6)]
        assert sample.image_rgb.shape == (side_px, side_px, 3)
        for _, cx, cy, width, height in sample.labels:
            left, top = round((cx - width / 2) * side_px) + 1, round((cy - height / 2) * side_px) + 1
            right, bottom = round((cx + width / 2) * side_px) - 1, round((cy + height / 2) * side_px) - 1
            inside = sample.image_rgb[top:bottom, left:right]
            if inside.size:
                assert inside.mean() > 200
                seen += 1
    assert seen > 15


def test_arrows_are_never_mirrored(images):
    """The lights of images 0 and 1 lie left of the middle; only the ball's may be found on the right."""
    samples = samples_of(images, augment={"rotate_deg": 0, "scale": 0, "translate": 0, "flip": 1.0})

    ball, arrow = (samples[Visit(1, 0, index)].labels[0] for index in (0, 1))

    assert ball[1] == pytest.approx(1 - 25 / 120, abs=1e-6)
    assert arrow[1] == pytest.approx(35 / 120, abs=1e-6)


def test_a_sample_depends_on_its_visit_alone(images):
    first, second = samples_of(images), samples_of(images, cache_mb=0)
    first[Visit(1, 5, 2)]

    a, b = first[Visit(1, 7, 3)], second[Visit(1, 7, 3)]

    assert (a.image_rgb == b.image_rgb).all()
    assert (a.labels == b.labels).all()
    assert (a.image_rgb != first[Visit(2, 7, 3)].image_rgb).any()


def test_workers_make_the_same_batches(images):
    batches = []
    for workers in (0, 1):
        settings = config(images, workers=workers)
        order = EpochOrder(len(images), repeats=1, seed=0)
        order.epoch = 4
        batches.append(list(batch_loader(TrainingSamples(images, MIRRORS, settings), order, settings)))

    assert [batch.indices for batch in batches[0]] == [batch.indices for batch in batches[1]]
    assert all(torch.equal(a.images, b.images) for a, b in zip(*batches, strict=True))
    assert all(torch.equal(a.labels, b.labels) for a, b in zip(*batches, strict=True))


@pytest.mark.parametrize("workers", [0, 1])
def test_an_image_that_does_not_decode_is_named_in_one_line(images, workers, tmp_path):
    shutil.copytree(images.root, tmp_path, dirs_exist_ok=True)
    broken = tmp_path / "images/train/3.png"
    broken.write_bytes(b"not a picture")
    copied = load_image_dataset(tmp_path, "train", classes=["ball", "arrow"])
    settings = config(copied, workers=workers, cache_mb=0)
    loader = batch_loader(
        TrainingSamples(copied, MIRRORS, settings), EpochOrder(len(copied), repeats=1, seed=0), settings
    )

    with pytest.raises(DataError, match=f"^{re.escape(str(broken))}: not an image that can be decoded; [a-z ]+$"):
        list(iterate(loader))
    with pytest.raises(DataError, match=r"3\.png: not an image"):
        samples_of(copied)  # read at once into the cache


def test_each_epoch_visits_every_image_in_another_order():
    order = EpochOrder(5, repeats=3, seed=0)
    epochs = []
    for order.epoch in (1, 2):
        visits = list(order)
        assert [visit.position for visit in visits] == list(range(15))
        epochs.append([visit.index for visit in visits])

    assert sorted(epochs[0]) == sorted(epochs[1]) == sorted([*range(5)] * 3)
    assert epochs[0] != epochs[1]


def test_collate_numbers_the_images(images):
    samples = samples_of(images, augment={"rotate_deg": 0, "scale": 0, "translate": 0})

    batch = collate([samples[Visit(1, i, i)] for i in (4, 1)])

    assert batch.indices == (4, 1)
    assert batch.labels[:, :2].tolist() == [[0, 0], [1, 1]]
    pixels = batch.network_input(torch.device("cpu"))
    assert pixels.shape == (2, 3, 96, 96)
    assert pixels.is_contiguous(memory_format=torch.channels_last)
    assert pixels.min() >= 0
    assert 0.9 < pixels.max() <= 1
    torch.testing.assert_close(pixels[1, 2], batch.images[1, :, :, 2] / 255)


def test_cache_shrinks_to_the_long_side(images):
    cache = ImageCache(images, long_side_px=60, budget_mb=1)

    assert cache[0].shape == (40, 60, 3)
    assert cache[0] is cache[0]
