"""Random changes of a training sample's pixels, and its mirror image.

The only place that knows albumentations. Version 2.0.8 is its last release under MIT.
"""

import os
from collections.abc import Mapping, Sequence

import numpy as np

from autolights.core.arrays import FloatArray, ImageArray, IntArray
from autolights.core.errors import UsageError
from autolights.core.signals import SignalSet
from autolights.train.config import AugmentConfig

os.environ["NO_ALBUMENTATIONS_UPDATE"] = "1"  # else it asks the network for a newer version when imported
import albumentations

_NO_MIRROR = -1


class PixelChanges:
    """Gaussian blur and colour jitter, the same for the same random numbers."""

    def __init__(self, config: AugmentConfig) -> None:
        self._compose = albumentations.Compose(
            [
                albumentations.GaussianBlur(blur_limit=0, sigma_limit=config.blur_sigma_px, p=config.blur),
                albumentations.ColorJitter(
                    brightness=(1 - config.brightness, 1 + config.brightness),
                    contrast=(1 - config.contrast, 1 + config.contrast),
                    saturation=(1 - config.saturation, 1 + config.saturation),
                    hue=(-config.hue, config.hue),
                    p=config.jitter,
                ),
            ]
        )

    def __call__(self, image_rgb: ImageArray, rng: np.random.Generator) -> ImageArray:
        """Change an (H, W, 3) RGB image; the given one stays as it is."""
        self._compose.set_random_seed(int(rng.integers(2**31)))
        changed: ImageArray = self._compose(image=image_rgb)["image"]
        return changed


def mirror_table(classes: Sequence[str], signals: SignalSet | None, mirrors: Mapping[str, str]) -> IntArray:
    """For each class the index of its mirror class, −1 for none.

    Args:
        classes: Names.
        signals: A description of just these classes, or None.
        mirrors: Class → mirror class by name, in place of a description.

    Raises:
        UsageError: If the description has other classes, or `mirrors` names an unknown class.
    """
    if signals is not None:
        if signals.classes != tuple(classes):
            raise UsageError(
                f"signals '{signals.name}' describes the classes {list(signals.classes)}, the data {list(classes)}"
            )
        return np.array([_NO_MIRROR if mirror is None else mirror for mirror in signals.mirror_ids()])
    unknown = [name for name in (*mirrors, *mirrors.values()) if name not in classes]
    if unknown:
        raise UsageError(f"mirrors names the class '{unknown[0]}', which is none of {list(classes)}")
    return np.array([classes.index(mirrors[name]) if name in mirrors else _NO_MIRROR for name in classes])


def may_flip(class_ids_in_view: IntArray, mirrors: IntArray) -> bool:
    """Whether each class in view is still a class when it is seen in a mirror."""
    return bool((mirrors[class_ids_in_view] != _NO_MIRROR).all())


def flip(
    image: ImageArray, boxes_xyxy: FloatArray, class_ids: IntArray, mirrors: IntArray
) -> tuple[ImageArray, FloatArray, IntArray]:
    """Mirror an image left to right, with its (n, 4) boxes in pixels and their classes."""
    width = image.shape[1]
    flipped = boxes_xyxy.copy()
    flipped[:, [0, 2]] = width - boxes_xyxy[:, [2, 0]]
    return np.ascontiguousarray(image[:, ::-1]), flipped, mirrors[class_ids]
