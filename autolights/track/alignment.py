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
from autolights.track.alignment_vote import MATCH_SIGMAS, MAX_HEIGHT_RATIO, SEARCH_SIGMAS, vote
from autolights.track.camera_errors import ErrorEffect
from autolights.track.camera_health import CameraHealth


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
        pairs: tuple[IntArray, IntArray],
    ) -> Alignment:
        """Take in one set of images.

        Args:
            shots: The images.
            known: (4, n) centres, widths and heights of known lights, as calibration and pose have them, pixels.
            distances_m: (n,) of these lights.
            known_in: (n,) which image each lies in, ascending.
            seen: (4, m) the same of detections.
            pairs: (k,) lights, ascending, and (k,) detections that may be the same and may vote: of one image, and of
                one type.

        Returns:
            The error found. An image with an earlier stamp than one before is aligned, but teaches nothing.
        """
        config = self._config
        cameras = np.array([self._row_of[camera.name] for camera in shots.optics.cameras])
        errors, covariances = self._errors.take(cameras, axis=0), self._predicted(cameras, shots)
        effect = ErrorEffect.of(known[:2], distances_m, shots, known_in)
        sigmas_px = np.hypot(config.box_px, config.map_m * effect.focal_px[1] * effect.nearness)
        gram, shifts_px = effect.gram(), effect.shifts_px(errors)
        lights, detections = _alike(known[3], seen[3], *pairs)
        agreeing: IntArray = np.zeros(len(shots), dtype=np.int64)
        if len(lights):
            offsets_px = seen[:2].take(detections, axis=1) - (known[:2] + shifts_px).take(lights, axis=1)
            problem = _Problem(effect, gram, sigmas_px, lights, detections, offsets_px)
            changes, covariances, agreeing, sure = problem.solve(covariances)
            errors += changes
            shifts_px = effect.shifts_px(errors)
            self._learn(cameras, shots, sure.nonzero()[0], errors, covariances)
        left_px2 = _trace(gram, effect.turn_covariances(covariances)) / 2  # mean over the two axes
        return Alignment(shots, errors, shifts_px, np.sqrt(sigmas_px * sigmas_px + left_px2), agreeing)

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
        stamps_ns = [self._stamps_ns[row] for row in cameras.tolist()]
        elapsed_s = [
            0.0 if before is None else max(pose.stamp_ns - before, 0) / 1e9
            for before, pose in zip(stamps_ns, shots.poses, strict=True)
        ]
        wider = self._covariances.take(cameras, axis=0)
        diagonal = wider.reshape(-1, 16)[:, ::5]  # a view: the drift is added on the diagonals
        diagonal += self._drift * np.array(elapsed_s)[:, None]
        shrink = np.sqrt(np.minimum(1.0, self._start / diagonal))
        return np.asarray(wider * (shrink[:, :, None] * shrink[:, None, :]))

    def _learn(
        self, cameras: IntArray, shots: Shots, images: IntArray, errors: FloatArray, covariances: FloatArray
    ) -> None:
        for image in images.tolist():
            row, stamp_ns = int(cameras[image]), shots.poses[image].stamp_ns
            before = self._stamps_ns[row]
            if before is None or stamp_ns >= before:
                self._errors[row], self._covariances[row] = errors[image], covariances[image]
                self._stamps_ns[row] = stamp_ns


@dataclass(frozen=True, eq=False)
class _Problem:
    """The pairs of one set of images that may be, and the error that explains most of them.

    Attributes:
        effect: Of errors on n lights.
        gram: (3, n) of it.
        sigmas_px: (n,) of a pair with the right error.
        lights: (k,) of pairs that may be, ascending.
        detections: (k,) of the same pairs.
        offsets_px: (2, k) from the light, moved by the error that was known before, to the detection.
    """

    effect: ErrorEffect
    gram: FloatArray
    sigmas_px: FloatArray
    lights: IntArray
    detections: IntArray
    offsets_px: FloatArray

    def solve(self, priors: FloatArray) -> tuple[FloatArray, FloatArray, IntArray, BoolArray]:
        """Find the errors of s images.

        Args:
            priors: (s, 4, 4) covariances of their changes, whose mean is 0.

        Returns:
            (s, 4) changes, (s, 4, 4) their covariances, (s,) numbers of pairs that agree, (s,) whether they are beyond
            doubt.
        """
        images, apart = self.effect.images, self.offsets_px * self.offsets_px
        distances = np.sqrt(apart[0] + apart[1]) / self.sigmas_px.take(self.lights)
        reach = self._reach(priors)
        # The vote looks at errors within SEARCH_SIGMAS only, and these move a light by `reach` at most: whatever wins,
        # a pair farther apart than this is none, and one closer than that is one, if neither has another to choose.
        reached = reach.take(self.lights)
        close = (distances < MATCH_SIGMAS + reached).nonzero()[0]
        lights, detections = self.lights.take(close), self.detections.take(close)
        contested = (np.bincount(lights).take(lights) > 1) | (np.bincount(detections).take(detections) > 1)
        vague = distances.take(close) >= MATCH_SIGMAS - reached.take(close)
        doubtful = set(images.take(lights[contested | vague]).tolist())

        changes, covariances, pairs = self._fit(close, priors)
        sure = pairs > 0
        for image in doubtful:
            changes[image], covariances[image], pairs[image], sure[image] = self._vote(image, priors[image])
        return changes, covariances, pairs, sure

    def _reach(self, priors: FloatArray) -> FloatArray:
        """(n,) how far any error that the vote looks at moves a light, in standard deviations of a pair.

        For eᵀ P⁻¹ e ≤ k² it is |J e| ≤ k √λ, λ the larger eigenvalue of J P Jᵀ; that of Q G, with the covariance Q of
        angles, is the same: λ = t / 2 + √(t² / 4 − det Q det G), t = tr Q G.
        """
        covariances = self.effect.turn_covariances(priors)
        half = _trace(self.gram, covariances) / 2
        determinant = _determinant(covariances) * _determinant(self.gram)
        largest = half + np.sqrt(np.maximum(half * half - determinant, 0.0))
        return np.asarray(SEARCH_SIGMAS * np.sqrt(largest) / self.sigmas_px)

    def _fit(self, chosen: IntArray, priors: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Weighted least squares over some of the pairs, with the priors as one more equation for each image.

        Of a pair, JᵀJ = [[G, G / d], [G / d, G / d²]] and Jᵀ o = [Aᵀ o, Aᵀ o / d].
        """
        s, lights = len(priors), self.lights.take(chosen)
        effect = self.effect.take(lights)
        terms = np.empty((3, 5, len(lights)))  # powers of 1 / d; the elements of G, then Aᵀ o
        terms[0, :3] = self.gram.take(lights, axis=1)
        terms[0, 3:] = effect.pulled_back(self.offsets_px.take(chosen, axis=1))
        terms[0] /= np.square(self.sigmas_px.take(lights))
        np.multiply(terms[0], effect.nearness, out=terms[1])
        np.multiply(terms[1], effect.nearness, out=terms[2])
        of_image = np.zeros((len(lights), s))
        of_image[np.arange(len(lights)), effect.images] = 1.0
        sums = (terms.reshape(15, -1) @ of_image).T  # (s, 15)
        information = sums.take(_INFORMATION, axis=1)
        covariances = np.linalg.solve(_IDENTITY + priors @ information, priors)  # (P⁻¹ + JᵀJ)⁻¹
        pairs = np.bincount(effect.images, minlength=s)
        alone = (pairs == 0).nonzero()[0]
        if len(alone):
            covariances[alone] = priors[alone]
        return (covariances @ sums.take(_PULL, axis=1)[:, :, None])[..., 0], covariances, pairs

    def _vote(self, image: int, prior: FloatArray) -> tuple[FloatArray, FloatArray, int, bool]:
        """Let all pairs of one image vote."""
        lights = (self.effect.images == image).nonzero()[0]
        mine = (self.effect.images.take(self.lights) == image).nonzero()[0]
        rows, columns = self.lights.take(mine), self.detections.take(mine)
        return vote(
            self.offsets_px.take(mine, axis=1),
            rows - lights[0],
            columns - columns.min(initial=0),
            self.effect.take(lights).jacobians(),
            self.sigmas_px.take(lights),
            prior,
        )


# Where in the sums of `_Problem._fit` the elements of JᵀJ stand, and those of Jᵀ o.
_INFORMATION = np.array([[0, 1, 5, 6], [1, 2, 6, 7], [5, 6, 10, 11], [6, 7, 11, 12]])
_PULL = np.array([3, 4, 8, 9])
_IDENTITY = np.eye(4)


def _trace(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n,) traces of the products of symmetric matrices, given by (3, n) elements xx, xy, yy."""
    products = a * b
    return np.asarray(products[0] + 2 * products[1] + products[2])


def _determinant(a: FloatArray) -> FloatArray:
    """(n,) of symmetric matrices, given by (3, n) elements xx, xy, yy."""
    return np.asarray(a[0] * a[2] - a[1] * a[1])


def _alike(
    heights_a: FloatArray, heights_b: FloatArray, rows_a: IntArray, rows_b: IntArray
) -> tuple[IntArray, IntArray]:
    """Those of the pairs whose boxes are about equally high."""
    ratio = heights_a.take(rows_a) / np.maximum(heights_b.take(rows_b), 1e-9)
    alike = ((ratio < MAX_HEIGHT_RATIO) & (ratio > 1 / MAX_HEIGHT_RATIO)).nonzero()[0]
    return rows_a.take(alike), rows_b.take(alike)
