import cv2
import numpy as np
import pytest

from autolights.core import CameraModel, Pose, TrafficLightMap
from autolights.core.light_box import light_corners
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, invert_rigid, rigid
from autolights.track import join_projected, project_lights

ORIGIN = np.array([500_000.0, 4_800_000.0, 200.0])
EAST = Pose(0, ORIGIN, np.array([0.0, 0.0, 0.0, 1.0]))


@pytest.fixture(scope="module")
def camera() -> CameraModel:
    return CameraModel(
        name="front",
        size_wh=(1280, 800),
        intrinsics=np.array([[1000.0, 0, 639.5], [0, 1000, 399.5], [0, 0, 1]]),
        distortion=np.array([-0.1, 0.02, 0.001, -0.001]),
        cam_from_ins=rigid(CAMERA_AXES_FROM_VEHICLE_AXES, np.array([0.1, 1.2, -0.5])),
        max_range_m=60.0,
    )


def lights_at(*offsets: tuple[float, float, float], heading_deg: float = 270.0) -> TrafficLightMap:
    n = len(offsets)
    return TrafficLightMap(
        ids=tuple(map(str, range(n))),
        types=("3", "5dh")[:n] if n <= 2 else ("3",) * n,
        positions=ORIGIN + np.array(offsets).reshape(-1, 3),
        headings_deg=np.full(n, heading_deg),
        sizes_m=np.tile([0.4, 1.0, 0.3], (n, 1)),
    )


def test_boxes_are_those_of_opencv(camera: CameraModel) -> None:
    turn = np.radians(4)
    pose = Pose(0, ORIGIN + np.array([3.0, -1.0, 0.2]), np.array([0, 0, np.sin(turn / 2), np.cos(turn / 2)]))
    lights = lights_at((35.0, 2.0, 5.0), (50.0, -3.0, 6.0))
    projected = project_lights(lights, camera, pose)
    cam_from_utm = camera.cam_from_ins @ invert_rigid(pose.utm_from_ins)
    rotation, _ = cv2.Rodrigues(cam_from_utm[:3, :3])
    for i, corners in enumerate(light_corners(lights.positions, lights.headings_deg, lights.sizes_m)):
        # OpenCV works around the vehicle: UTM coordinates would cost it digits.
        shift = cam_from_utm[:3, 3] + cam_from_utm[:3, :3] @ ORIGIN
        pixels = cv2.projectPoints(corners - ORIGIN, rotation, shift, camera.intrinsics, camera.distortion)[0][:, 0]
        expected = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)]) + 0.5
        np.testing.assert_allclose(projected.boxes_xyxy[i], expected, atol=1e-5)
    assert projected.types.tolist() == ["3", "5dh"]


@pytest.mark.parametrize(
    ("offset", "heading_deg", "kept", "expected"),
    [
        pytest.param((40, 0, 4), 270, True, True, id="ahead"),
        pytest.param((-40, 0, 4), 90, False, False, id="behind-is-never-mirrored"),
        pytest.param((40, 0, 4), 90, False, False, id="faces-away"),
        pytest.param((40, 0, 4), 185, True, True, id="seen-from-the-side"),
        pytest.param((40, 60, 4), 270, False, False, id="left-of-the-image"),
        pytest.param((40, 26.3, 4), 270, True, False, id="cut-by-the-image"),
        pytest.param((75, 0, 4), 270, True, False, id="seen-but-not-expected-beyond-range"),
        pytest.param((125, 0, 4), 270, False, False, id="far-beyond-range"),
        pytest.param((0.55, 0, 1), 270, False, False, id="a-corner-behind-the-camera"),
    ],
)
def test_only_lights_in_view_are_projected(
    camera: CameraModel, offset: tuple[float, float, float], heading_deg: float, kept: bool, expected: bool
) -> None:
    projected = project_lights(lights_at(offset, heading_deg=heading_deg), camera, EAST)
    assert len(projected) == kept
    assert projected.expected.tolist() == [expected] * kept


def test_rows_point_into_the_map(camera: CameraModel) -> None:
    lights = lights_at((-20, 0, 4), (40, 0, 4), (30, 80, 4), (50, 1, 4))
    projected = project_lights(lights, camera, EAST)
    assert projected.indices.tolist() == [1, 3]
    joined = join_projected(projected, projected, row_offset=4)
    assert joined.indices.tolist() == [1, 3, 5, 7]
    assert len(joined.boxes_xyxy) == len(joined.types) == len(joined.expected) == 4


def test_an_empty_map_projects_nothing(camera: CameraModel) -> None:
    projected = project_lights(lights_at(), camera, EAST)
    assert projected.boxes_xyxy.shape == (0, 4)
