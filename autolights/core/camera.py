"""A camera: intrinsics, lens distortion, mounting; projection and back-projection.

Camera frame: x right, y down, z forward, metres. Points in the image: (0, 0) is the centre of the top-left pixel.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np

from autolights.core.arrays import FloatArray, as_float_array
from autolights.core.errors import CalibrationError
from autolights.core.transforms import check_rigid

_COEFFICIENT_COUNTS = (0, 4, 5, 8)


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A calibrated pinhole camera with Brown-Conrady (rational) distortion.

    Attributes:
        name: Unique in a rig.
        size_wh: Width and height in pixels.
        intrinsics: (3, 3) K, pixels.
        distortion: (0,), (4,), (5,) or (8,): k1 k2 p1 p2 [k3 [k4 k5 k6]], OpenCV's order.
        cam_from_ins: (4, 4) rigid; vehicle frame (x forward, y left, z up) to camera frame.
        max_range_m: Lights farther away are not expected from this camera.

    Raises:
        CalibrationError: If K is singular or not upper triangular, the mounting not rigid, or a number not finite.
    """

    name: str
    size_wh: tuple[int, int]
    intrinsics: FloatArray
    distortion: FloatArray
    cam_from_ins: FloatArray
    max_range_m: float
    max_radius: float = field(init=False)  # of an undistorted ray x/z, y/z up to which the distortion is one to one

    def __post_init__(self) -> None:
        try:
            intrinsics = as_float_array(self.intrinsics, (3, 3), "intrinsics")
            distortion = as_float_array(self.distortion, (None,), "distortion")
            cam_from_ins = as_float_array(self.cam_from_ins, (4, 4), "cam_from_ins")
            check_rigid(cam_from_ins, "cam_from_ins")
        except ValueError as error:
            raise CalibrationError(f"camera '{self.name}': {error}") from error
        if not (intrinsics[0, 0] > 0 and intrinsics[1, 1] > 0 and np.allclose(intrinsics[2], [0, 0, 1])):
            raise CalibrationError(
                f"camera '{self.name}': intrinsics must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0 "
                f"(a singular K projects nothing), got {intrinsics.tolist()}"
            )
        if intrinsics[1, 0] != 0:
            raise CalibrationError(f"camera '{self.name}': intrinsics[1][0] must be 0, got {intrinsics[1, 0]}")
        if len(distortion) not in _COEFFICIENT_COUNTS:
            raise CalibrationError(
                f"camera '{self.name}': distortion must have {_COEFFICIENT_COUNTS} coefficients, got {len(distortion)}"
            )
        if min(self.size_wh) <= 0:
            raise CalibrationError(f"camera '{self.name}': size must be positive, got {self.size_wh}")
        if not (np.isfinite(self.max_range_m) and self.max_range_m > 0):
            raise CalibrationError(f"camera '{self.name}': max_range_m must be positive, got {self.max_range_m}")
        object.__setattr__(self, "intrinsics", intrinsics)
        object.__setattr__(self, "distortion", distortion)
        object.__setattr__(self, "cam_from_ins", cam_from_ins)
        object.__setattr__(self, "max_radius", _max_radius(distortion))

    @property
    def horizontal_fov_deg(self) -> float:
        """Horizontal field of view of the pinhole, distortion left aside."""
        width = self.size_wh[0]
        left = (self.intrinsics[0, 2] + 0.5) / self.intrinsics[0, 0]
        right = (width - 0.5 - self.intrinsics[0, 2]) / self.intrinsics[0, 0]
        return float(np.degrees(np.arctan(left) + np.arctan(right)))


def project_points(points_cam: FloatArray, camera: CameraModel) -> FloatArray:
    """Project points from the camera frame onto the image plane (the paper's projection equation, with distortion).

    Points at or behind the camera, or outside the angle in which the lens model is one to one, become NaN, so a
    mirrored point can never pass for a visible one.

    Args:
        points_cam: (..., 3) metres; x right, y down, z forward.
        camera: The camera; its mounting is not used here.

    Returns:
        (..., 2) pixels (u, v); (0, 0) is the centre of the top-left pixel. They may lie outside the image.

    Raises:
        ValueError: If `points_cam` does not end in 3.

    References:
        Wu et al. 2023, Sec. III-B; OpenCV, "Camera Calibration and 3D Reconstruction".
    """
    if points_cam.shape[-1:] != (3,):
        raise ValueError(f"points_cam must be (..., 3), got {points_cam.shape}")
    depth = points_cam[..., 2]
    in_front = depth > 0
    scale = np.divide(1.0, depth, out=np.full_like(depth, np.nan), where=in_front)
    x, y = points_cam[..., 0] * scale, points_cam[..., 1] * scale
    if len(camera.distortion):
        x, y = _distort(x, y, camera)
    k = camera.intrinsics
    return np.stack([k[0, 0] * x + k[0, 1] * y + k[0, 2], k[1, 1] * y + k[1, 2]], axis=-1)


def normalized_points(pixels: FloatArray, camera: CameraModel) -> FloatArray:
    """(n, 2) pixels → (n, 2) x / z and y / z as the lens has bent them: K taken off, distortion left in."""
    k = camera.intrinsics
    y = (pixels[:, 1] - k[1, 2]) / k[1, 1]
    x = (pixels[:, 0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
    return np.stack([x, y], axis=1)


def back_project(pixels: FloatArray, camera: CameraModel) -> FloatArray:
    """Turn pixels into rays: the inverse of `project_points` up to depth.

    Args:
        pixels: (n, 2) points (u, v); (0, 0) is the centre of the top-left pixel.
        camera: The camera.

    Returns:
        (n, 3) rays (x, y, 1) in the camera frame; multiply by the depth in metres to get the point.
    """
    points = normalized_points(np.asarray(pixels, dtype=np.float64).reshape(-1, 2), camera)
    rays = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    if len(rays) and len(camera.distortion):
        # K is taken off above because OpenCV leaves its skew aside.
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
        distorted = rays[:, None, :2].copy()
        rays[:, :2] = cv2.undistortPoints(distorted, np.eye(3), camera.distortion, criteria=criteria)[:, 0]
    return rays


def _distort(x: FloatArray, y: FloatArray, camera: CameraModel) -> tuple[FloatArray, FloatArray]:
    k1, k2, p1, p2, k3, k4, k5, k6 = _all_coefficients(camera.distortion)
    r2 = x * x + y * y
    r2 = np.where(r2 < camera.max_radius**2, r2, np.nan)
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if k4 or k5 or k6:
        radial = radial / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    xy2 = 2 * x * y
    return x * radial + p1 * xy2 + p2 * (r2 + 2 * x * x), y * radial + p2 * xy2 + p1 * (r2 + 2 * y * y)


def _all_coefficients(distortion: FloatArray) -> list[float]:
    return [*map(float, distortion), *[0.0] * (8 - len(distortion))]


def _max_radius(distortion: FloatArray) -> float:
    """Smallest radius at which r · radial(r²) stops growing; beyond it the model folds the image back."""
    k1, k2, _, _, k3, k4, k5, k6 = _all_coefficients(distortion)
    # f(r) = r N(s) / D(s) with s = r²; f' = 0  ⇔  (N + 2 s N') D - 2 s N D' = 0
    numerator, denominator = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
    s = np.poly1d([1.0, 0.0])
    slope = (numerator + 2 * s * numerator.deriv()) * denominator - 2 * s * numerator * denominator.deriv()
    roots = np.concatenate([slope.roots, denominator.roots])
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return float(np.sqrt(real.min())) if len(real) else float("inf")
