"""When it says something that a light was not detected."""

import math

import numpy as np

from autolights.core import BoolArray, FloatArray

_HIDDEN_SHARE = 0.25  # of a box, from which on its light may be missed whatever it shows


def behind_mask(boxes_xyxy: FloatArray, occlusion: BoolArray, size_wh: tuple[int, int]) -> BoolArray:
    """Whether a mask hides a quarter of lights or more.

    Args:
        boxes_xyxy: (n, 4) pixels of the image; what lies outside of it is left aside.
        occlusion: (h, w) of the whole image, in any resolution.
        size_wh: Of the image.

    Returns:
        (n,).
    """
    height, width = occlusion.shape
    edges = boxes_xyxy * (np.array([width, height] * 2) / (*size_wh, *size_wh))
    return np.array([_hidden_share(occlusion, *box) >= _HIDDEN_SHARE for box in edges.tolist()], dtype=bool)


def _hidden_share(occlusion: BoolArray, left: float, top: float, right: float, bottom: float) -> float:
    """Of a box in cells of the mask, as far as it lies on it; 0 beyond."""
    rows, down = _overlaps(top, bottom, occlusion.shape[0])
    columns, across = _overlaps(left, right, occlusion.shape[1])
    area = down.sum() * across.sum()
    return float(down @ occlusion[rows, columns] @ across / area) if area > 0 else 0.0


def _overlaps(low: float, high: float, count: int) -> tuple[slice, FloatArray]:
    """Which of so many cells an interval touches, and the length of it in each."""
    first, end = max(math.floor(low), 0), min(math.ceil(high), count)
    cells = np.arange(first, max(first, end))
    return slice(first, max(first, end)), np.minimum(high, cells + 1) - np.maximum(low, cells)


def in_plain_view(
    expected_xyxy: FloatArray, detected_xyxy: FloatArray, *, min_height_px: float, together: BoolArray | None = None
) -> BoolArray:
    """Whether lights should have been seen: large enough, and nothing detected where they hang.

    What is detected there may hide the light, or be the light itself, taken for something else.

    Args:
        expected_xyxy: (n, 4) pixels: boxes of known lights within the image and the camera's range, not detected.
        detected_xyxy: (m, 4) pixels of all detections.
        min_height_px: Smaller ones are missed whatever they show.
        together: (n, m) whether both lie in one image; None if all do.

    Returns:
        (n,).
    """
    tall = expected_xyxy[:, 3] - expected_xyxy[:, 1] >= min_height_px
    left, top, right, bottom = expected_xyxy.T[:, :, None]
    seen_left, seen_top, seen_right, seen_bottom = detected_xyxy.T
    across = np.minimum(right, seen_right) > np.maximum(left, seen_left)
    touched = across & (np.minimum(bottom, seen_bottom) > np.maximum(top, seen_top))
    if together is not None:
        touched &= together
    return np.asarray(tall & ~touched.any(axis=1))
