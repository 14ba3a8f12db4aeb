import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from autolights.core import Pose, PoseBuffer
from autolights.core.errors import PoseError

MS = 1_000_000  # ns
START_NS = 1_700_000_000_000_000_000  # beyond what a float64 holds to the nanosecond


def pose(stamp_ms, x=0.0, yaw_deg=0.0):
    quaternion = Rotation.from_euler("z", yaw_deg, degrees=True).as_quat()
    return Pose(START_NS + round(stamp_ms * MS), np.array([x, 0.0, 0.0]), quaternion)


def buffer(*poses, **limits):
    return PoseBuffer(poses, **limits)


@given(st.integers(0, 2**32 - 1), st.integers(0, 40 * MS))
def test_interpolation_agrees_with_scipy(seed, offset_ns):
    random = np.random.default_rng(seed)
    stamps = START_NS + np.array([0, 20, 40]) * MS
    rotations, positions = Rotation.random(3, rng=random), random.normal(size=(3, 3)) * 1e6
    poses = PoseBuffer(map(Pose, stamps.tolist(), positions, rotations.as_quat()))

    at = poses.at(START_NS + offset_ns)

    seconds = (stamps - START_NS) / 1e9
    wanted = [np.interp(offset_ns / 1e9, seconds, column) for column in positions.T]
    np.testing.assert_allclose(at.position, wanted, atol=1e-6)
    turned = Rotation.from_quat(at.quaternion_xyzw).inv() * Slerp(seconds, rotations)(offset_ns / 1e9)
    assert turned.magnitude() < 1e-6
    assert at.stamp_ns == START_NS + offset_ns


def test_a_stamp_that_is_there_is_returned_as_it_is():
    exact = pose(10, x=7.0)

    assert buffer(pose(0), exact, pose(20)).at(exact.stamp_ns) is exact


def test_poses_may_arrive_late_and_twice():
    poses = buffer(pose(0, x=0), pose(20, x=9))
    poses.add(pose(10, x=5))
    poses.add(pose(20, x=6))

    assert len(poses) == 3
    assert poses.at(START_NS + 5 * MS).position[0] == pytest.approx(2.5)
    assert poses.at(START_NS + 15 * MS).position[0] == pytest.approx(5.5)


def test_of_equal_stamps_the_last_pose_counts():
    poses = buffer(pose(20, x=9), pose(0, x=0), pose(20, x=1))

    assert len(poses) == 2
    assert poses.at(START_NS + 40 * MS).position[0] == pytest.approx(2)


def test_motion_goes_on_for_a_moment_beyond_the_last_pose():
    poses = buffer(pose(0, x=0.0, yaw_deg=0), pose(20, x=1.0, yaw_deg=20))

    beyond = poses.at(START_NS + 40 * MS)

    assert beyond.position[0] == pytest.approx(2)
    assert Rotation.from_quat(beyond.quaternion_xyzw).as_euler("zyx", degrees=True)[0] == pytest.approx(40)


@pytest.mark.parametrize(
    ("poses", "stamp_ms", "message"),
    [
        pytest.param([], 0, "no pose at stamp .*: no poses have arrived", id="empty"),
        pytest.param([pose(0), pose(20)], 71, r"it misses by 0.051 s \(allowed: 0.050 s\)", id="too-late"),
        pytest.param([pose(0), pose(20)], -60, r"it misses by 0.060 s \(allowed: 0.050 s\)", id="too-early"),
        pytest.param([pose(0)], 10, "it misses by 0.010 s", id="one-pose-says-nothing-of-motion"),
        pytest.param([pose(0), pose(300)], 150, r"are 0.300 s apart \(allowed: 0.200 s\)", id="gap"),
    ],
)
def test_stamps_without_a_pose(poses, stamp_ms, message):
    with pytest.raises(PoseError, match=message):
        buffer(*poses).at(START_NS + stamp_ms * MS)


def test_extrapolation_can_be_forbidden():
    with pytest.raises(PoseError, match=r"allowed: 0.000 s"):
        buffer(pose(0), pose(20), max_extrapolation_s=0).at(START_NS + 21 * MS)


def test_old_poses_are_forgotten():
    poses = PoseBuffer(history_s=0.1)
    for stamp_ms in range(0, 1000, 10):
        poses.add(pose(stamp_ms))

    assert len(poses) == 11
    with pytest.raises(PoseError, match="which it misses"):
        poses.at(START_NS)


def test_vehicle_frame_in_the_map():
    matrix = pose(0, x=5, yaw_deg=90).utm_from_ins

    np.testing.assert_allclose(matrix @ [2, 0, 0, 1], [5, 2, 0, 1], atol=1e-12)


def test_quaternion_must_be_a_rotation():
    with pytest.raises(ValueError, match="quaternion_xyzw must have length 1, got 0"):
        Pose(0, np.zeros(3), np.zeros(4))
    assert np.linalg.norm(Pose(0, np.zeros(3), np.array([0, 0, 0, 1.05])).quaternion_xyzw) == pytest.approx(1)
