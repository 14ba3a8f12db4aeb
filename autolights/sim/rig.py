"""The cameras of the simulated vehicle."""

from functools import lru_cache

import numpy as np

from autolights.core import CameraModel, FloatArray
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, invert_rigid, rigid
from autolights.sim.config import CameraConfig

INS_HEIGHT_M = 0.55  # of the vehicle frame's origin above the road


@lru_cache(maxsize=4)
def build_cameras(configs: tuple[CameraConfig, ...]) -> tuple[CameraModel, ...]:
    """The rig; the same objects for the same configuration, so that what is computed per camera is kept."""
    return tuple(build_camera(config) for config in configs)


def build_camera(config: CameraConfig) -> CameraModel:
    """The calibrated camera that a configuration describes."""
    width, height = config.size_wh
    focal_px = width / 2 / np.tan(np.radians(config.horizontal_fov_deg) / 2)
    intrinsics = np.array([[focal_px, 0, (width - 1) / 2 + 3.2], [0, focal_px, (height - 1) / 2 - 2.1], [0, 0, 1]])
    ins_from_mount = rigid(
        rotation_from_angles(config.yaw_deg, -config.pitch_deg, config.roll_deg), np.array(config.position_m)
    )
    cam_from_mount = rigid(CAMERA_AXES_FROM_VEHICLE_AXES, np.zeros(3))
    return CameraModel(
        name=config.name,
        size_wh=config.size_wh,
        intrinsics=intrinsics,
        distortion=np.array(config.distortion),
        cam_from_ins=cam_from_mount @ invert_rigid(ins_from_mount),
        max_range_m=config.max_range_m,
    )


def rotation_from_angles(yaw_deg: float, pitch_deg: float, roll_deg: float) -> FloatArray:
    """(3, 3) rotation Rz(yaw) Ry(pitch) Rx(roll) of a frame with x forward, y left, z up: positive pitch looks down."""
    (cy, cp, cr), (sy, sp, sr) = (f(np.radians([yaw_deg, pitch_deg, roll_deg])) for f in (np.cos, np.sin))
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return np.asarray(about_z @ about_y @ about_x)
