from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autolights.core import CameraModel, Pose, load_signals
from autolights.core.light_box import light_corners, project_corners
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, invert_rigid, rigid
from autolights.track import localization_information, localize, localize_boxes

ORIGIN = np.array([500_000.0, 4_800_000.0, 200.0])
SIZE = np.array([0.36, 1.07, 0.3])
CAMERA = CameraModel(
    name="front",
    size_wh=(1280, 800),
    intrinsics=np.array([[1460.0, 0, 642.0], [0, 1460.0, 398.0], [0, 0, 1]]),
    distortion=np.array([-0.1, 0.03, 0.0005, -0.0005]),
    cam_from_ins=rigid(CAMERA_AXES_FROM_VEHICLE_AXES, np.array([0.1, 1.2, -0.5])),
    max_range_m=64.0,
)
POSE = Pose(0, ORIGIN, np.array([0, 0, np.sin(0.05), np.cos(0.05)]))
CAM_FROM_UTM = CAMERA.cam_from_ins @ invert_rigid(POSE.utm_from_ins)


def box_of(position: np.ndarray) -> np.ndarray:
    """Of a light that faces the vehicle."""
    to_vehicle = POSE.position - position
    heading = np.degrees(np.arctan2(to_vehicle[0], to_vehicle[1]))
    return project_corners(light_corners(position[None], np.array([heading]), SIZE[None]), CAMERA, CAM_FROM_UTM)[0]


@given(st.floats(14, 64), st.floats(-0.25, 0.2), st.floats(2.5, 6.0))
@settings(max_examples=60, deadline=None)
def test_projected_and_localised_again_is_the_same_place(ahead: float, tangent: float, up: float) -> None:
    position = ORIGIN + np.array([ahead, ahead * (0.1 + tangent), up])
    found = localize(box_of(position), SIZE, CAMERA, POSE)
    # The depth of the housing is taken in to first order only: 2 % of the distance at 25 degrees up, less below.
    np.testing.assert_allclose(found, position, atol=0.02 * ahead)


def test_depth_is_focal_length_times_height_over_pixels() -> None:
    pinhole = CameraModel("p", (1280, 800), np.array([[1000.0, 0, 639.5], [0, 1000, 399.5], [0, 0, 1]]),
                          np.empty(0), rigid(CAMERA_AXES_FROM_VEHICLE_AXES, np.zeros(3)), 64.0)  # fmt: skip
    level = Pose(0, ORIGIN, np.array([0.0, 0.0, 0.0, 1.0]))
    # A box around the optical axis (edge coordinates: the centre of the image is 640, 400), 25 px for 1.0 m.
    found = localize(np.array([635, 387.5, 645, 412.5]), np.array([0.4, 1.0, 0.0]), pinhole, level)
    np.testing.assert_allclose(found, ORIGIN + np.array([40.0, 0, 0]), atol=1e-6)


def test_no_boxes_give_no_positions() -> None:
    assert localize_boxes(np.empty((0, 4)), np.empty((0, 3)), CAMERA, POSE).shape == (0, 3)


def test_information_is_the_inverse_of_the_scatter(make_rng: Callable[[], Any]) -> None:
    position = ORIGIN + np.array([40.0, 4.0, 5.0])
    box = box_of(position)
    noisy = box + make_rng().normal(0, 0.5, (4000, 4))
    scatter = np.cov(localize_boxes(noisy, np.tile(SIZE, (4000, 1)), CAMERA, POSE).T)
    predicted = np.linalg.inv(localization_information(position, SIZE[1], CAMERA, POSE, box_sigma_px=0.5))
    np.testing.assert_allclose(np.linalg.eigvalsh(scatter), np.linalg.eigvalsh(predicted), rtol=0.15)
    ray = (position - ORIGIN) / np.linalg.norm(position - ORIGIN)
    assert ray @ predicted @ ray == pytest.approx(np.linalg.eigvalsh(predicted)[-1], rel=0.05), "longest along the ray"


@pytest.fixture
def make_rng() -> Callable[[], Any]:
    return lambda: np.random.default_rng(11)


def test_sizes_come_from_the_description() -> None:
    np.testing.assert_allclose(load_signals().sizes_m(["3"])[0], SIZE)
