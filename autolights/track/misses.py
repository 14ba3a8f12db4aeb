"""When it says something that a light was not detected."""

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
    scale = np.array([width, height] * 2) / (*size_wh, *size_wh)
    lows, highs = np.hsplit(boxes_xyxy * scale, 2)
    edges = np.hstack([np.floor(lows), np.ceil(highs)]).clip(0, [width, height] * 2).astype(np.int64)
    parts = [occlusion[top:bottom, left:right] for left, top, right, bottom in edges.tolist()]
    return np.array([part.size > 0 and part.mean() >= _HIDDEN_SHARE for part in parts], dtype=bool)


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
