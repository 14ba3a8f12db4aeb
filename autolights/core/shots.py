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
        distortion: (8, s, 1) k1 k2 p1 p2 k3 k4 k5 k6, zeros where a camera has fewer.
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
    distortion: FloatArray
    max_radius2: FloatArray
    size_wh: FloatArray
    range_m: FloatArray
    cam_from_ins: FloatArray
    lens: FloatArray
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
            distortion=distortion[:, :, None],
            max_radius2=np.array([[camera.max_radius**2] for camera in cameras]),
            size_wh=np.array([camera.size_wh for camera in cameras], dtype=np.float64).T.copy(),
            range_m=np.array([camera.max_range_m for camera in cameras]),
            cam_from_ins=mounting[:, :3, :3].copy(),
            lens=-(mounting[:, :3, :3].swapaxes(1, 2) @ mounting[:, :3, 3:])[..., 0],
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
            (s, 2, n) left and top edges, (s, 2, n) right and bottom ones, in pixels; NaN where a corner does not
            project.
        """
        s, (_, c, n) = len(self), corners.shape
        rotation = self.cam_from_utm
        points = rotation @ corners.reshape(3, c * n)
        points -= rotation @ (self.lens - origin)[:, :, None]
        depth = points[:, 2]
        scale = np.divide(1.0, depth, out=np.full_like(depth, np.nan), where=depth > 0)
        x: FloatArray = points[:, 0] * scale
        y: FloatArray = points[:, 1] * scale
        optics = self.optics
        if optics.is_distorted:
            x, y = _distorted(x, y, optics)
        (fx, fy), (cx, cy) = optics.focal_px[..., None], optics.centre_px[..., None]
        # Half a pixel: points count from the centre of the top-left pixel, boxes from its corner.
        pixels = np.empty((s, 2, c, n))
        pixels[:, 0] = (fx * x + optics.skew_px[:, None] * y + (cx + 0.5)).reshape(s, c, n)
        pixels[:, 1] = (fy * y + (cy + 0.5)).reshape(s, c, n)
        return pixels.min(axis=2), pixels.max(axis=2)

    def normalized(self, points_px: FloatArray, images: IntArray) -> FloatArray:
        """`core.camera.normalized_points` of points in different images.

        Args:
            points_px: (2, n) pixels.
            images: (n,) which image each lies in.

        Returns:
            (2, n) x / z and y / z as the lens has bent them.
        """
        optics = self.optics
        (x, y), (fx, fy) = points_px - optics.centre_px[:, images], optics.focal_px[:, images]
        y = y / fy
        return np.array([(x - optics.skew_px[images] * y) / fx, y])

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
            bounds = np.searchsorted(images, np.arange(len(self) + 1)).tolist()
            for camera, start, end in zip(self.optics.cameras, bounds[:-1], bounds[1:], strict=True):
                if start < end and len(camera.distortion):
                    bent = np.ascontiguousarray(points[:, start:end].T)[:, None]
                    straight = cv2.undistortPoints(bent, _IDENTITY, camera.distortion, criteria=_CRITERIA)
                    points[:, start:end] = straight[:, 0].T
        return points


def _distorted(x: FloatArray, y: FloatArray, optics: Optics) -> tuple[FloatArray, FloatArray]:
    """(s, n) points x / z and y / z as the lenses bend them; NaN beyond the radius up to which they are one to one."""
    k1, k2, p1, p2, k3, k4, k5, k6 = optics.distortion
    r2 = x * x + y * y
    r2[~(r2 < optics.max_radius2)] = np.nan
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if optics.is_rational:
        radial /= 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    xy2 = 2 * x * y
    return x * radial + p1 * xy2 + p2 * (r2 + 2 * x * x), y * radial + p2 * xy2 + p1 * (r2 + 2 * y * y)
