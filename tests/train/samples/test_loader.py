import re

import cv2
import numpy as np
import pytest
import torch

from autolights.core.errors import DataError
from autolights.data import load_image_dataset
from autolights.train.config import TrainConfig
from autolights.train.processes import ALONE, Processes
from autolights.train.samples.dataset import TrainingSamples
from autolights.train.samples.loader import BatchLoader, EpochOrder

SQUARES = np.full((7, 2), 96)


@pytest.fixture
def images(tmp_path):
    """Six small images with a label each."""
    for part in ("images/train", "labels/train"):
        (tmp_path / part).mkdir(parents=True)
    rng = np.random.default_rng(3)
    for i in range(6):
        shape = (30 + 10 * (i % 2), 60, 3)
        cv2.imwrite(str(tmp_path / f"images/train/{i}.png"), rng.integers(0, 255, shape, dtype=np.uint8))
        (tmp_path / f"labels/train/{i}.txt").write_text(f"{i % 2} 0.5 0.5 0.4 0.4")
    return load_image_dataset(tmp_path, "train", classes=["ball", "arrow"])


def loader_of(images, processes=ALONE, **settings):
    config = TrainConfig(data=str(images.root), **{"batch": 4, "workers": 0, "image_size": 64, **settings})
    return BatchLoader(TrainingSamples(images, np.array([0, -1]), config), config, processes)


def visits_of(*, size=1, epoch=1, **settings):
    """Each process's batches of (position, index)."""
    batches = []
    for rank in range(size):
        order = EpochOrder(
            SQUARES, **{"repeats": 1, "seed": 0, "batch": 4, **settings}, processes=Processes(rank, size)
        )
        order.epoch = epoch
        batches.append([[(visit.position, visit.index) for visit in visits] for visits in order])
        assert len(order) == len(batches[-1])
    return batches


def test_each_epoch_visits_every_image_in_another_order():
    epochs = []
    for epoch in (1, 2):
        (batches,) = visits_of(repeats=3, epoch=epoch)
        assert [position for batch in batches for position, _ in batch] == list(range(21))
        epochs.append([index for batch in batches for _, index in batch])

    assert sorted(epochs[0]) == sorted(epochs[1]) == sorted([*range(7)] * 3)
    assert epochs[0] != epochs[1]


def test_processes_share_the_batches_of_one():
    (alone,) = visits_of()
    first, second = visits_of(size=2)

    assert [len(batch) for batch in alone] == [4, 3]
    assert [sorted(a + b) for a, b in zip(first, second, strict=True)] == [alone[0], alone[1][:2]]
    assert [len(batch) for batch in first] == [len(batch) for batch in second] == [2, 1]


def test_a_last_batch_with_less_than_an_image_for_each_process_is_left_out():
    batches = visits_of(size=3, batch=6)

    assert [[len(batch) for batch in share] for share in batches] == [[2], [2], [2]]


def test_images_of_one_shape_come_together():
    shapes = np.array([[96, 64], [64, 96]])
    canvases_wh = shapes[[0, 1, 0, 0, 1, 0, 1, 0, 0, 1, 0]]  # seven wide, four high
    order = EpochOrder(canvases_wh, repeats=1, seed=0, batch=2)
    seen = []
    for order.epoch in range(1, 30):
        batches = list(order)
        asked = [[tuple(canvases_wh[visit.index].tolist()) for visit in batch] for batch in batches]
        for of, batch in zip(asked, batches, strict=True):
            assert {visit.canvas_wh for visit in batch} == {tuple(np.max(of, axis=0).tolist())}
        assert sum(len(set(of)) > 1 for of in asked) <= 1
        assert sorted(visit.index for batch in batches for visit in batch) == list(range(11))
        seen.append(asked[0][0])

    assert set(seen) == {(96, 64), (64, 96)}  # not always the same shape first


@pytest.mark.parametrize("rectangular", [False, True])
def test_workers_and_processes_make_the_same_batches(images, rectangular):
    """Compared one by one: a worker uses its memory again."""
    settings = {"rectangular": rectangular, "batch": 2}
    alone, worker = (loader_of(images, workers=workers, **settings) for workers in (0, 1))
    halves = [loader_of(images, Processes(rank, 2), workers=1, **settings) for rank in range(2)]

    assert len(alone) == len(worker) == len(halves[0]) == 3
    for epoch in (4, 5):
        for batch, same, *shares in zip(*(loader.epoch(epoch) for loader in (alone, worker, *halves)), strict=True):
            assert batch.indices == same.indices
            assert torch.equal(batch.images, same.images)
            assert torch.equal(batch.labels, same.labels)
            for rank, share in enumerate(shares):
                assert torch.equal(batch.images[rank::2], share.images)


def test_labels_are_numbered_by_image(images):
    settings = {"rotate_deg": 0, "scale": 0, "translate": 0, "flip": 0, "jitter": 0, "blur": 0}
    batch = next(loader_of(images, augment=settings).epoch(1))

    assert batch.labels.dtype == torch.float32
    assert batch.labels[:, :2].tolist() == [[i, index % 2] for i, index in enumerate(batch.indices)]
    pixels = batch.network_input(torch.device("cpu"))
    assert pixels.shape == (4, 3, 64, 64)
    assert pixels.is_contiguous(memory_format=torch.channels_last)
    torch.testing.assert_close(pixels[1, 2], batch.images[1, :, :, 2] / 255)


@pytest.mark.parametrize("workers", [0, 1])
def test_an_image_that_breaks_later_is_named_in_one_line(images, workers):
    loader = loader_of(images, workers=workers, cache_mb=0)
    broken = images.image_paths[3]
    broken.write_bytes(b"not a picture")

    with pytest.raises(DataError, match=f"^{re.escape(str(broken))}: not an image that can be decoded; [a-z ]+$"):
        list(loader.epoch(1))
