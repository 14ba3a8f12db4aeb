import cv2
import numpy as np
import pytest

from autolights.core import CameraModel
from autolights.core.light_box import light_corners, project_corners
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, rigid


@pytest.mark.parametrize(
    ("heading_deg", "half_extent"),
    [
        pytest.param(0.0, [0.2, 0.15, 0.5], id="faces-north: width along east"),
        pytest.param(90.0, [0.15, 0.2, 0.5], id="faces-east: width along north"),
        pytest.param(180.0, [0.2, 0.15, 0.5], id="faces-south"),
    ],
)
def test_corners_span_the_housing(heading_deg: float, half_extent: list[float]) -> None:
    centre = np.array([[10.0, 20.0, 5.0]])
    corners = light_corners(centre, np.array([heading_deg]), np.array([[0.4, 1.0, 0.3]]))[0]
    np.testing.assert_allclose(corners.max(axis=0) - centre[0], half_extent, atol=1e-12)
    np.testing.assert_allclose(corners.min(axis=0) - centre[0], np.negative(half_extent), atol=1e-12)


def test_a_turned_face_points_clockwise_from_north() -> None:
    corners = light_corners(np.zeros((1, 3)), np.array([30.0]), np.array([[0.0, 0.0, 2.0]]))[0]
    tip = corners[np.argmax(corners[:, 1])]
    np.testing.assert_allclose(tip, [np.sin(np.pi / 6), np.cos(np.pi / 6), 0], atol=1e-12)


def test_image_box_is_the_hull_of_the_projected_corners() -> None:
    camera = CameraModel(
        name="front",
        size_wh=(1280, 800),
        intrinsics=np.array([[1000.0, 0, 640], [0, 1000, 400], [0, 0, 1]]),
        distortion=np.array([-0.1, 0.02, 0.001, -0.001]),
        cam_from_ins=np.eye(4),
        max_range_m=60,
    )
    # The camera looks east (the x axis of the map stands in for the vehicle's).
    cam_from_utm = rigid(CAMERA_AXES_FROM_VEHICLE_AXES, np.zeros(3))
    positions = np.array([[30.0, 2.0, 3.0], [-30.0, 2.0, 3.0]])
    corners = light_corners(positions, np.array([270.0, 270.0]), np.array([[0.4, 1.0, 0.3]] * 2))
    boxes = project_corners(corners, camera, cam_from_utm)

    rotation, _ = cv2.Rodrigues(CAMERA_AXES_FROM_VEHICLE_AXES)
    pixels = cv2.projectPoints(corners[0], rotation, np.zeros(3), camera.intrinsics, camera.distortion)[0].reshape(8, 2)
    np.testing.assert_allclose(boxes[0], [*(pixels.min(axis=0) + 0.5), *(pixels.max(axis=0) + 0.5)], atol=1e-9)
    assert np.isnan(boxes[1]).all(), "behind the camera"


def test_no_lights_give_no_boxes() -> None:
    assert light_corners(np.empty((0, 3)), np.empty(0), np.empty((0, 3))).shape == (0, 8, 3)
