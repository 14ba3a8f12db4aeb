"""By how much a camera looks past its calibration, and a vehicle stands beside its pose: one answer for all pairs.

A mounting error of 1° shifts every projected light by as much as neighbouring heads are apart, and pairing each light
with what is nearest then moves a whole row by one. Shifted rightly all lights fit at once; by one place the last of
the row finds nobody. So each pair of a light and a detection proposes an error (two angles, and two metres sideways and
down, whose effect fades with distance), all others vote on it, and what the images before have shown votes too.

References:
    Beyond Wu et al. 2023, who associate by the distances as projected.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field

from autolights.core import BoolArray, CameraModel, Config, FloatArray
from autolights.core.boxes import cxcywh_from_xyxy
from autolights.core.camera import normalized_points

_GAIN = 4.5  # a pair within three standard deviations speaks for a rotation, most if it fits exactly
_MAX_HEIGHT_RATIO = 1.6  # of a pair's boxes; half-hidden heads are left out of the vote
_MAX_PROPOSALS = 48  # those nearest to what was expected
_SEARCH_SIGMAS = 3.5
_AMBIGUOUS = 1.0  # two rotations whose votes differ by less are both possible


class AlignmentConfig(Config):
    """What is known of the errors before anything is seen; standard deviations.

    Attributes:
        rotation_deg: Of a camera's mounting and the vehicle's attitude, per axis.
        position_m: Of the vehicle's position, per axis.
        map_m: Of each light's own place in the map, per axis.
        box_px: Of a detected box's centre.
        drift_deg: How far the angles wander in a second.
        drift_m: How far the vehicle's position error wanders in a second.
        gate: A detection is farther from a light than so many standard deviations of all these errors: not that light.
        alarm_deg: A camera that is found to look past its calibration by more raises an alarm.
    """

    rotation_deg: float = Field(default=0.6, gt=0)
    position_m: float = Field(default=0.3, gt=0)
    map_m: float = Field(default=0.2, ge=0)
    box_px: float = Field(default=1.5, gt=0)
    drift_deg: float = Field(default=0.05, ge=0)
    drift_m: float = Field(default=0.1, ge=0)
    gate: float = Field(default=5.0, gt=0)
    alarm_deg: float = Field(default=0.5, gt=0)


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where the lights of one image lie with the error taken off.

    Attributes:
        camera: The camera.
        error: (4,) yaw and pitch in radians, metres right and down, of the world as the camera sees it.
        shifts_px: (n, 2) to be added to the projected boxes.
        sigmas_px: (n,) what is left to err, per axis, of a light's centre against its detection's.
        pairs: How many pairs agree on it.
    """

    camera: CameraModel
    error: FloatArray
    shifts_px: FloatArray
    sigmas_px: FloatArray
    pairs: int

    def as_calibrated(self, boxes_xyxy: FloatArray, heights_m: FloatArray) -> FloatArray:
        """(n, 4) detected boxes where calibration and pose would have them; (n,) heights of the housings in metres."""
        boxes_px = cxcywh_from_xyxy(boxes_xyxy)
        distances_m = self.camera.intrinsics[1, 1] * heights_m / np.maximum(boxes_px[:, 3], 1.0)
        return boxes_xyxy - np.tile(error_jacobians(boxes_px[:, :2], distances_m, self.camera) @ self.error, 2)


@dataclass(frozen=True)
class CameraHealth:
    """How far a camera looks past its calibration, errors of the vehicle's pose included.

    Attributes:
        yaw_deg: Lights are seen so far to the right of where they should be.
        pitch_deg: So far below.
        sigma_deg: Standard deviation of the less certain of the two.
        alarm: It is surely, by two standard deviations, more than `AlignmentConfig.alarm_deg`.
    """

    yaw_deg: float
    pitch_deg: float
    sigma_deg: float
    alarm: bool


class CameraAlignment:
    """The error of one camera over time: a Kalman filter whose measurement is the vote of an image.

    Args:
        camera: The camera.
        config: Standard deviations.
    """

    def __init__(self, camera: CameraModel, config: AlignmentConfig) -> None:
        self._camera = camera
        self._config = config
        angle, drift_angle = np.radians(config.rotation_deg), np.radians(config.drift_deg)
        self._start = np.array([angle, angle, config.position_m, config.position_m]) ** 2
        self._drift = np.array([drift_angle, drift_angle, config.drift_m, config.drift_m]) ** 2
        self._error: FloatArray = np.zeros(4)
        self._covariance: FloatArray = np.diag(self._start)
        self._stamp_ns: int | None = None

    def health(self) -> CameraHealth:
        """What has been found so far."""
        yaw, pitch = np.degrees(self._error[:2]).tolist()
        sigma_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(self._covariance[:2, :2])[-1])))
        surely_deg = float(np.hypot(yaw, pitch)) - 2 * sigma_deg
        return CameraHealth(yaw, pitch, sigma_deg, alarm=surely_deg > self._config.alarm_deg)

    def align(
        self,
        projected_xyxy: FloatArray,
        distances_m: FloatArray,
        detected_xyxy: FloatArray,
        fits: BoolArray,
        stamp_ns: int,
    ) -> Alignment:
        """Take in one image.

        Args:
            projected_xyxy: (n, 4) boxes of known lights, as calibration and pose have them.
            distances_m: (n,) of these lights.
            detected_xyxy: (m, 4) boxes.
            fits: (n, m) whether light and detection can be the same by their types.
            stamp_ns: Of the image; an earlier one than before is aligned, but teaches nothing.
        """
        config = self._config
        known, seen = cxcywh_from_xyxy(projected_xyxy), cxcywh_from_xyxy(detected_xyxy)
        sigmas_px = np.hypot(config.box_px, self._camera.intrinsics[1, 1] * config.map_m / np.maximum(distances_m, 1.0))
        jacobians = error_jacobians(known[:, :2], distances_m, self._camera)
        error, covariance, pairs = self._error, self._predicted(stamp_ns), 0
        if len(known) and len(seen):
            like = fits & _alike(known[:, 3], seen[:, 3])
            offsets = seen[None, :, :2] - (known[:, :2] + jacobians @ error)[:, None, :]
            change, covariance, pairs, sure = _vote(offsets, like, jacobians, sigmas_px, covariance)
            error = error + change
            if sure and (self._stamp_ns is None or stamp_ns >= self._stamp_ns):
                self._error, self._covariance, self._stamp_ns = error, covariance, stamp_ns
        left = np.einsum("nij,jk,nik->n", jacobians, covariance, jacobians) / 2  # mean over the two axes
        return Alignment(self._camera, error, jacobians @ error, np.sqrt(sigmas_px**2 + left), pairs)

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values."""
        return {"error": self._error.tolist(), "covariance": self._covariance.tolist(), "stamp_ns": self._stamp_ns}

    def restore(self, values: dict[str, Any]) -> None:
        """Go on from where `to_json` left off."""
        self._error = np.array(values["error"], dtype=np.float64).reshape(4)
        self._covariance = np.array(values["covariance"], dtype=np.float64).reshape(4, 4)
        self._stamp_ns = values["stamp_ns"]

    def _predicted(self, stamp_ns: int) -> FloatArray:
        """Covariance before the image, never wider than at the start."""
        if self._stamp_ns is None:
            return self._covariance
        elapsed_s = max(stamp_ns - self._stamp_ns, 0) / 1e9
        wider = np.asarray(self._covariance + np.diag(self._drift * elapsed_s))
        shrink = np.sqrt(np.minimum(1.0, self._start / np.diag(wider)))
        return np.asarray(wider * np.outer(shrink, shrink))


def error_jacobians(points_px: FloatArray, distances_m: FloatArray, camera: CameraModel) -> FloatArray:
    """How points move with the error; lens distortion is left aside.

    With normalised coordinates (x, y): du = fx (1 + x²) yaw + fx x y pitch, dv = fy x y yaw + fy (1 + y²) pitch; metres
    right and down at a distance count as angles of metres / distance.

    Args:
        points_px: (n, 2).
        distances_m: (n,).
        camera: The camera.

    Returns:
        (n, 2, 4) pixels per radian of yaw and pitch, and per metre right and down.
    """
    x, y = normalized_points(points_px, camera).T
    fx, fy = camera.intrinsics[0, 0], camera.intrinsics[1, 1]
    angles = np.moveaxis(np.array([[fx * (1 + x * x), fx * x * y], [fy * x * y, fy * (1 + y * y)]]), 2, 0)
    return np.concatenate([angles, angles / np.maximum(distances_m, 1.0)[:, None, None]], axis=2)


def _alike(heights_a: FloatArray, heights_b: FloatArray) -> BoolArray:
    ratio = heights_a[:, None] / np.maximum(heights_b[None, :], 1e-9)
    return np.asarray((ratio < _MAX_HEIGHT_RATIO) & (ratio > 1 / _MAX_HEIGHT_RATIO))


def _vote(
    offsets: FloatArray, like: BoolArray, jacobians: FloatArray, sigmas_px: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray, int, bool]:
    """The error that explains most pairs.

    Args:
        offsets: (n, m, 2) pixels from each light to each detection.
        like: (n, m) pairs that may vote.
        jacobians: (n, 2, 4) pixels per unit of the error.
        sigmas_px: (n,) of a pair with the right error.
        prior: (4, 4) covariance of the error, whose mean is 0.

    Returns:
        (4,) error, (4, 4) its covariance, the number of pairs that agree, and whether it is beyond doubt.
    """
    lights, detections = np.nonzero(like)
    if not len(lights):
        return np.zeros(4), prior, 0, False
    # Of all errors that bring a light onto a detection, the most probable one: P Jᵀ (J P Jᵀ)⁻¹ d.
    spread = jacobians @ prior @ jacobians.swapaxes(1, 2)
    gains = prior @ jacobians.swapaxes(1, 2) @ np.linalg.inv(spread)
    proposals = np.einsum("cij,cj->ci", gains[lights], offsets[lights, detections])
    precision = np.linalg.inv(prior)
    surprise = np.einsum("ci,ij,cj->c", proposals, precision, proposals)
    order = np.argsort(surprise)[:_MAX_PROPOSALS]
    order = order[surprise[order] < _SEARCH_SIGMAS**2]
    proposals = np.concatenate([np.zeros((1, 4)), proposals[order]])
    penalties = np.concatenate([[0.0], surprise[order]]) / 2

    squares = _squares(offsets, like, jacobians, sigmas_px, proposals)
    agreement = np.maximum(_GAIN - squares / 2, 0.0)
    # One detection cannot speak for two lights, nor one light for two detections.
    votes = np.minimum(agreement.max(axis=2).sum(axis=1), agreement.max(axis=1).sum(axis=1)) - penalties
    best = int(np.argmax(votes))
    if votes[best] <= 0:
        return np.zeros(4), prior, 0, False
    error, covariance, pairs = _fit(squares[best], offsets, jacobians, sigmas_px, precision)
    if pairs < 2:
        # One pair alone may be the neighbour. It sharpens what is known, if it agrees with it.
        error, covariance, pairs = _fit(squares[0], offsets, jacobians, sigmas_px, precision)
        return error, covariance, pairs, pairs > 0
    moved_px = np.abs(jacobians @ (proposals - proposals[best]).T).max(axis=(0, 1))
    others = moved_px > 3 * sigmas_px.max()
    sure = votes[best] - votes[others].max(initial=-np.inf) > _AMBIGUOUS
    return error, covariance, pairs, bool(sure)


def _squares(
    offsets: FloatArray, like: BoolArray, jacobians: FloatArray, sigmas_px: FloatArray, errors: FloatArray
) -> FloatArray:
    """(c, n, m) squared distances in standard deviations with each of (c, 4) errors; infinite where not alike."""
    moved = (jacobians @ errors.T).transpose(2, 0, 1)
    rest = offsets[None] - moved[:, :, None, :]
    squares = (rest[..., 0] ** 2 + rest[..., 1] ** 2) / (sigmas_px**2)[None, :, None]
    squares[:, ~like] = np.inf
    return np.asarray(squares)


def _fit(
    squares: FloatArray, offsets: FloatArray, jacobians: FloatArray, sigmas_px: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray, int]:
    """Weighted least squares over the pairs that are each other's nearest, with the prior as one more equation."""
    nearest, back = squares.argmin(axis=1), squares.argmin(axis=0)
    rows = np.arange(len(squares))
    lights = rows[(back[nearest] == rows) & (squares[rows, nearest] < 2 * _GAIN)]
    chosen = jacobians[lights].reshape(-1, 4)
    weighted = chosen / np.repeat(sigmas_px[lights] ** 2, 2)[:, None]
    covariance = np.linalg.inv(precision + weighted.T @ chosen)
    error = covariance @ (weighted.T @ offsets[lights, nearest[lights]].reshape(-1))
    return error, covariance, len(lights)
