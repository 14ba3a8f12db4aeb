import numpy as np
import pytest

from autolights.core import load_signals
from autolights.core.errors import UsageError
from autolights.train.augment import PixelChanges, flip, may_flip, mirror_table
from autolights.train.config import AugmentConfig

RNG = np.random.default_rng(0)
IMAGE = RNG.integers(0, 256, (32, 48, 3), dtype=np.uint8)
IMAGE.flags.writeable = False


def test_same_random_numbers_same_pixels():
    changes = PixelChanges(AugmentConfig(blur=0.5, jitter=0.9))

    first, second = ([changes(IMAGE, np.random.default_rng(seed)) for seed in range(6)] for _ in range(2))

    assert all((a == b).all() for a, b in zip(first, second, strict=True))
    assert len({image.tobytes() for image in first}) > 3


def test_hue_hardly_moves():
    """Pure red must not become amber, whatever the draw."""
    red = np.tile(np.array([220, 20, 20], np.uint8), (8, 8, 1))
    changes = PixelChanges(AugmentConfig(blur=0, jitter=1.0))

    for seed in range(40):
        r, g, b = changes(red, np.random.default_rng(seed)).reshape(-1, 3).mean(axis=0)
        assert abs(g - b) < 0.08 * r


def test_mirror_classes_of_the_papers_signals():
    signals = load_signals()
    mirrors = mirror_table(signals.classes, signals, {})

    assert mirrors[signals.class_ids["3-red"]] == signals.class_ids["3-red"]
    assert mirrors[signals.class_ids["4-gleft"]] == -1
    assert may_flip(np.array([0, 1, 2]), mirrors)
    assert not may_flip(np.array([0, signals.class_ids["4-gleft"]]), mirrors)
    assert may_flip(np.empty(0, dtype=np.int64), mirrors)


def test_a_flip_swaps_left_and_right():
    mirrors = mirror_table(["left", "right", "ball"], None, {"left": "right", "right": "left", "ball": "ball"})
    boxes = np.array([[2.0, 3, 10, 9], [20, 0, 48, 32]])

    image, flipped, ids = flip(IMAGE, boxes, np.array([0, 2]), mirrors)

    assert (image == IMAGE[:, ::-1]).all()
    assert flipped.tolist() == [[38, 3, 46, 9], [0, 0, 28, 32]]
    assert ids.tolist() == [1, 2]


def test_mirrors_must_fit_the_classes():
    with pytest.raises(UsageError, match="mirrors names the class 'lift', which is none of"):
        mirror_table(["left", "right"], None, {"left": "lift"})
    with pytest.raises(UsageError, match="signals 'autolights_13' describes the classes"):
        mirror_table(["red"], load_signals(), {})
