"""By how much a camera looks past its calibration, and a vehicle stands beside its pose: one answer for all pairs.

A mounting error of 1° shifts every projected light by as much as neighbouring heads are apart, and pairing each light
with what is nearest then moves a whole row by one. Shifted rightly all lights fit at once; by one place the last of
the row finds nobody. So each pair of a light and a detection proposes an error, all others vote on it, and what the
images before have shown votes too (`alignment_vote`).

Once the error is known well enough, the vote can have one outcome only: no error that it would consider makes another
detection a light's own. Then the pairs are taken as they are, for all images at once.

References:
    Beyond Wu et al. 2023, who associate by the distances as projected.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field

from autolights.core import BoolArray, CameraModel, Config, FloatArray, IntArray
from autolights.core.shots import Shots
from autolights.track.alignment_vote import AMBIGUOUS_SIGMAS, MATCH_SIGMAS, MAX_HEIGHT_RATIO, SEARCH_SIGMAS, vote
from autolights.track.camera_errors import ErrorEffect


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
    """Where the lights of s images lie with the error taken off.

    Attributes:
        shots: The images.
        errors: (s, 4) yaw and pitch in radians, metres right and down, of the world as the camera sees it.
        shifts_px: (2, n) to be added to the projected boxes.
        sigmas_px: (n,) what is left to err, per axis, of a light's centre against its detection's.
        pairs: (s,) how many pairs agree on it.
    """

    shots: Shots
    errors: FloatArray
    shifts_px: FloatArray
    sigmas_px: FloatArray
    pairs: IntArray

    def shifts_of_seen(self, seen: FloatArray, heights_m: FloatArray, images: IntArray) -> FloatArray:
        """By how much detections are beside where calibration and pose would have them.

        Args:
            seen: (4, m) centres, widths and heights of boxes, pixels.
            heights_m: (m,) of the housings, from which their distances follow.
            images: (m,) which image each lies in.

        Returns:
            (2, m) pixels.
        """
        distances_m = self.shots.optics.focal_px[1, images] * heights_m / np.maximum(seen[3], 1.0)
        return ErrorEffect.of(seen[:2], distances_m, self.shots, images).shifts_px(self.errors)


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


class RigAlignment:
    """The error of each camera over time: Kalman filters whose measurements are the votes of the images.

    Args:
        cameras: The cameras, by name.
        config: Standard deviations.
    """

    def __init__(self, cameras: Mapping[str, CameraModel], config: AlignmentConfig) -> None:
        self._config = config
        self._names = tuple(cameras)
        self._row_of = {name: row for row, name in enumerate(self._names)}
        angle, drift_angle = np.radians(config.rotation_deg), np.radians(config.drift_deg)
        self._start = np.array([angle, angle, config.position_m, config.position_m]) ** 2
        self._drift = np.array([drift_angle, drift_angle, config.drift_m, config.drift_m]) ** 2
        self._errors: FloatArray = np.zeros((len(cameras), 4))
        self._covariances: FloatArray = np.tile(np.diag(self._start), (len(cameras), 1, 1))
        self._stamps_ns: list[int | None] = [None] * len(cameras)

    def health(self) -> dict[str, CameraHealth]:
        """What has been found so far, by camera."""
        return {name: self._health(row) for row, name in enumerate(self._names)}

    def align(
        self,
        shots: Shots,
        known: FloatArray,
        distances_m: FloatArray,
        known_in: IntArray,
        seen: FloatArray,
        fits: BoolArray,
    ) -> Alignment:
        """Take in one set of images.

        Args:
            shots: The images.
            known: (4, n) centres, widths and heights of known lights, as calibration and pose have them, pixels.
            distances_m: (n,) of these lights.
            known_in: (n,) which image each lies in, ascending.
            seen: (4, m) the same of detections.
            fits: (n, m) whether light and detection may be the same and may vote: of one image, and of one type.

        Returns:
            The error found. An image with an earlier stamp than one before is aligned, but teaches nothing.
        """
        config = self._config
        cameras = np.array([self._row_of[camera.name] for camera in shots.optics.cameras])
        errors, covariances = self._errors[cameras], self._predicted(cameras, shots)
        effect = ErrorEffect.of(known[:2], distances_m, shots, known_in)
        sigmas_px = np.hypot(config.box_px, config.map_m * effect.focal_px[1] * effect.nearness)
        pairs: IntArray = np.zeros(len(shots), dtype=np.int64)
        gram = effect.gram()
        if fits.any():
            problem = _Pairs(effect, gram, known, seen, fits, sigmas_px, effect.shifts_px(errors))
            changes, covariances, pairs, sure = problem.solve(covariances)
            errors = errors + changes
            self._learn(cameras[sure], shots, np.flatnonzero(sure), errors, covariances)
        left_px2 = _trace(gram, effect.turn_covariances(covariances)) / 2  # mean over the two axes
        return Alignment(shots, errors, effect.shifts_px(errors), np.sqrt(sigmas_px**2 + left_px2), pairs)

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, by camera, as JSON-ready values."""
        return {
            name: {"error": error, "covariance": covariance, "stamp_ns": stamp_ns}
            for name, error, covariance, stamp_ns in zip(
                self._names, self._errors.tolist(), self._covariances.tolist(), self._stamps_ns, strict=True
            )
        }

    def restore(self, values: dict[str, Any]) -> None:
        """Go on from where `to_json` left off, with the same cameras."""
        saved = [values[name] for name in self._names]
        self._errors = np.array([one["error"] for one in saved], dtype=np.float64).reshape(-1, 4)
        self._covariances = np.array([one["covariance"] for one in saved], dtype=np.float64).reshape(-1, 4, 4)
        self._stamps_ns = [one["stamp_ns"] for one in saved]

    def _health(self, row: int) -> CameraHealth:
        yaw, pitch = np.degrees(self._errors[row, :2]).tolist()
        sigma_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(self._covariances[row, :2, :2])[-1])))
        surely_deg = float(np.hypot(yaw, pitch)) - 2 * sigma_deg
        return CameraHealth(yaw, pitch, sigma_deg, alarm=surely_deg > self._config.alarm_deg)

    def _predicted(self, cameras: IntArray, shots: Shots) -> FloatArray:
        """(s, 4, 4) covariances before the images, never wider than at the start."""
        elapsed_s = np.array(
            [
                0.0 if before is None else max(pose.stamp_ns - before, 0) / 1e9
                for before, pose in zip((self._stamps_ns[row] for row in cameras.tolist()), shots.poses, strict=True)
            ]
        )
        wider = self._covariances[cameras]
        diagonal = wider.reshape(-1, 16)[:, ::5]  # a view: the drift is added on the diagonals
        diagonal += self._drift * elapsed_s[:, None]
        shrink = np.sqrt(np.minimum(1.0, self._start / diagonal))
        return np.asarray(wider * (shrink[:, :, None] * shrink[:, None, :]))

    def _learn(
        self, cameras: IntArray, shots: Shots, images: IntArray, errors: FloatArray, covariances: FloatArray
    ) -> None:
        for row, image in zip(cameras.tolist(), images.tolist(), strict=True):
            before, stamp_ns = self._stamps_ns[row], shots.poses[image].stamp_ns
            if before is None or stamp_ns >= before:
                self._errors[row], self._covariances[row] = errors[image], covariances[image]
                self._stamps_ns[row] = stamp_ns


@dataclass(frozen=True, eq=False)
class _Pairs:
    """The pairs of one set of images that may be, and the error that explains most of them.

    Attributes:
        effect: Of errors on n lights.
        gram: (3, n) of it.
        known: (4, n) their boxes.
        seen: (4, m) boxes of detections.
        fits: (n, m) pairs that may be.
        sigmas_px: (n,) of a pair with the right error.
        shifts_px: (2, n) by the error that was known before.
    """

    effect: ErrorEffect
    gram: FloatArray
    known: FloatArray
    seen: FloatArray
    fits: BoolArray
    sigmas_px: FloatArray
    shifts_px: FloatArray

    def solve(self, priors: FloatArray) -> tuple[FloatArray, FloatArray, IntArray, BoolArray]:
        """Find the errors of s images.

        Args:
            priors: (s, 4, 4) covariances of their changes, whose mean is 0.

        Returns:
            (s, 4) changes, (s, 4, 4) their covariances, (s,) numbers of pairs that agree, (s,) whether they are beyond
            doubt.
        """
        images, (dx, dy) = self.effect.images, self._offsets()
        like = self.fits & _alike(self.known[3], self.seen[3])
        squares = np.where(like, (dx * dx + dy * dy) / (self.sigmas_px**2)[:, None], np.inf)
        reach = self._reach(priors)
        # The vote looks at errors within SEARCH_SIGMAS only, and these move a light by `reach` at most: whatever wins,
        # a pair farther apart than this is none, and one closer than that is one, if neither has another to choose.
        lights, detections = np.nonzero(squares < ((MATCH_SIGMAS + reach) ** 2)[:, None])
        contested = (np.bincount(lights)[lights] > 1) | (np.bincount(detections)[detections] > 1)
        vague = np.sqrt(squares[lights, detections]) >= MATCH_SIGMAS - reach[lights]
        doubtful = np.zeros(len(priors), dtype=bool)
        doubtful[images[lights[contested | vague]]] = True
        # Two errors that move some light apart by more than this may both be right: that is for the vote to judge.
        doubtful[images[2 * reach > AMBIGUOUS_SIGMAS]] = True

        changes, covariances, pairs = self._fit(lights, detections, dx, dy, priors)
        sure = pairs > 0
        for image in np.flatnonzero(doubtful).tolist():
            mine = np.flatnonzero(images == image)
            columns = np.flatnonzero(like[mine].any(axis=0))
            jacobians = self.effect.jacobians()[mine]
            offsets = np.stack([dx[np.ix_(mine, columns)], dy[np.ix_(mine, columns)]], axis=2)
            found = vote(offsets, like[np.ix_(mine, columns)], jacobians, self.sigmas_px[mine], priors[image])
            changes[image], covariances[image], pairs[image], sure[image] = found
        return changes, covariances, pairs, sure

    def _offsets(self) -> tuple[FloatArray, FloatArray]:
        """(n, m) pixels right and down from each light to each detection."""
        x, y = self.known[:2] + self.shifts_px
        return self.seen[0] - x[:, None], self.seen[1] - y[:, None]

    def _reach(self, priors: FloatArray) -> FloatArray:
        """(n,) how far any error that the vote looks at moves a light, in standard deviations of a pair.

        For eᵀ P⁻¹ e ≤ k² it is |J e| ≤ k √λ, λ the larger eigenvalue of J P Jᵀ; that of Q G, with the covariance Q of
        angles, is the same: λ = t / 2 + √(t² / 4 − det Q det G), t = tr Q G.
        """
        q_xx, q_xy, q_yy = q = self.effect.turn_covariances(priors)
        g_xx, g_xy, g_yy = self.gram
        half = _trace(self.gram, q) / 2
        determinant = (q_xx * q_yy - q_xy * q_xy) * (g_xx * g_yy - g_xy * g_xy)
        largest = half + np.sqrt(np.maximum(half * half - determinant, 0.0))
        return np.asarray(SEARCH_SIGMAS * np.sqrt(largest) / self.sigmas_px)

    def _fit(
        self, lights: IntArray, detections: IntArray, dx: FloatArray, dy: FloatArray, priors: FloatArray
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """Weighted least squares over k pairs, with the priors as one more equation for each image.

        Of a pair, JᵀJ = [[G, G / d], [G / d, G / d²]] and Jᵀ o = [Aᵀ o, Aᵀ o / d].
        """
        s, k, chosen = len(priors), len(lights), self.effect.take(lights)
        pulls = chosen.pulled_back(np.array([dx[lights, detections], dy[lights, detections]]))
        g_xx, g_xy, g_yy = self.gram[:, lights]
        terms = np.array([g_xx, g_xy, g_xy, g_yy, *pulls])  # (6, k)
        mine = (chosen.images == np.arange(s)[:, None]) / self.sigmas_px[lights] ** 2  # (s, k)
        weights = np.array([mine, mine * chosen.nearness, mine * chosen.nearness**2]).reshape(3 * s, k)
        sums = (weights @ terms.T).reshape(3, s, 6)
        gram = sums[:, :, :4].reshape(3, s, 2, 2)
        information = np.empty((s, 4, 4))
        information[:, :2, :2], information[:, 2:, 2:] = gram[0], gram[2]
        information[:, :2, 2:] = information[:, 2:, :2] = gram[1]
        covariances = np.linalg.inv(np.linalg.inv(priors) + information)
        towards = np.concatenate([sums[0, :, 4:], sums[1, :, 4:]], axis=1)
        pairs = np.count_nonzero(mine, axis=1)
        alone = pairs == 0
        if alone.any():
            covariances[alone] = priors[alone]
        return (covariances @ towards[:, :, None])[..., 0], covariances, pairs


def _trace(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n,) traces of the products of symmetric matrices, given by (3, n) elements xx, xy, yy."""
    return np.asarray(a[0] * b[0] + 2 * a[1] * b[1] + a[2] * b[2])


def _alike(heights_a: FloatArray, heights_b: FloatArray) -> BoolArray:
    """(n, m) whether boxes are about equally high."""
    ratio = heights_a[:, None] / np.maximum(heights_b, 1e-9)
    return np.asarray((ratio < MAX_HEIGHT_RATIO) & (ratio > 1 / MAX_HEIGHT_RATIO))
