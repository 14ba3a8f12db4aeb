"""A recorded drive: images of several cameras, poses, calibration and map in one folder (docs: formats)."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from pydantic import Field

from autolights.core import (
    CameraFrame,
    CameraModel,
    Config,
    Pose,
    PoseBuffer,
    SignalSet,
    TrafficLightMap,
    load_config,
    save_config,
)
from autolights.core.atomic import write_text
from autolights.core.errors import ConfigError, DataError, MapError, UsageError
from autolights.data.calibrations import load_calibration, save_calibration
from autolights.data.maps import load_map, save_map
from autolights.data.poses import load_poses, save_poses
from autolights.data.tables import read_csv
from autolights.data.truth import TruthFrame, save_truth
from autolights.data.utm import Hemisphere

INFO, CALIBRATION, POSES, MAP = "drive.yaml", "calibration.yaml", "poses.csv", "map.geojson"
FRAMES, TRUTH, IMAGES = "frames.csv", "truth.jsonl", "images"
_FRAME_COLUMNS = ("stamp_ns", "camera", "path")


@dataclass(frozen=True)
class FrameRecord:
    """Where one image lies.

    Attributes:
        stamp_ns: Integer nanoseconds of its exposure.
        camera: Name of the camera.
        path: Of the image, relative to the drive's folder.
    """

    stamp_ns: int
    camera: str
    path: Path


class DriveInfo(Config):
    """``drive.yaml``.

    Attributes:
        name: Of the drive.
        utm_zone: 1 to 60.
        hemisphere: Of the zone.
        height_datum: What heights are measured from, e.g. ``ellipsoid`` or ``EGM2008``.
        cameras: Names, all of them calibrated.
        extra: Anything that the writer wants to keep: seed, settings, remarks.
    """

    name: str
    utm_zone: int = Field(ge=1, le=60)
    hemisphere: Hemisphere
    height_datum: str
    cameras: tuple[str, ...]
    extra: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive whose files were read and checked; images are read one by one with `read`.

    Attributes:
        folder: Where it lies.
        name: Its name.
        utm_zone: Zone of all positions.
        hemisphere: Of the zone.
        height_datum: What heights are measured from.
        cameras: By name.
        poses: In the order of time.
        lights: The map that a runtime may use.
        frames: In the order of time.
    """

    folder: Path
    name: str
    utm_zone: int
    hemisphere: Hemisphere
    height_datum: str
    cameras: dict[str, CameraModel]
    poses: tuple[Pose, ...]
    lights: TrafficLightMap
    frames: tuple[FrameRecord, ...]

    @classmethod
    def load(cls, folder: Path, signals: SignalSet) -> Self:
        """Read and check a drive.

        Raises:
            UsageError: If the folder is missing or is no drive.
            DataError: If a file breaks its format or the files do not fit each other; the text names file and line.
        """
        if not folder.is_dir():
            raise UsageError(f"{folder}: no such folder")
        if not (folder / INFO).is_file():
            raise UsageError(f"{folder}: holds no {INFO}; a drive's folder was expected")
        try:
            info = load_config(folder / INFO, DriveInfo)
        except ConfigError as error:
            raise DataError(str(error)) from error
        cameras = load_calibration(folder / CALIBRATION)
        uncalibrated = sorted(set(info.cameras) - set(cameras))
        if uncalibrated:
            raise DataError(f"{folder / CALIBRATION}: camera '{uncalibrated[0]}' of {INFO} is missing")
        cameras = {name: cameras[name] for name in info.cameras}
        return cls(
            folder=folder,
            name=info.name,
            utm_zone=info.utm_zone,
            hemisphere=info.hemisphere,
            height_datum=info.height_datum,
            cameras=cameras,
            poses=load_poses(folder / POSES),
            lights=load_map(folder / MAP, signals, info.utm_zone, info.hemisphere),
            frames=_load_frames(folder, cameras),
        )

    @property
    def truth_path(self) -> Path:
        """Where the truth lies if the drive has any."""
        return self.folder / TRUTH

    def pose_buffer(self) -> PoseBuffer:
        """All poses, ready to be asked for any stamp."""
        return PoseBuffer(self.poses)

    def read(self, record: FrameRecord) -> CameraFrame:
        """Decode one image.

        Raises:
            DataError: If the file does not decode or its size is not the calibration's; the text names the file.
        """
        path = self.folder / record.path
        image_bgr = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image_bgr is None:
            raise DataError(f"{path}: does not decode as an image; is it damaged?")
        height, width = image_bgr.shape[:2]
        size_wh = self.cameras[record.camera].size_wh
        if (width, height) != size_wh:
            raise DataError(
                f"{path}: is {width} x {height}, but the calibration of camera '{record.camera}' is for "
                f"{size_wh[0]} x {size_wh[1]}"
            )
        return CameraFrame(record.camera, record.stamp_ns, np.asarray(image_bgr, dtype=np.uint8))

    def frame_sets(self, max_spread_s: float = 0.05) -> list[tuple[FrameRecord, ...]]:
        """Group frames of different cameras that belong together, as a car's computer would on their arrival.

        Args:
            max_spread_s: Largest difference between the stamps of one set.

        Returns:
            Sets in the order of time; each holds at most one frame per camera, and each frame is in one set.
        """
        sets: list[list[FrameRecord]] = []
        for record in self.frames:
            current = sets[-1] if sets else []
            fits = (
                bool(current)
                and record.stamp_ns - current[0].stamp_ns <= max_spread_s * 1e9
                and all(other.camera != record.camera for other in current)
            )
            if fits:
                current.append(record)
            else:
                sets.append([record])
        return [tuple(frames) for frames in sets]


def write_drive(
    folder: Path,
    *,
    name: str,
    utm_zone: int,
    hemisphere: Hemisphere,
    height_datum: str,
    cameras: Sequence[CameraModel],
    poses: Sequence[Pose],
    lights: TrafficLightMap,
    frames: Sequence[FrameRecord],
    truth: Sequence[TruthFrame] | None,
    extra: dict[str, Any] | None = None,
) -> None:
    """Write everything of a drive but its images, which lie in `folder` already.

    ``drive.yaml`` comes last, so a folder that was left half-written is not taken for a drive; for all or nothing
    write into a `core.atomic.new_folder`.

    Args:
        folder: The drive's folder.
        name: Of the drive.
        utm_zone: 1 to 60.
        hemisphere: Of the zone.
        height_datum: What heights are measured from.
        cameras: With different names.
        poses: In the order of time.
        lights: The map that a runtime may use.
        frames: Paths relative to `folder`.
        truth: What the cameras really had in view, if that is known.
        extra: Anything else worth keeping in ``drive.yaml``.

    Raises:
        MapError: If the zone does not exist.
    """
    if not 1 <= utm_zone <= 60:
        raise MapError(f"UTM zones go from 1 to 60, got {utm_zone}")
    save_calibration(folder / CALIBRATION, cameras)
    save_poses(folder / POSES, poses)
    save_map(folder / MAP, lights, utm_zone, hemisphere)
    ordered = sorted(frames, key=_frame_order)
    lines = [",".join(_FRAME_COLUMNS), *(f"{f.stamp_ns},{f.camera},{f.path.as_posix()}" for f in ordered)]
    write_text(folder / FRAMES, "\n".join(lines) + "\n")
    if truth is not None:
        save_truth(folder / TRUTH, truth)
    info = DriveInfo(
        name=name,
        utm_zone=utm_zone,
        hemisphere=hemisphere,
        height_datum=height_datum,
        cameras=tuple(camera.name for camera in cameras),
        extra=extra or {},
    )
    save_config(info, folder / INFO)


def _load_frames(folder: Path, cameras: dict[str, CameraModel]) -> tuple[FrameRecord, ...]:
    path = folder / FRAMES
    frames: list[FrameRecord] = []
    for number, (stamp, camera, image) in read_csv(path, _FRAME_COLUMNS):
        if not stamp.isdigit():
            raise DataError(f"{path}:{number}: stamp_ns must be whole nanoseconds, got {stamp!r}")
        if camera not in cameras:
            raise DataError(f"{path}:{number}: unknown camera '{camera}'; {INFO} knows {', '.join(cameras)}")
        if not (folder / image).is_file():
            raise DataError(f"{path}:{number}: image {image} is missing in {folder}")
        frames.append(FrameRecord(int(stamp), camera, Path(image)))
    if not frames:
        raise DataError(f"{path}: lists no frames")
    (camera, stamp_ns), times = Counter((frame.camera, frame.stamp_ns) for frame in frames).most_common(1)[0]
    if times > 1:
        raise DataError(f"{path}: camera '{camera}' has stamp {stamp_ns} {times} times; each image has its own")
    return tuple(sorted(frames, key=_frame_order))


def _frame_order(frame: FrameRecord) -> tuple[int, str]:
    return frame.stamp_ns, frame.camera
