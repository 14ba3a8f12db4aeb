"""How the vehicle moves at each camera's images: what an error of their stamps would look like."""

from typing import Any, NamedTuple, Self

import numpy as np

from autolights.core import FloatArray
from autolights.core.shots import Shots

_MAX_GAP_S = 0.5  # between images of a camera from whose poses speed and turn are taken


class Stand(NamedTuple):
    """Where a camera's image was taken.

    Attributes:
        stamp_ns: Of the image.
        vehicle: (3,) metres.
        cam_from_utm: (3, 3) rotation.
    """

    stamp_ns: int
    vehicle: FloatArray
    cam_from_utm: FloatArray

    @classmethod
    def of(cls, shots: Shots, image: int) -> Self:
        """Of one image of a set."""
        return cls(shots.poses[image].stamp_ns, shots.vehicle[image], shots.cam_from_utm[image])


class CameraMotion:
    """The latest image of each camera.

    Args:
        cameras: How many.
    """

    def __init__(self, cameras: int) -> None:
        self._stands: list[Stand | None] = [None] * cameras

    def follow(self, shots: Shots, numbers: list[int]) -> list[Stand | None]:
        """Take in the images of a set; returns what stood in the place of each: the camera's image before."""
        before = [self._stands[number] for number in numbers]
        for image, number in enumerate(numbers):
            self._stands[number] = Stand.of(shots, image)
        return before

    def to_json(self) -> list[Any]:
        """All that is remembered, as JSON-ready values."""
        return [
            None if stand is None else [stand.stamp_ns, stand.vehicle.tolist(), stand.cam_from_utm.tolist()]
            for stand in self._stands
        ]

    def restore(self, values: list[Any]) -> None:
        """Go on from where `to_json` left off, with the same cameras."""
        self._stands = [
            None if value is None else Stand(int(value[0]), np.array(value[1]), np.array(value[2])) for value in values
        ]


def rates(before: list[Stand | None], shots: Shots) -> tuple[FloatArray, FloatArray]:
    """Speed and turn between images.

    Args:
        before: Of each image, the same camera's image before (`CameraMotion.follow`).
        shots: The s images.

    Returns:
        (s, 3) metres per second in the map frame, and (s, 3) radians per second about the camera's axes; zeros where
        there is no image before, or none that is near enough in time.
    """
    velocities, turns = np.zeros((2, len(shots), 3))
    for image, earlier in enumerate(before):
        if earlier is None:
            continue
        elapsed_s = (shots.poses[image].stamp_ns - earlier.stamp_ns) / 1e9
        if 0 < elapsed_s <= _MAX_GAP_S:
            velocities[image] = (shots.vehicle[image] - earlier.vehicle) / elapsed_s
            # Of a camera that turns by a small angle w, C C'ᵀ = I − [w]×.
            turn = shots.cam_from_utm[image] @ earlier.cam_from_utm.T
            turns[image] = (turn - turn.T)[[1, 2, 0], [2, 0, 1]] / (2 * elapsed_s)
    return velocities, turns
