import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autolights.core import CameraModel, back_project, project_points
from autolights.core.errors import CalibrationError

K = np.array([[900.0, 0.5, 640.0], [0, 910.0, 400.0], [0, 0, 1]])
LENSES = {
    "none": [],
    "four": [-0.25, 0.08, 0.001, -0.002],
    "five": [-0.25, 0.08, 0.001, -0.002, -0.01],
    "rational": [0.4, 0.1, 0.0005, -0.0003, 0.01, 0.7, 0.2, 0.02],
}


def camera(distortion=(), intrinsics=K, cam_from_ins=None, size_wh=(1280, 800), max_range_m=64.0):
    mounting = np.eye(4) if cam_from_ins is None else cam_from_ins
    return CameraModel("front", size_wh, intrinsics, np.array(distortion, dtype=float), mounting, max_range_m)


@pytest.mark.parametrize(
    ("point", "pixel"),
    [
        pytest.param([0, 0, 10], [640, 400], id="straight-ahead"),
        pytest.param([1, 0, 10], [730, 400], id="one-metre-right"),
        pytest.param([0, -1, 10], [639.95, 309], id="one-metre-up-with-skew"),
    ],
)
def test_pinhole_by_hand(point, pixel):
    np.testing.assert_allclose(project_points(np.array([point], dtype=float), camera()), [pixel])


@pytest.mark.parametrize("lens", LENSES)
def test_agrees_with_opencv(lens):
    unskewed = K * [[1, 0, 1], [1, 1, 1], [1, 1, 1]]
    points = np.random.default_rng(0).uniform([-4, -3, 8], [4, 3, 40], (200, 3))
    wanted, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), unskewed, np.array(LENSES[lens] or [0.0] * 4))

    got = project_points(points, camera(LENSES[lens], unskewed))

    np.testing.assert_allclose(got, wanted.reshape(-1, 2), atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
@given(x=st.floats(-0.5, 0.5), y=st.floats(-0.35, 0.35), depth=st.floats(0.1, 500))
def test_projection_and_back_projection_cancel(lens, x, y, depth):
    model = camera(LENSES[lens])
    point = depth * np.array([[x, y, 1.0]])

    ray = back_project(project_points(point, model), model)

    np.testing.assert_allclose(ray * depth, point, atol=1e-6 * depth)


@pytest.mark.parametrize("lens", LENSES)
def test_what_lies_behind_is_not_mirrored(lens):
    points = np.array([[1.0, 1, -10], [1, 1, 0], [0, 0, 10]])

    pixels = project_points(points, camera(LENSES[lens]))

    assert np.isnan(pixels[:2]).all()
    assert np.isfinite(pixels[2]).all()


def test_beyond_the_lens_valid_angle_nothing_folds_back():
    model = camera([-0.3, 0, 0, 0])  # r (1 - 0.3 r²) grows until r² = 1 / 0.9
    edge = 1 / np.sqrt(0.9)
    radii = np.array([0.99 * edge, 1.01 * edge, 3.0])

    pixels = project_points(np.stack([radii, 0 * radii, 1 + 0 * radii], axis=1), model)

    assert model.max_radius == pytest.approx(edge)
    assert np.isnan(pixels).any(axis=1).tolist() == [False, True, True]


def test_a_lens_that_never_folds_has_no_limit():
    assert camera([0.1, 0.1, 0, 0]).max_radius == np.inf


def test_shapes():
    assert project_points(np.empty((0, 3)), camera()).shape == (0, 2)
    assert project_points(np.ones((2, 8, 3)), camera()).shape == (2, 8, 2)
    assert back_project(np.empty((0, 2)), camera()).shape == (0, 3)
    with pytest.raises(ValueError, match=r"points_cam must be \(..., 3\), got \(4, 2\)"):
        project_points(np.ones((4, 2)), camera())


def test_field_of_view_of_the_papers_narrow_camera():
    focal = 640 / np.tan(np.radians(47.3 / 2))

    assert camera(intrinsics=np.array([[focal, 0, 639.5], [0, focal, 399.5], [0, 0, 1]])).horizontal_fov_deg == (
        pytest.approx(47.3)
    )


MIRRORED = np.diag([-1.0, 1, 1, 1])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        pytest.param({"intrinsics": np.zeros((3, 3))}, r"camera 'front': intrinsics must be .*singular K", id="zero-K"),
        pytest.param({"intrinsics": K * [[0], [1], [1]]}, "singular K", id="fx-zero"),
        pytest.param({"intrinsics": K[:2]}, r"intrinsics must have shape \(3, 3\), got \(2, 3\)", id="K-2x3"),
        pytest.param(
            {"intrinsics": np.array([K[0], K[1] + 3, K[2]])}, r"intrinsics\[1\]\[0\] must be 0, got 3.0", id="K-lower"
        ),
        pytest.param({"intrinsics": K * np.nan}, "intrinsics must be finite, got 9 NaN", id="K-nan"),
        pytest.param({"distortion": [0.1, 0.2]}, r"distortion must have \(0, 4, 5, 8\) coefficients, got 2", id="lens"),
        pytest.param({"cam_from_ins": MIRRORED}, "cam_from_ins must hold a rotation", id="mirrored"),
        pytest.param({"cam_from_ins": 2 * np.eye(4)}, "cam_from_ins must hold a rotation", id="scaled"),
        pytest.param({"cam_from_ins": np.eye(4) + np.eye(4)[[3, 0, 1, 2]].T}, "must", id="projective"),
        pytest.param({"size_wh": (0, 800)}, r"size must be positive, got \(0, 800\)", id="size"),
        pytest.param({"max_range_m": 0.0}, "max_range_m must be positive, got 0.0", id="range"),
    ],
)
def test_calibration_no_camera_can_have(fields, message):
    with pytest.raises(CalibrationError, match=message):
        camera(**fields)


def test_matrices_cannot_be_changed_afterwards():
    with pytest.raises(ValueError, match="read-only"):
        camera().intrinsics[0, 0] = 1
