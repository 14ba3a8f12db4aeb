"""A tiny drive: two cameras, four grey images, one light of each type."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from autolights.core import CameraModel, Pose, SignalSet, TrafficLightMap, load_signals
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, rigid
from autolights.data import FrameRecord, TruthFrame, TruthLight, write_drive


@dataclass(frozen=True, eq=False)
class DriveParts:
    """What was written, to compare with what is read."""

    folder: Path
    cameras: tuple[CameraModel, ...]
    poses: tuple[Pose, ...]
    lights: TrafficLightMap
    frames: tuple[FrameRecord, ...]
    truth: tuple[TruthFrame, ...]


@pytest.fixture(scope="session")
def signals() -> SignalSet:
    return load_signals()


@pytest.fixture
def drive_parts(tmp_path: Path, signals: SignalSet) -> DriveParts:
    folder = tmp_path / "town"
    (folder / "images").mkdir(parents=True)
    cameras = tuple(
        CameraModel(
            name=name,
            size_wh=(64, 40),
            intrinsics=np.array([[focal, 0.0, 31.5], [0.0, focal, 19.5], [0.0, 0.0, 1.0]]),
            distortion=np.array([-0.1, 0.01, 0.0, 0.0]),
            cam_from_ins=rigid(CAMERA_AXES_FROM_VEHICLE_AXES, np.array([0.0, 1.5, -1.0])),
            max_range_m=max_range_m,
        )
        for name, focal, max_range_m in (("narrow", 73.1, 64.0), ("wide", 34.5, 30.0))
    )
    poses = tuple(
        Pose(1_000_000_000 + i * 10_000_000, np.array([500_000 + 0.1 * i, 4_800_000, 200]), np.array([0.0, 0, 0, 1]))
        for i in range(21)
    )
    types = ("3", "4", "5dh")
    lights = TrafficLightMap(
        ids=("a", "b", "c"),
        types=types,
        positions=np.array([[500_040.123, 4_800_003.456, 205.5], [500_040, 4_800_000, 205], [500_041, 4_799_997, 206]]),
        headings_deg=np.array([270.0, 271.5, 0.0]),
        sizes_m=signals.sizes_m(types),
        intersections=("first", "first", "second"),
        groups=("through", "left", ""),
    )
    frames = []
    for stamp_ns, camera in (
        (1_050_000_000, "narrow"),
        (1_070_000_000, "wide"),
        (1_150_000_000, "narrow"),
        (1_170_000_000, "wide"),
    ):
        path = Path("images") / f"{camera}_{stamp_ns}.png"
        cv2.imwrite(str(folder / path), np.full((40, 64, 3), 128, np.uint8))
        frames.append(FrameRecord(stamp_ns, camera, path))
    light = TruthLight(
        truth_id="A",
        map_id="a",
        type="3",
        class_name="3-red",
        lit_class="3-red",
        flashing=False,
        box_xyxy=(10.25, 5.5, 14.0, 16.75),
        occlusion=0.25,
        truncated=False,
        position=np.array([500_040.1, 4_800_003.4, 205.4]),
        heading_deg=270.0,
    )
    truth = tuple(TruthFrame(f.stamp_ns, f.camera, (light,) if f.camera == "narrow" else ()) for f in frames)
    write_drive(
        folder,
        name="town",
        utm_zone=17,
        hemisphere="north",
        height_datum="ellipsoid",
        cameras=cameras,
        poses=poses,
        lights=lights,
        frames=frames,
        truth=truth,
        extra={"seed": 3},
    )
    return DriveParts(folder, cameras, poses, lights, tuple(frames), truth)
