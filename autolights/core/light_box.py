"""The box that a light's housing fills in space, its outline in an image, and which lights of a map an image shows."""

from functools import lru_cache

import numpy as np

from autolights.core.arrays import FloatArray, IntArray
from autolights.core.camera import CameraModel, project_points
from autolights.core.light_map import TrafficLightMap
from autolights.core.pose import Pose
from autolights.core.transforms import invert_rigid, transform_points

# Detectors do see beyond a camera's nominal range. A light out there may be seen, but is not expected.
RANGE_MARGIN = 2.0

# Signs of (across, along the way the face looks, up) of the eight corners.
_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


def light_corners(positions: FloatArray, headings_deg: FloatArray, sizes_m: FloatArray) -> FloatArray:
    """Corners of upright housings.

    Args:
        positions: (n, 3) centres: east, north, up in metres.
        headings_deg: (n,) the way the face looks, clockwise from north.
        sizes_m: (n, 3) width, height, depth.

    Returns:
        (n, 8, 3) metres, in the frame of `positions`.
    """
    heading = np.radians(headings_deg)
    sine, cosine, (width, height, depth) = np.sin(heading), np.cos(heading), sizes_m.T / 2
    half_axes = np.zeros((len(heading), 3, 3))  # across the face, where it looks, up
    half_axes[:, 0, 0], half_axes[:, 0, 1] = cosine * width, -sine * width
    half_axes[:, 1, 0], half_axes[:, 1, 1] = sine * depth, cosine * depth
    half_axes[:, 2, 2] = height
    return np.asarray(positions[:, None] + _SIGNS @ half_axes)


def project_corners(corners: FloatArray, camera: CameraModel, cam_from_utm: FloatArray) -> FloatArray:
    """Image boxes around projected corners.

    Args:
        corners: (n, 8, 3) metres in the map frame.
        camera: The camera.
        cam_from_utm: (4, 4) map frame to camera frame at the image's stamp.

    Returns:
        (n, 4) xyxy pixels, edge coordinates; NaN where a corner does not project (behind the camera, beyond the
        lens). Boxes may leave the image.
    """
    # Half a pixel: points count from the centre of the top-left pixel, boxes from its corner.
    pixels = project_points(transform_points(cam_from_utm, corners), camera) + 0.5
    return np.concatenate([pixels.min(axis=1, initial=np.inf), pixels.max(axis=1, initial=-np.inf)], axis=-1)


def project_visible(lights: TrafficLightMap, camera: CameraModel, pose: Pose) -> tuple[IntArray, FloatArray]:
    """Project the lights of a map that a camera can have in view.

    A light is left out if it is farther away than twice the camera's range, turns its face away (by 90° or more, seen
    from above), has a corner that does not project (behind the camera, outside the lens' valid angle), or if its whole
    box lies outside the image.

    Args:
        lights: Known lights.
        camera: The camera.
        pose: The vehicle's at the image's own stamp.

    Returns:
        (n,) ascending rows of the map and (n, 4) boxes, xyxy pixels, edge coordinates; they may leave the image.
    """
    near = lights.within(pose.position, RANGE_MARGIN * camera.max_range_m)
    corners, faces = _housings(lights)
    to_vehicle = (pose.position - lights.positions[near])[:, :2]
    near = near[(faces[near] * to_vehicle).sum(axis=1) > 0]

    # T_cam_utm(t) = T_cam_ins · T_utm_ins(t)⁻¹
    cam_from_utm = camera.cam_from_ins @ invert_rigid(pose.utm_from_ins)
    boxes_xyxy = project_corners(corners[near], camera, cam_from_utm)
    lows, highs = boxes_xyxy[:, :2], boxes_xyxy[:, 2:]
    overlaps = np.all((highs > 0) & (lows < camera.size_wh), axis=1)  # NaN compares false: a bad corner drops the light
    return near[overlaps], boxes_xyxy[overlaps]


@lru_cache(maxsize=8)
def _housings(lights: TrafficLightMap) -> tuple[FloatArray, FloatArray]:
    """Corners (n, 8, 3) and faces (n, 2), east and north, of a whole map: lights stand still, so once is enough."""
    heading = np.radians(lights.headings_deg)
    corners = light_corners(lights.positions, lights.headings_deg, lights.sizes_m)
    return corners, np.stack([np.sin(heading), np.cos(heading)], axis=1)
