import numpy as np
import pytest

from autolights.core import CameraModel, Pose
from autolights.core.boxes import cxcywh_columns
from autolights.core.light_box import light_corners, project_corners
from autolights.core.shots import Shots
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, invert_rigid, rigid
from autolights.track.new_lights import may_be_near

SIZE = np.array([0.36, 1.07, 0.3])
POSE = Pose(0, np.array([500_000.0, 4_800_000.0, 200.0]), np.array([0.0, 0.0, 0.0, 1.0]))


def make_camera(fov_deg: float, k1: float) -> CameraModel:
    focal_px = 640 / np.tan(np.radians(fov_deg / 2))
    return CameraModel(
        name="front",
        size_wh=(1280, 800),
        intrinsics=np.array([[focal_px, 0, 639.5], [0, focal_px, 399.5], [0, 0, 1]]),
        distortion=np.array([k1, 0.0, 0.0, 0.0]),
        cam_from_ins=rigid(CAMERA_AXES_FROM_VEHICLE_AXES, np.zeros(3)),
        max_range_m=64.0,
    )


@pytest.mark.parametrize(("fov_deg", "k1"), [(47.3, -0.08), (85.7, -0.2), (85.7, 0.1), (30.0, 0.0)])
def test_no_light_within_range_is_too_small_wherever_it_hangs(fov_deg: float, k1: float) -> None:
    camera, rng = make_camera(fov_deg, k1), np.random.default_rng(0)
    half = np.tan(np.radians(fov_deg / 2))
    ahead = rng.uniform(10, 63, 2000)
    places = POSE.position + np.stack(
        [ahead, ahead * rng.uniform(-half, half, 2000), ahead * rng.uniform(-0.3, 0.3, 2000)], 1
    )
    places = places[np.linalg.norm(places - POSE.position, axis=1) <= 64]
    corners = light_corners(places, np.full(len(places), 270.0), np.tile(SIZE, (len(places), 1)))
    boxes = project_corners(corners, camera, camera.cam_from_ins @ invert_rigid(POSE.utm_from_ins))
    boxes = boxes[~np.isnan(boxes[:, 0])]
    assert len(boxes) > 1000
    near = may_be_near(
        cxcywh_columns(boxes)[3], np.full(len(boxes), SIZE[1]), np.zeros(len(boxes), int), Shots.of([camera], [POSE])
    )
    assert near.all()


def test_each_image_has_the_range_of_its_camera() -> None:
    shots = Shots.of([make_camera(47.3, 0.0), make_camera(85.7, 0.0)], [POSE, POSE])
    reach_px = 1.07 * shots.optics.focal_px[1] / 64 / 1.4
    heights_px = np.array([reach_px[0] + 0.1, reach_px[0] - 0.1, reach_px[1] + 0.1, reach_px[1] - 0.1])
    near = may_be_near(heights_px, np.full(4, 1.07), np.array([0, 0, 1, 1]), shots)
    assert near.tolist() == [True, False, True, False]
