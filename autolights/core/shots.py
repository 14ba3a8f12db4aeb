"""The images of one set of frames side by side: where each camera stood and how it looks, as arrays over all of them.

A set has few images and an image few lights, so what geometry costs is the number of calls, not of numbers: one call
serves all images. Coordinates come first and points last, because numpy is fast along the last axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import cv2
import numpy as np

from autolights.core.arrays import FloatArray, IntArray
from autolights.core.camera import CameraModel
from autolights.core.pose import Pose

_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
_IDENTITY = np.eye(3)


@dataclass(frozen=True, eq=False)
class Optics:
    """The numbers of s cameras in columns.

    Attributes:
        cameras: The cameras.
        focal_px: (2, s) fx and fy.
        skew_px: (s,).
        centre_px: (2, s) principal points; as of points, (0, 0) is the centre of the top-left pixel.
        radial: (6, s, 1) k1 k2 k3 k4 k5 k6, zeros where a camera has fewer.
        tangential: (2, s, 1) p2 and p1, those of x and of y.
        max_radius2: (s, 1) squares of `CameraModel.max_radius`.
        size_wh: (2, s) pixels.
        range_m: (s,).
        cam_from_ins: (s, 3, 3) rotations.
        lens: (s, 3) metres: where the lenses are in the vehicle frame.
    """

    cameras: tuple[CameraModel, ...]
    focal_px: FloatArray
    skew_px: FloatArray
    centre_px: FloatArray
    radial: FloatArray
    tangential: FloatArray
    max_radius2: FloatArray
    size_wh: FloatArray
    range_m: FloatArray
    cam_from_ins: FloatArray
    lens: FloatArray
    is_skewed: bool
    is_distorted: bool
    is_rational: bool

    @classmethod
    @lru_cache(maxsize=32)
    def of(cls, cameras: tuple[CameraModel, ...]) -> Self:
        """These cameras, in this order; remembered, since the same few sets of them come again and again."""
        k = np.array([camera.intrinsics for camera in cameras])
        mounting = np.array([camera.cam_from_ins for camera in cameras])
        distortion = np.zeros((8, len(cameras)))
        for column, camera in enumerate(cameras):
            distortion[: len(camera.distortion), column] = camera.distortion
        return cls(
            cameras=cameras,
            focal_px=np.array([k[:, 0, 0], k[:, 1, 1]]),
            skew_px=k[:, 0, 1].copy(),
            centre_px=np.array([k[:, 0, 2], k[:, 1, 2]]),
            radial=distortion[[0, 1, 4, 5, 6, 7], :, None],
            tangential=distortion[[3, 2], :, None],
            max_radius2=np.array([[camera.max_radius**2] for camera in cameras]),
            size_wh=np.array([camera.size_wh for camera in cameras], dtype=np.float64).T.copy(),
            range_m=np.array([camera.max_range_m for camera in cameras]),
            cam_from_ins=mounting[:, :3, :3].copy(),
            lens=-(mounting[:, :3, :3].swapaxes(1, 2) @ mounting[:, :3, 3:])[..., 0],
            is_skewed=bool(k[:, 0, 1].any()),
            is_distorted=bool(distortion.any()),
            is_rational=bool(distortion[5:].any()),
        )


@dataclass(frozen=True, eq=False)
class Shots:
    """s images with the vehicle's pose at each one's stamp.

    Attributes:
        optics: Of their cameras.
        poses: One for each image.
        vehicle: (s, 3) metres: where the vehicle was.
        lens: (s, 3) metres: where the lens was.
        cam_from_utm: (s, 3, 3) rotations.
    """

    optics: Optics
    poses: tuple[Pose, ...]
    vehicle: FloatArray
    lens: FloatArray
    cam_from_utm: FloatArray

    @classmethod
    def of(cls, cameras: Sequence[CameraModel], poses: Sequence[Pose]) -> Self:
        """At least one image."""
        optics = Optics.of(tuple(cameras))
        utm_from_ins = np.array([pose.utm_from_ins for pose in poses])
        rotation, vehicle = utm_from_ins[:, :3, :3], utm_from_ins[:, :3, 3]
        lens = vehicle + (rotation @ optics.lens[:, :, None])[..., 0]
        return cls(optics, tuple(poses), vehicle, lens, optics.cam_from_ins @ rotation.swapaxes(1, 2))

    def __len__(self) -> int:
        return len(self.poses)

    def project_outlines(self, corners: FloatArray, origin: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image boxes around housings: `core.light_box.project_corners` for all images.

        Args:
            corners: (3, c, n) metres from the origin: c corners of each of n housings.
            origin: (3,) metres, map frame, near the vehicle: so no digits are lost.

        Returns:
            (2, s, n) left and top edges, (2, s, n) right and bottom ones, in pixels; NaN where a corner does not
            project.
        """
        s, (_, c, n), optics = len(self), corners.shape, self.optics
        rotation = self.cam_from_utm
        points = rotation @ corners.reshape(3, c * n)
        points -= rotation @ (self.lens - origin)[:, :, None]
        depth = points[:, 2]
        behind = depth <= 0
        if np.count_nonzero(behind):
            depth[behind] = np.nan
        rays: FloatArray = points.swapaxes(0, 1)[:2] / depth  # (2, s, c n): x / z and y / z
        if optics.is_distorted:
            rays = _distorted(rays, optics)
        pixels = optics.focal_px[:, :, None] * rays
        if optics.is_skewed:
            pixels[0] += optics.skew_px[:, None] * rays[1]
        # Half a pixel: points count from the centre of the top-left pixel, boxes from its corner.
        pixels += (optics.centre_px + 0.5)[:, :, None]
        outlines = pixels.reshape(2, s, c, n)
        return np.minimum.reduce(outlines, axis=2), np.maximum.reduce(outlines, axis=2)

    def normalized(self, points_px: FloatArray, images: IntArray) -> FloatArray:
        """`core.camera.normalized_points` of points in different images.

        Args:
            points_px: (2, n) pixels.
            images: (n,) which image each lies in.

        Returns:
            (2, n) x / z and y / z as the lens has bent them.
        """
        optics = self.optics
        points = points_px - optics.centre_px.take(images, axis=1)
        points /= optics.focal_px.take(images, axis=1)
        if optics.is_skewed:
            points[0] -= (optics.skew_px / optics.focal_px[0]).take(images) * points[1]
        return points

    def back_project(self, points_px: FloatArray, images: IntArray) -> FloatArray:
        """`core.camera.back_project` of points in different images.

        Args:
            points_px: (2, n) pixels.
            images: (n,) which image each lies in, ascending.

        Returns:
            (2, n) x / z and y / z of their rays in the camera frame, distortion taken off.
        """
        points = self.normalized(points_px, images)
        if self.optics.is_distorted:
            bounds = images.searchsorted(range(len(self) + 1)).tolist()
            for camera, start, end in zip(self.optics.cameras, bounds[:-1], bounds[1:], strict=True):
                if start < end and len(camera.distortion):
                    bent = np.ascontiguousarray(points[:, start:end].T)[:, None]
                    straight = cv2.undistortPoints(bent, _IDENTITY, camera.distortion, criteria=_CRITERIA)
                    points[:, start:end] = straight[:, 0].T
        return points


def _distorted(rays: FloatArray, optics: Optics) -> FloatArray:
    """(2, s, n) points p = (x / z, y / z) as the lenses bend them; NaN beyond the radius to which they are one to one.

    Brown-Conrady's tangential part, 2 p1 x y + p2 (r² + 2 x²) and 2 p2 x y + p1 (r² + 2 y²), is 2 t p + r² (p2, p1)
    with t = p2 x + p1 y.
    """
    k1, k2, k3, k4, k5, k6 = optics.radial
    squares = rays * rays
    r2 = squares[0] + squares[1]
    outside = r2 >= optics.max_radius2
    if np.count_nonzero(outside):
        r2[outside] = np.nan
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if optics.is_rational:
        radial /= 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    tilted = optics.tangential * rays
    radial += 2 * (tilted[0] + tilted[1])
    return np.asarray(rays * radial + optics.tangential * r2)
