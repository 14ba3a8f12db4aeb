"""How each camera moves: what an error of its images' stamps would look like.

Speed and turn are taken between the two images before, not up to the image itself: the error of its own pose would be
in both, and noise of the poses would pass for a delay of half the time between images.
"""

from typing import Any, NamedTuple, Self

import numpy as np

from autolights.core import FloatArray
from autolights.core.shots import Shots

_LEAST_GAP_S, _MAX_GAP_S = 0.01, 0.5  # between images of a camera from whose poses speed and turn are taken


class Stand(NamedTuple):
    """Where a camera's image was taken.

    Attributes:
        stamp_ns: Of the image.
        lens: (3,) metres.
        cam_from_utm: (3, 3) rotation.
    """

    stamp_ns: int
    lens: FloatArray
    cam_from_utm: FloatArray

    @classmethod
    def of(cls, shots: Shots, image: int) -> Self:
        """Of one image of a set."""
        return cls(shots.poses[image].stamp_ns, shots.lens[image], shots.cam_from_utm[image])


class CameraMotion:
    """The latest two images of each camera.

    Args:
        cameras: How many.
    """

    def __init__(self, cameras: int) -> None:
        self._stands: list[tuple[Stand, ...]] = [()] * cameras

    def follow(self, shots: Shots, numbers: list[int]) -> list[tuple[Stand, ...]]:
        """Take in the images of a set; returns of each the camera's images before, at most two, the older first."""
        before = [self._stands[number] for number in numbers]
        for image, number in enumerate(numbers):
            self._stands[number] = *before[image][-1:], Stand.of(shots, image)
        return before

    def to_json(self) -> list[Any]:
        """All that is remembered, as JSON-ready values."""
        return [
            [[stand.stamp_ns, stand.lens.tolist(), stand.cam_from_utm.tolist()] for stand in stands]
            for stands in self._stands
        ]

    def restore(self, values: list[Any]) -> None:
        """Go on from where `to_json` left off, with the same cameras."""
        self._stands = [
            tuple(Stand(int(stamp_ns), np.array(lens), np.array(rotation)) for stamp_ns, lens, rotation in stands)
            for stands in values
        ]


def rates(before: list[tuple[Stand, ...]], shots: Shots) -> tuple[FloatArray, FloatArray]:
    """Speed and turn of cameras, as they were just before images.

    Args:
        before: Of each image, the same camera's images before (`CameraMotion.follow`).
        shots: The s images.

    Returns:
        (s, 3) metres per second of the lens in the map frame, and (s, 3) radians per second about the camera's axes;
        zeros where there are no two images before, or none that are near enough in time.
    """
    velocities, turns = np.zeros((2, len(shots), 3))
    for image, stands in enumerate(before):
        if len(stands) < 2:
            continue
        first, last = stands
        elapsed_s, since_s = (last.stamp_ns - first.stamp_ns) / 1e9, (shots.poses[image].stamp_ns - last.stamp_ns) / 1e9
        if _LEAST_GAP_S <= elapsed_s <= _MAX_GAP_S and 0 <= since_s <= _MAX_GAP_S:
            velocities[image] = (last.lens - first.lens) / elapsed_s
            # Of a camera that turns by a small angle w, C C'ᵀ = I − [w]×.
            turn = last.cam_from_utm @ first.cam_from_utm.T
            turns[image] = (turn - turn.T)[[1, 2, 0], [2, 0, 1]] / (2 * elapsed_s)
    return velocities, turns
