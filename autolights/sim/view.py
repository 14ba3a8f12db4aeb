"""A camera in the town: points and polygons of the town frame onto the image."""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from autolights.core import CameraModel, FloatArray, back_project, project_points
from autolights.core.transforms import invert_rigid, transform_points

RAY_GRID = 4  # rays are computed for every fourth pixel and interpolated between
_NEAR_M = 0.4
_GUARD = 1.6  # polygons are cut at this multiple of the image's half width, far outside the picture


@dataclass(frozen=True, eq=False)
class View:
    """One camera at one instant.

    Attributes:
        camera: Lens and size.
        town_from_ins: (4, 4) the true pose of the vehicle.
    """

    camera: CameraModel
    town_from_ins: FloatArray
    cam_from_town: FloatArray = field(init=False)
    town_from_cam: FloatArray = field(init=False)
    _planes: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        cam_from_town = self.camera.cam_from_ins @ invert_rigid(self.town_from_ins)
        object.__setattr__(self, "cam_from_town", cam_from_town)
        object.__setattr__(self, "town_from_cam", invert_rigid(cam_from_town))
        (width, height), k = self.camera.size_wh, self.camera.intrinsics
        across, down = _GUARD * width / 2 / k[0, 0], _GUARD * height / 2 / k[1, 1]
        # Rows (a, b, c, d): a x + b y + c z + d >= 0 inside the guarded pyramid.
        planes = [[0, 0, 1, -_NEAR_M], [1, 0, across, 0], [-1, 0, across, 0], [0, 1, down, 0], [0, -1, down, 0]]
        object.__setattr__(self, "_planes", np.array(planes, dtype=np.float64))

    @property
    def position(self) -> FloatArray:
        """(3,) the camera's centre in the town."""
        return self.town_from_cam[:3, 3]

    def rays(self) -> FloatArray:
        """(h, w, 3) unit rays in the town frame, one for each block of `RAY_GRID` x `RAY_GRID` pixels."""
        return np.asarray(_camera_rays(self.camera) @ self.town_from_cam[:3, :3].T)

    def depth_m(self, point_town: FloatArray) -> float:
        """Distance of a (3,) point along the optical axis."""
        return float(self.cam_from_town[2, :3] @ point_town + self.cam_from_town[2, 3])

    def project(self, points_town: FloatArray) -> FloatArray:
        """(..., 3) metres → (..., 2) pixels; NaN behind the camera."""
        return project_points(transform_points(self.cam_from_town, points_town), self.camera)

    def project_inside(self, points_town: FloatArray) -> FloatArray | None:
        """(n, 2) pixels if all n points lie in the guarded pyramid, else None."""
        points = transform_points(self.cam_from_town, points_town)
        distances = points @ self._planes[:, :3].T + self._planes[:, 3]
        return project_points(points, self.camera) if (distances >= 0).all() else None

    def polygon(self, corners_town: FloatArray) -> FloatArray | None:
        """Cut a convex (n, 3) polygon at the guarded pyramid and project it: (m, 2) pixels, None if nothing is left."""
        points = transform_points(self.cam_from_town, corners_town)
        distances = points @ self._planes[:, :3].T + self._planes[:, 3]
        if (distances < 0).all(axis=0).any():
            return None
        for i in np.flatnonzero((distances < 0).any(axis=0)):
            points = _cut(points, self._planes[i])
            if len(points) < 3:
                return None
        return project_points(points, self.camera)


def _cut(points: FloatArray, plane: FloatArray) -> FloatArray:
    """The part of a convex polygon on a plane's positive side (one step of Sutherland and Hodgman 1974)."""
    distance = points @ plane[:3] + plane[3]
    kept: list[FloatArray] = []
    for i in range(len(points)):
        before, here = distance[i - 1], distance[i]
        if (before < 0) != (here < 0):
            kept.append(points[i - 1] + before / (before - here) * (points[i] - points[i - 1]))
        if here >= 0:
            kept.append(points[i])
    return np.array(kept).reshape(-1, 3)


@lru_cache(maxsize=8)
def _camera_rays(camera: CameraModel) -> FloatArray:
    """(h, w, 3) unit rays of every fourth pixel's block, in the camera frame."""
    # Block middles, exact for any size: cv2.resize maps the grid back onto the whole image in the same way.
    columns, rows = ((np.arange(-(-n // RAY_GRID)) + 0.5) * (n / -(-n // RAY_GRID)) - 0.5 for n in camera.size_wh)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays = back_project(pixels, camera)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return rays.reshape(len(rows), len(columns), 3)
