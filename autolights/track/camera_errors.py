"""How lights move in an image when the camera looks past its calibration, or the vehicle stands beside its pose.

An error e has two angles a (yaw and pitch, radians) and two lengths m (metres right and down). To a light at distance d
the lengths are angles m / d. With normalised coordinates p = (x, y) and F = diag(fx, fy) a point moves by

    du = F (I + p pᵀ) (a + m / d),

lens distortion left aside. So the Jacobian is J = [A, A / d] with A = F (I + p pᵀ), and all that is needed of it is

    G = AᵀA,   det G = (fx fy (1 + |p|²))²,   Aᵀ o = (I + p pᵀ) F o.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from autolights.core import CameraModel, FloatArray, IntArray
from autolights.core.camera import normalized_points
from autolights.core.shots import Shots

_NEAREST_M = 1.0
# From a (4, 4) covariance P of an error, row by row, to the elements xx, xy, yy of that of a + m / d as polynomials in
# 1 / d: P_aa, then P_am + P_ma, then P_mm.
_TURN_POWERS = np.zeros((16, 9))
_TURN_POWERS[[0, 1, 5], [0, 1, 2]] = 1
_TURN_POWERS[[2, 8, 3, 6, 7, 13], [3, 3, 4, 4, 5, 5]] = 1
_TURN_POWERS[[10, 11, 15], [6, 7, 8]] = 1


@dataclass(frozen=True, eq=False)
class ErrorEffect:
    """What errors do to n points in several images.

    Attributes:
        images: (n,) which image each point lies in.
        points: (2, n) normalised coordinates.
        focal_px: (2, n).
        nearness: (n,) one over the distance in metres.
    """

    images: IntArray
    points: FloatArray
    focal_px: FloatArray
    nearness: FloatArray

    @classmethod
    def of(cls, points_px: FloatArray, distances_m: FloatArray, shots: Shots, images: IntArray) -> Self:
        """(2, n) pixels at (n,) distances in (n,) images."""
        return cls(
            images,
            shots.normalized(points_px, images),
            shots.optics.focal_px.take(images, axis=1),
            1 / np.maximum(distances_m, _NEAREST_M),
        )

    def take(self, rows: IntArray) -> "ErrorEffect":
        """Some of the points."""
        return ErrorEffect(
            self.images.take(rows),
            self.points.take(rows, axis=1),
            self.focal_px.take(rows, axis=1),
            self.nearness.take(rows),
        )

    def shifts_px(self, errors: FloatArray) -> FloatArray:
        """(2, n) by how much the points move with (images, 4) errors."""
        columns = errors.T.take(self.images, axis=1)
        return self.focal_px * self._bent(columns[:2] + columns[2:] * self.nearness)

    def pulled_back(self, offsets_px: FloatArray) -> FloatArray:
        """(2, n) Aᵀ o of (2, n) offsets."""
        return self._bent(self.focal_px * offsets_px)

    def gram(self) -> FloatArray:
        """(3, n) the elements xx, xy, yy of G = AᵀA."""
        squares, xy = self.focal_px * self.focal_px, self.points[0] * self.points[1]
        diagonal = 1 + self.points * self.points  # of I + p pᵀ; xy is beside it
        along, across = squares * diagonal, squares * xy
        elements = np.empty((3, len(xy)))
        elements[::2] = along * diagonal + across[::-1] * xy
        elements[1] = (along[0] + along[1]) * xy
        return elements

    def turn_covariances(self, covariances: FloatArray) -> FloatArray:
        """(3, n) elements xx, xy, yy of the covariance of a + m / d, from (images, 4, 4) of the errors."""
        # Powers 0, 1, 2 of the nearness, of each element.
        powers = (covariances.reshape(-1, 16) @ _TURN_POWERS).T.take(self.images, axis=1)
        return np.asarray(powers[:3] + self.nearness * (powers[3:6] + self.nearness * powers[6:]))

    def jacobians(self) -> FloatArray:
        """(n, 2, 4) J: pixels per radian of yaw and pitch, and per metre right and down."""
        (x, y), (fx, fy) = self.points, self.focal_px
        angles = np.array([[fx * (1 + x * x), fx * x * y], [fy * x * y, fy * (1 + y * y)]])
        return np.ascontiguousarray(np.concatenate([angles, angles * self.nearness], axis=1).transpose(2, 0, 1))

    def _bent(self, vectors: FloatArray) -> FloatArray:
        """(2, n) (I + p pᵀ) v."""
        along = self.points * vectors
        return np.asarray(vectors + self.points * (along[0] + along[1]))


def error_jacobians(points_px: FloatArray, distances_m: FloatArray, camera: CameraModel) -> FloatArray:
    """How points of one image move with the error.

    Args:
        points_px: (n, 2).
        distances_m: (n,).
        camera: The camera.

    Returns:
        (n, 2, 4) pixels per radian of yaw and pitch, and per metre right and down.
    """
    n = len(points_px)
    focal_px = np.array([[camera.intrinsics[0, 0]], [camera.intrinsics[1, 1]]])
    effect = ErrorEffect(
        np.zeros(n, dtype=np.int64),
        normalized_points(points_px, camera).T,
        np.broadcast_to(focal_px, (2, n)),
        1 / np.maximum(distances_m, _NEAREST_M),
    )
    return effect.jacobians()
