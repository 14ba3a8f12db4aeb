import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from autolights.core.transforms import (
    CAMERA_AXES_FROM_VEHICLE_AXES,
    check_rigid,
    invert_rigid,
    matrix_from_quaternion,
    rigid,
    slerp,
    transform_points,
)

seeds = st.integers(0, 2**32 - 1)


def random_rotations(seed, n=2):
    return Rotation.random(n, rng=np.random.default_rng(seed))


@given(seeds)
def test_rotation_matrix_agrees_with_scipy(seed):
    rotation = random_rotations(seed, 1)

    np.testing.assert_allclose(matrix_from_quaternion(3 * rotation.as_quat()[0]), rotation.as_matrix()[0], atol=1e-12)


@given(seeds, st.floats(0, 1), st.booleans())
def test_slerp_agrees_with_scipy(seed, fraction, flipped):
    ends = random_rotations(seed)
    start, end = ends.as_quat()
    wanted = Slerp([0, 1], ends)(fraction)

    got = Rotation.from_quat(slerp(start, -end if flipped else end, fraction))

    assert (got.inv() * wanted).magnitude() < 1e-7


def test_slerp_of_nearly_parallel_rotations():
    ends = Rotation.from_rotvec([[0, 0, 0.3], [0, 0, 0.31]])

    halfway = Rotation.from_quat(slerp(*ends.as_quat(), 0.5))

    np.testing.assert_allclose(halfway.as_rotvec(), [0, 0, 0.305], atol=1e-8)


@given(seeds)
def test_inverse_undoes(seed):
    random = np.random.default_rng(seed)
    b_from_a = rigid(random_rotations(seed, 1).as_matrix()[0], random.normal(size=3) * 100)
    points = random.normal(size=(5, 3))

    back = transform_points(invert_rigid(b_from_a), transform_points(b_from_a, points))

    np.testing.assert_allclose(back, points, atol=1e-10)
    check_rigid(b_from_a, "b_from_a")


def test_camera_axes():
    vehicle = np.eye(3)  # forward, left, up

    np.testing.assert_array_equal(vehicle @ CAMERA_AXES_FROM_VEHICLE_AXES.T, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def test_last_row_of_a_rigid_transform():
    matrix = np.eye(4)
    matrix[3, 0] = 1

    with pytest.raises(ValueError, match=r"cam_from_ins must end in the row 0 0 0 1, got \[1.0, 0.0, 0.0, 1.0\]"):
        check_rigid(matrix, "cam_from_ins")
