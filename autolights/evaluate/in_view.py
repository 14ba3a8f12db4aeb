"""Which lights of a camera frame count: every labelled light in view, occluded ones too."""

from collections.abc import Sequence

import numpy as np

from autolights.core import CameraModel, FloatArray, Pose
from autolights.data import TruthLight

MIN_HEIGHT_PX = 8.0
MAX_FACING_DEG = 60.0


def lights_in_view(lights: Sequence[TruthLight], camera: CameraModel, pose: Pose) -> list[TruthLight]:
    """Keep the lights that a report must name.

    In view means: the whole (amodal) box lies inside the image and is at least 8 px high, the vehicle is within the
    camera's range of the light, and the light's face looks towards the vehicle within 60° (seen from above).

    Args:
        lights: Truth of one camera frame.
        camera: That camera.
        pose: Of the vehicle at the frame's stamp.
    """
    return [light for light in lights if _is_in_view(light, camera, pose)]


def _is_in_view(light: TruthLight, camera: CameraModel, pose: Pose) -> bool:
    left, top, right, bottom = light.box_xyxy
    width, height = camera.size_wh
    inside = left >= 0 and top >= 0 and right <= width and bottom <= height
    to_vehicle = pose.position - light.position
    near = bool(np.linalg.norm(to_vehicle) <= camera.max_range_m)
    return inside and bottom - top >= MIN_HEIGHT_PX and near and _facing_deg(light, to_vehicle[:2]) <= MAX_FACING_DEG


def _facing_deg(light: TruthLight, to_vehicle_east_north: FloatArray) -> float:
    bearing_deg = np.degrees(np.arctan2(to_vehicle_east_north[0], to_vehicle_east_north[1]))
    return float(abs((bearing_deg - light.heading_deg + 180) % 360 - 180))
