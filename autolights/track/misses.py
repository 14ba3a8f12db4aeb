"""When it says something that a light was not detected."""

import numpy as np

from autolights.core import BoolArray, FloatArray


def in_plain_view(expected_xyxy: FloatArray, detected_xyxy: FloatArray, *, min_height_px: float) -> BoolArray:
    """Whether lights should have been seen: large enough, and nothing detected where they hang.

    What is detected there may hide the light, or be the light itself, taken for something else.

    Args:
        expected_xyxy: (n, 4) pixels: boxes of known lights within the image and the camera's range, not detected.
        detected_xyxy: (m, 4) pixels of all detections.
        min_height_px: Smaller ones are missed whatever they show.

    Returns:
        (n,).
    """
    tall = expected_xyxy[:, 3] - expected_xyxy[:, 1] >= min_height_px
    lows = np.maximum(expected_xyxy[:, None, :2], detected_xyxy[None, :, :2])
    highs = np.minimum(expected_xyxy[:, None, 2:], detected_xyxy[None, :, 2:])
    touched = np.all(highs > lows, axis=2)
    return np.asarray(tall & ~touched.any(axis=1))
