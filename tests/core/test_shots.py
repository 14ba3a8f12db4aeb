"""All images at once give what each gives alone."""

import numpy as np
import pytest

from autolights.core import CameraModel, Pose, back_project
from autolights.core.camera import normalized_points
from autolights.core.light_box import light_corners, project_corners
from autolights.core.shots import Shots
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, invert_rigid, rigid

ORIGIN = np.array([500_000.0, 4_800_000.0, 200.0])
LENSES = {
    "pinhole": [],
    "plain": [-0.1, 0.02, 0.001, -0.001],
    "tangential": [-0.12, 0.03, 0.002, -0.001, 0.001],
    "rational": [0.2, -0.05, 0.0005, 0.0003, 0.01, 0.4, 0.02, 0.01],
}


def camera(number: int, lens: str) -> CameraModel:
    focal_px = 700.0 + 300 * number
    return CameraModel(
        name=f"{lens}-{number}",
        size_wh=(1280 + 64 * number, 800),
        intrinsics=np.array([[focal_px, 0.7 * number, 639.5], [0, focal_px + 5, 399.5], [0, 0, 1]]),
        distortion=np.array(LENSES[lens]),
        cam_from_ins=rigid(CAMERA_AXES_FROM_VEHICLE_AXES, np.array([0.1 * number, 1.2, -0.5])),
        max_range_m=60.0,
    )


def pose(number: int) -> Pose:
    turn = 0.05 * number
    return Pose(number, ORIGIN + np.array([0.4 * number, -0.1, 1.5]), np.array([0, 0.01, np.sin(turn), np.cos(turn)]))


@pytest.mark.parametrize("lenses", [["pinhole"], ["plain", "pinhole"], list(LENSES)], ids="-".join)
def test_each_image_is_as_alone(lenses: list[str]) -> None:
    cameras = [camera(number, lens) for number, lens in enumerate(lenses)]
    poses = [pose(number) for number in range(len(cameras))]
    shots = Shots.of(cameras, poses)
    rng = np.random.default_rng(0)
    positions = rng.uniform([-30, -30, 3], [60, 30, 7], (40, 3))  # behind and far aside, too
    corners = light_corners(positions, rng.uniform(0, 360, 40), np.tile([0.4, 1.0, 0.3], (40, 1)))
    pixels = rng.uniform(0, [1280, 800], (30, 2))

    lows, highs = shots.project_outlines(np.ascontiguousarray(corners.T), ORIGIN)

    for image, (one, where) in enumerate(zip(cameras, poses, strict=True)):
        expected = project_corners(corners + ORIGIN, one, one.cam_from_ins @ invert_rigid(where.utm_from_ins))
        assert np.isnan(expected).any()
        np.testing.assert_allclose(np.concatenate([lows[:, image], highs[:, image]]).T, expected, atol=1e-5, rtol=1e-8)
    images = np.arange(len(cameras)).repeat(30)
    points_px = np.tile(pixels, (len(cameras), 1)).T
    bent, straight = shots.normalized(points_px, images), shots.back_project(points_px, images)
    for image, one in enumerate(cameras):
        here = images == image
        np.testing.assert_allclose(bent[:, here].T, normalized_points(pixels, one), atol=1e-12)
        np.testing.assert_allclose(straight[:, here].T, back_project(pixels, one)[:, :2], atol=1e-12)
