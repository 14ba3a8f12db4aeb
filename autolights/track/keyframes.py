"""Which images are worth learning places from: boxes of one place repeat each other."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from autolights.core import FloatArray
from autolights.core.shots import Shots
from autolights.track.place_config import PlaceConfig

_NEVER_NS = -(2**62)


class Keyframes:
    """The latest image of each camera that taught places, and whether the next one says enough that is new.

    Args:
        cameras: How many.
        config: `every_s`, `least_news`, and how errors hang together over way and time.

    References:
        Keyframe selection of visual SLAM (Klein and Murray 2007, "Parallel Tracking and Mapping", Sec. 5).
    """

    def __init__(self, cameras: int, config: PlaceConfig) -> None:
        self._config = config
        self._stamps_ns = [_NEVER_NS] * cameras
        self._vehicle = [[0.0, 0.0, 0.0]] * cameras

    def take(self, shots: Shots, images: Sequence[int], numbers: Sequence[int]) -> bool:
        """Whether the images of a set are keyframes; if they are, they are noted.

        One camera that is due takes the others along: a set of images costs little more than one.

        Args:
            shots: All images of the set.
            images: Those that show lights.
            numbers: Of the cameras of all images.
        """
        vehicle = shots.vehicle.tolist()
        if not any(self._is_due(numbers[image], shots.poses[image].stamp_ns, vehicle[image]) for image in images):
            return False
        for image in images:
            number = numbers[image]
            self._stamps_ns[number], self._vehicle[number] = shots.poses[image].stamp_ns, vehicle[image]
        return True

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values."""
        return {"stamps_ns": list(self._stamps_ns), "vehicle": list(self._vehicle)}

    def restore(self, values: dict[str, Any]) -> None:
        """Go on from where `to_json` left off, with the same cameras."""
        self._stamps_ns, self._vehicle = list(values["stamps_ns"]), list(values["vehicle"])

    def _is_due(self, number: int, stamp_ns: int, vehicle: list[float]) -> bool:
        config, elapsed_s = self._config, abs(stamp_ns - self._stamps_ns[number]) / 1e9
        if elapsed_s < config.every_s:
            return False
        return bool(news(math.dist(vehicle, self._vehicle[number]), elapsed_s, config) >= config.least_news)


def news(way_m: FloatArray | float, elapsed_s: FloatArray | float, config: PlaceConfig) -> FloatArray:
    """How much of an independent observation one is, so far from the last and so long after it.

    That is (1 − ρ) / (1 + ρ) with the correlation ρ = e^−u of their errors, which is tanh(u / 2).
    """
    return np.asarray(np.tanh((way_m / config.decorrelation_m + elapsed_s / config.decorrelation_s) / 2))
