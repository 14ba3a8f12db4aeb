"""Camera calibrations: ``calibration.yaml``, one entry per camera."""

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import numpy as np

from autolights.core import CameraModel, Config, load_config, save_config
from autolights.core.errors import CalibrationError, ConfigError


class Distortion(Config):
    """Lens distortion in OpenCV's order: k1 k2 p1 p2 [k3 [k4 k5 k6]]."""

    model: Literal["brown_conrady"] = "brown_conrady"
    coefficients: tuple[float, ...] = ()


class CameraEntry(Config):
    """One camera of the file.

    Attributes:
        size_wh: Width and height in pixels.
        intrinsics: K, three rows of three, pixels; (0, 0) is the centre of the top-left pixel.
        distortion: Of the lens; none if left out.
        cam_from_ins: Four rows of four; vehicle frame (x forward, y left, z up) to camera frame (x right, y down).
        max_range_m: Lights farther away are not expected from this camera.
    """

    size_wh: tuple[int, int]
    intrinsics: tuple[tuple[float, float, float], ...]
    distortion: Distortion = Distortion()
    cam_from_ins: tuple[tuple[float, float, float, float], ...]
    max_range_m: float


class CalibrationFile(Config):
    """``calibration.yaml``: cameras by name."""

    cameras: dict[str, CameraEntry]


def load_calibration(path: Path) -> dict[str, CameraModel]:
    """Read the cameras of a rig.

    Raises:
        CalibrationError: If the file is missing, a key is wrong, or a camera cannot exist (a singular K, a mounting
            that is not rigid); the text names file, camera and value.
    """
    if not path.is_file():
        raise CalibrationError(f"{path}: no such file; a drive needs the calibration of its cameras")
    try:
        file = load_config(path, CalibrationFile)
    except ConfigError as error:
        raise CalibrationError(str(error)) from error
    if not file.cameras:
        raise CalibrationError(f"{path}: 'cameras' is empty; at least one camera is needed")
    try:
        return {name: _camera(name, entry) for name, entry in file.cameras.items()}
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from error


def save_calibration(path: Path, cameras: Iterable[CameraModel]) -> None:
    """Write cameras so that `load_calibration` reads the same numbers back."""
    save_config(CalibrationFile(cameras={camera.name: _entry(camera) for camera in cameras}), path)


def _camera(name: str, entry: CameraEntry) -> CameraModel:
    return CameraModel(
        name=name,
        size_wh=entry.size_wh,
        intrinsics=np.array(entry.intrinsics),
        distortion=np.array(entry.distortion.coefficients),
        cam_from_ins=np.array(entry.cam_from_ins),
        max_range_m=entry.max_range_m,
    )


def _entry(camera: CameraModel) -> CameraEntry:
    return CameraEntry.model_validate(
        {
            "size_wh": camera.size_wh,
            "intrinsics": camera.intrinsics.tolist(),
            "distortion": {"coefficients": camera.distortion.tolist()},
            "cam_from_ins": camera.cam_from_ins.tolist(),
            "max_range_m": camera.max_range_m,
        }
    )
