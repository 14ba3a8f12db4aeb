"""Random changes of a training sample's pixels, and its mirror image.

The only place that knows albumentations. Version 2.0.8 is its last release under MIT.
"""

import os
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from autolights.core.arrays import FloatArray, ImageArray, IntArray
from autolights.core.errors import UsageError
from autolights.core.signals import SignalSet
from autolights.train.config import AugmentConfig

os.environ["NO_ALBUMENTATIONS_UPDATE"] = "1"  # else it asks the network for a newer version when imported
from albumentations.augmentations.blur import functional as blurs
from albumentations.augmentations.pixel import functional as pixels

_NO_MIRROR = -1
# NTSC; the first row is the luma of ITU-R BT.601, which OpenCV's grey is too.
_YIQ_FROM_RGB = np.array([[0.299, 0.587, 0.114], [0.5959, -0.2746, -0.3213], [0.2115, -0.5227, 0.3112]])
_RGB_FROM_YIQ = np.linalg.inv(_YIQ_FROM_RGB)


class PixelChanges:
    """Gaussian blur and colour jitter, the same for the same random numbers.

    The random numbers are drawn here; albumentations' own pipeline takes longer to draw them than to change the pixels.
    """

    def __init__(self, config: AugmentConfig) -> None:
        self._config = config

    def __call__(self, image_rgb: ImageArray, rng: np.random.Generator) -> ImageArray:
        """Change an (H, W, 3) RGB image; the given one stays as it is, and comes back if nothing was drawn."""
        config = self._config
        if rng.random() < config.blur:
            kernel = blurs.create_gaussian_kernel_1d(rng.uniform(*config.blur_sigma_px), 0)
            image_rgb = pixels.separable_convolve(image_rgb, kernel)
        if rng.random() < config.jitter:
            matrix = colour_matrix(
                brightness=rng.uniform(1 - config.brightness, 1 + config.brightness),
                contrast=rng.uniform(1 - config.contrast, 1 + config.contrast),
                saturation=rng.uniform(1 - config.saturation, 1 + config.saturation),
                hue=rng.uniform(-config.hue, config.hue),
                mean_rgb=np.array(cv2.mean(image_rgb)[:3]),
            )
            image_rgb = pixels.linear_transformation_rgb(image_rgb, matrix)
        return image_rgb


def colour_matrix(
    *, brightness: float, contrast: float, saturation: float, hue: float, mean_rgb: FloatArray
) -> FloatArray:
    """All of a colour jitter as one affine map of colours, so that it costs one pass over the pixels.

    Brightness, contrast and saturation are those of torchvision's and albumentations' ``ColorJitter``, which round and
    clip after each. Hue turns about the grey axis instead of around the HSV cone: luma stays, and there is no way
    through another colour space.

    Args:
        brightness: Factor of the colours.
        contrast: Factor of their distance to the picture's mean luma.
        saturation: Factor of their distance to their own luma.
        hue: Share of a whole turn.
        mean_rgb: (3,) of the picture.

    Returns:
        (3, 4) matrix that takes (red, green, blue, 1) to the new colour.
    """
    angle = 2 * np.pi * hue
    turn_yiq = np.array([[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]])
    luma = _YIQ_FROM_RGB[0]
    vivid = saturation * np.eye(3) + (1 - saturation) * luma
    # Neither the turn nor the saturation changes luma; that is why the mean's is the old one, made brighter.
    linear = brightness * vivid @ _RGB_FROM_YIQ @ turn_yiq @ _YIQ_FROM_RGB
    mean_luma = brightness * luma @ mean_rgb
    return np.column_stack([contrast * linear, np.full(3, (1 - contrast) * mean_luma)])


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


def may_turn_over(class_ids_in_view: IntArray, mirrors: IntArray) -> bool:
    """Whether each class in view is its own mirror class, as balls are; arrows that point left or right never are."""
    return bool((mirrors[class_ids_in_view] == class_ids_in_view).all())


def mirror_boxes(boxes_xyxy: FloatArray, canvas_side_px: int, axis: int = 0) -> FloatArray:
    """(n, 4) boxes as a mirror shows them: axis 0 left to right, 1 upside down."""
    mirrored = boxes_xyxy.copy()
    mirrored[:, [axis, axis + 2]] = canvas_side_px - boxes_xyxy[:, [axis + 2, axis]]
    return mirrored
