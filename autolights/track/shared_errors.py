"""By how much poses, mountings and stamps are off: the errors that all lights of an image have in common.

They are three metres by which all poses are off, and for each camera three angles and a delay (`box_measurement`). What
lights have told of them is kept as information, Λ_ww and η_w of `places`.
"""

from typing import Any

import numpy as np

from autolights.core import FloatArray
from autolights.track.box_measurement import CAMERA, POSE
from autolights.track.place_config import PlaceConfig


class SharedErrors:
    """The w = 3 + 4 s shared errors of s cameras.

    Args:
        cameras: How many.
        config: Standard deviations at the start, and of the drift.

    Attributes:
        mean: (w,) after all that lights have told.
        covariance: (w, w).
        information: (w, w) of what is known for good: at the start, and from lights that are closed.
        vector: (w,) information times mean.
    """

    def __init__(self, cameras: int, config: PlaceConfig) -> None:
        self._config, self._cameras = config, cameras
        self._start_variances = self._each(config.position_m, config.rotation_deg, config.delay_s) ** 2
        self.mean: FloatArray = np.zeros(len(self._start_variances))
        self.covariance: FloatArray = np.diag(self._start_variances)
        self.information: FloatArray = np.diag(1 / self._start_variances)
        self.vector: FloatArray = np.zeros(len(self._start_variances))
        self._aged_ns: int | None = None

    def of_camera(self, number: int) -> tuple[FloatArray, FloatArray]:
        """The errors that touch one camera.

        Returns:
            (7,) metres east, north and up from the given pose to the true one, radians about the camera's axes by which
            the world is seen turned, seconds from its stamps to its exposures; (7, 7) covariance.
        """
        columns = np.append(np.arange(POSE), POSE + CAMERA * number + np.arange(CAMERA))
        return self.mean[columns], self.covariance[np.ix_(columns, columns)]

    def solve(self, information: FloatArray, vector: FloatArray) -> None:
        """Find the errors, with what lights tell that may tell more: (w, w) and (w,)."""
        self.covariance = np.linalg.inv(self.information + information)
        self.mean = self.covariance @ (self.vector + vector)

    def keep(self, information: FloatArray, vector: FloatArray) -> None:
        """Know for good what lights told that will tell no more: (w, w) and (w,)."""
        self.information, self.vector = self.information + information, self.vector + vector

    def age(self, stamp_ns: int) -> None:
        """Let what is known for good drift up to a stamp; it never gets vaguer than it was at the start."""
        elapsed_s = 0.0 if self._aged_ns is None else max(stamp_ns - self._aged_ns, 0) / 1e9
        self._aged_ns = stamp_ns
        drift = self._each(self._config.drift_m, self._config.drift_deg, self._config.drift_delay_s)
        covariance = np.linalg.inv(self.information)
        mean = covariance @ self.vector
        covariance = covariance + np.diag(drift**2 * elapsed_s / 60)
        shrink = np.sqrt(np.minimum(1.0, self._start_variances / np.diag(covariance)))
        self.information = np.linalg.inv(covariance * np.outer(shrink, shrink))
        self.vector = self.information @ mean

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values."""
        arrays = {name: getattr(self, name).tolist() for name in _ARRAYS}
        return {**arrays, "aged_ns": self._aged_ns}

    def restore(self, values: dict[str, Any]) -> None:
        """Go on from where `to_json` left off, with as many cameras.

        Raises:
            ValueError: If it is of other errors.
        """
        arrays = {name: np.array(values[name], dtype=np.float64) for name in _ARRAYS}
        for name, array in arrays.items():
            if array.shape != getattr(self, name).shape:
                raise ValueError(f"{name} of shared errors must be {getattr(self, name).shape}, got {array.shape}")
        for name, array in arrays.items():
            setattr(self, name, array)
        self._aged_ns = values["aged_ns"]

    def _each(self, position_m: float, rotation_deg: float, delay_s: float) -> FloatArray:
        """(w,) one value for each error."""
        of_camera = np.append(np.full(CAMERA - 1, np.radians(rotation_deg)), delay_s)
        return np.append(np.full(POSE, position_m), np.tile(of_camera, self._cameras))


_ARRAYS = ("mean", "covariance", "information", "vector")
