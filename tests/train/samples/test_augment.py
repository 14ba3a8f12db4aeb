import albumentations
import cv2
import numpy as np
import pytest

from autolights.core import load_signals
from autolights.core.errors import UsageError
from autolights.train.config import AugmentConfig
from autolights.train.samples.augment import PixelChanges, colour_matrix, may_flip, mirror_boxes, mirror_table

RNG = np.random.default_rng(0)
IMAGE = RNG.integers(0, 256, (32, 48, 3), dtype=np.uint8)
IMAGE.flags.writeable = False


def test_same_random_numbers_same_pixels():
    changes = PixelChanges(AugmentConfig(blur=0.5, jitter=0.9))

    first, second = ([changes(IMAGE, np.random.default_rng(seed)) for seed in range(6)] for _ in range(2))

    assert all((a == b).all() for a, b in zip(first, second, strict=True))
    assert len({image.tobytes() for image in first}) > 3


def test_nothing_drawn_nothing_changed():
    assert PixelChanges(AugmentConfig(blur=0, jitter=0))(IMAGE, np.random.default_rng(0)) is IMAGE


@pytest.mark.parametrize("change", [{"brightness": 0.8}, {"contrast": 1.2}, {"saturation": 1.25}, {"saturation": 0}])
def test_one_matrix_does_what_colour_jitter_does(change):
    """Against albumentations' own, where nothing is clipped."""
    image = RNG.integers(90, 150, (32, 48, 3), dtype=np.uint8)
    settings = {"brightness": 1.0, "contrast": 1.0, "saturation": 1.0, "hue": 0.0, **change}
    expected = albumentations.ColorJitter(p=1).apply(image, **settings, order=[0, 1, 2, 3])

    matrix = colour_matrix(**settings, mean_rgb=image.reshape(-1, 3).mean(axis=0))

    np.testing.assert_allclose(cv2.transform(image, matrix), expected.astype(float), atol=1.01)


def test_the_hue_turns_by_what_was_asked_and_the_luma_stays():
    image = RNG.integers(100, 130, (8, 8, 3), dtype=np.uint8).astype(np.float32) / 255
    matrix = colour_matrix(brightness=1, contrast=1, saturation=1, hue=1 / 3, mean_rgb=np.zeros(3))

    thrice = image
    for _ in range(3):
        thrice = cv2.transform(thrice, matrix)

    np.testing.assert_allclose(thrice, image, atol=1e-6)
    turned = cv2.transform(image, matrix)
    assert np.abs(turned - image).max() > 0.01
    np.testing.assert_allclose(
        cv2.cvtColor(turned, cv2.COLOR_RGB2GRAY), cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), atol=1e-3
    )


def hue_of(colours_rgb, hue):
    """Degrees, of (n, 3) colours, once they are shifted by a hue."""
    matrix = colour_matrix(brightness=1, contrast=1, saturation=1, hue=hue, mean_rgb=np.zeros(3))
    shifted = np.clip(cv2.transform(colours_rgb[None].astype(np.float32) / 255, matrix), 0, 1)
    degrees = cv2.cvtColor(shifted, cv2.COLOR_RGB2HSV)[0, :, 0]
    return (degrees + 180) % 360 - 180


def test_no_hue_that_can_be_set_turns_amber_into_red_or_green():
    """ECE R37 lamp colours: red 0 to 15 degrees, amber 30 to 50, green beyond 120; with grey mixed in."""
    limit = AugmentConfig.model_fields["hue"].metadata
    largest = next(bound.le for bound in limit if hasattr(bound, "le"))
    red, amber, green = (
        np.array([np.array(colour) * share + 60 * (1 - share) for colour in colours for share in (1, 0.8, 0.5)])
        for colours in (
            [(255, 0, 0), (255, 60, 10), (220, 30, 20)],
            [(255, 150, 0), (255, 190, 30), (240, 170, 60)],
            [(0, 230, 120), (60, 255, 190)],
        )
    )

    assert (hue_of(red, largest) > hue_of(red, 0)).all()
    assert hue_of(red, largest).max() < hue_of(amber, -largest).min()
    assert hue_of(amber, largest).max() < hue_of(green, -largest).min()
    with pytest.raises(ValueError, match="hue"):
        AugmentConfig(hue=largest + 0.01)


def test_mirror_classes_of_the_papers_signals():
    signals = load_signals()
    mirrors = mirror_table(signals.classes, signals, {})

    assert mirrors[signals.class_ids["3-red"]] == signals.class_ids["3-red"]
    assert mirrors[signals.class_ids["4-gleft"]] == -1
    assert may_flip(np.array([0, 1, 2]), mirrors)
    assert not may_flip(np.array([0, signals.class_ids["4-gleft"]]), mirrors)
    assert may_flip(np.empty(0, dtype=np.int64), mirrors)


def test_boxes_in_a_mirror():
    boxes = np.array([[2.0, 3, 10, 9], [20, 0, 48, 32]])

    assert mirror_boxes(boxes, 48).tolist() == [[38, 3, 46, 9], [0, 0, 28, 32]]


def test_mirrors_must_fit_the_classes():
    with pytest.raises(UsageError, match="mirrors names the class 'lift', which is none of"):
        mirror_table(["left", "right"], None, {"left": "lift"})
    with pytest.raises(UsageError, match="signals 'autolights_13' describes the classes"):
        mirror_table(["red"], load_signals(), {})
