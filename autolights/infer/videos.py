"""Frames of a video file or of a camera, going on over those that do not decode."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from autolights.core import ImageArray

# Failures in a row: a decoder that lost its way goes on at the next key frame, which may be hundreds of frames away.
# Behind the end of a file so many attempts take 30 ms.
_GIVE_UP_AFTER = 1000
_CAMERA_PATIENCE_S = 10.0
_CAMERA_REOPEN_AFTER_S = 1.0  # one that was unplugged comes back as another device
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


def camera_frames(index: int, stop: threading.Event) -> Iterator[ImageArray | None]:
    """Frames of a camera until it is told to stop; None for a gap, however long, that a later frame ends.

    A camera that falls silent is opened again. When it has given nothing for ten seconds, or cannot be opened to begin
    with, the frames end although `stop` is not set.
    """
    video = cv2.VideoCapture(index)
    try:
        if not video.isOpened():
            return
        heard = opened = time.monotonic()
        gap = False
        while not stop.is_set():
            image = _next(video)
            now = time.monotonic()
            if image is not None:
                if gap:
                    yield None
                yield image
                heard, gap = time.monotonic(), False  # the time that the caller took is not the camera's
                continue
            gap = True
            if now - heard > _CAMERA_PATIENCE_S:
                return
            if now - max(heard, opened) > _CAMERA_REOPEN_AFTER_S:
                video.release()
                video.open(index)
                opened = time.monotonic()
            time.sleep(_CAMERA_PAUSE_S)
    finally:
        video.release()


def _next(video: cv2.VideoCapture) -> ImageArray | None:
    there, image = video.read()
    return np.asarray(image, dtype=np.uint8) if there and image is not None and image.size else None
