"""Frames of a video file or of a camera, going on over those that do not decode."""

import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from autolights.core import ImageArray

_GIVE_UP_AFTER = 30  # failures in a row; the decoder of a damaged file may find its way again sooner
_CAMERA_PATIENCE_S = 3.0
_CAMERA_PAUSE_S = 0.02


def frame_count(path: Path) -> int:
    """What the header of a video says; 0 if it does not say or the file is no video."""
    video = cv2.VideoCapture(str(path))
    try:
        return max(int(video.get(cv2.CAP_PROP_FRAME_COUNT)), 0)
    finally:
        video.release()


def video_frames(path: Path) -> Iterator[ImageArray | None]:
    """Frames of a file in their order; None for one that does not decode though a later one does."""
    video = cv2.VideoCapture(str(path))
    try:
        failures = 0
        while failures < _GIVE_UP_AFTER:
            image = _next(video)
            if image is None:
                failures += 1
                continue
            for _ in range(failures):
                yield None
            failures = 0
            yield image
    finally:
        video.release()


def camera_frames(index: int) -> Iterator[ImageArray | None]:
    """Frames of a camera for as long as it gives any; None for one that fails.

    It ends when the camera has given nothing for three seconds.
    """
    video = cv2.VideoCapture(index)
    try:
        last = time.monotonic()
        while time.monotonic() - last < _CAMERA_PATIENCE_S and video.isOpened():
            image = _next(video)
            if image is None:
                time.sleep(_CAMERA_PAUSE_S)
            else:
                last = time.monotonic()
            yield image
    finally:
        video.release()


def _next(video: cv2.VideoCapture) -> ImageArray | None:
    there, image = video.read()
    return np.asarray(image, dtype=np.uint8) if there and image is not None and image.size else None
