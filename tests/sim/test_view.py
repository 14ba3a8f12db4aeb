"""Views: the rig's angles, and polygons that are cut where the camera cannot see."""

import numpy as np
import pytest

from autolights.sim.config import NARROW, WIDE, CameraConfig
from autolights.sim.rig import build_camera, rotation_from_angles
from autolights.sim.view import View


@pytest.mark.parametrize("config", [NARROW, WIDE], ids=["narrow", "wide"])
def test_cameras_have_the_field_of_view_that_was_asked_for(config: CameraConfig) -> None:
    assert build_camera(config).horizontal_fov_deg == pytest.approx(config.horizontal_fov_deg, abs=0.05)


def test_a_camera_that_is_pitched_up_sees_the_horizon_low_and_one_yawed_left_sees_the_road_right() -> None:
    straight = CameraConfig(name="c", horizontal_fov_deg=60, max_range_m=50, pitch_deg=0)
    ahead = np.array([[1_000.0, 0.0, 1.1]])
    turned = straight.model_copy(update={"pitch_deg": 3.0, "yaw_deg": 2.0})
    (u, v), (u_turned, v_turned) = (View(build_camera(c), np.eye(4)).project(ahead)[0] for c in (straight, turned))
    assert v_turned > v + 50
    assert u_turned > u + 30


def test_positive_pitch_looks_down_and_positive_yaw_left() -> None:
    np.testing.assert_allclose(rotation_from_angles(0, 90, 0) @ [1, 0, 0], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(rotation_from_angles(90, 0, 0) @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def test_a_polygon_in_front_is_projected_as_it_is() -> None:
    view = View(build_camera(NARROW), np.eye(4))
    corners = np.array([[10.0, 1, 1], [10, -1, 1], [10, -1, 2], [10, 1, 2]])
    np.testing.assert_array_equal(view.polygon(corners), view.project(corners))


def test_a_road_that_begins_behind_us_is_cut_and_stays_finite() -> None:
    view = View(build_camera(WIDE), np.eye(4))
    road = np.array([[-50.0, 4, -0.55], [-50, -4, -0.55], [80, -4, -0.55], [80, 4, -0.55]])
    assert view.project_inside(road) is None
    polygon = view.polygon(road)
    assert polygon is not None
    assert np.isfinite(polygon).all()
    # Its far end is where projection says, its near end fills the image's lower edge.
    far = view.project(road[2:])
    assert all(np.abs(polygon - corner).sum(axis=1).min() < 1e-6 for corner in far)
    assert polygon[:, 1].max() > 800
    assert polygon[:, 0].min() < 100
    assert polygon[:, 0].max() > 1_180


def test_what_is_wholly_behind_is_nothing() -> None:
    view = View(build_camera(WIDE), np.eye(4))
    assert view.polygon(np.array([[-5.0, 1, 0], [-5, -1, 0], [-9, 0, 0]])) is None
