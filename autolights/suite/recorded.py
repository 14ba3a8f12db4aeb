"""The suite on rendered or real drives: a real detector looks at the images once, scenarios disturb what follows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from autolights.core import Detections, SignalSet
from autolights.core.errors import DataError
from autolights.core.progress import track
from autolights.data import Drive, TruthFrame, load_truth
from autolights.evaluate.matching import match_seen_boxes
from autolights.pipeline import ImageDetector
from autolights.suite.arrival import arrival, in_time
from autolights.suite.config import ScenarioConfig
from autolights.suite.disturb import shift_poses, turn_cameras
from autolights.suite.drives import SuiteDrive


@dataclass(frozen=True, eq=False)
class RecordedDrive:
    """A drive on disk with its truth and all that a detector says of its images.

    Attributes:
        drive: As it was recorded.
        signals: The signal description.
        truth: By (camera, stamp_ns).
        detections: By (camera, stamp_ns).
    """

    drive: Drive
    signals: SignalSet
    truth: Mapping[tuple[str, int], TruthFrame]
    detections: Mapping[tuple[str, int], Detections]


def record(folder: Path, signals: SignalSet, detector: ImageDetector) -> RecordedDrive:
    """Let a detector look at every image of a drive.

    Raises:
        UsageError: If the folder is no drive.
        DataError: If the drive has no truth, or a file breaks its format.
    """
    drive = Drive.load(folder, signals)
    if not drive.truth_path.is_file():
        raise DataError(f"{drive.truth_path}: no such file; only a drive with truth can be scored")
    truth = {(frame.camera, frame.stamp_ns): frame for frame in load_truth(drive.truth_path)}
    detections = {}
    for frame in track(drive.frames, description=f"detect {drive.name}", total=len(drive.frames), unit="images"):
        (found,) = detector.batch([drive.read(frame).image_bgr])
        detections[frame.camera, frame.stamp_ns] = found
    return RecordedDrive(drive, signals, truth, detections)


def disturb(recorded: RecordedDrive, name: str, scenario: ScenarioConfig, seed: Sequence[int]) -> SuiteDrive:
    """A recorded drive as a scenario has it: mounting, poses, and how its frames arrive; the town is what it is."""
    drive = recorded.drive
    rng = np.random.default_rng([*seed, *drive.name.encode()])
    sets = arrival(drive.frame_sets(), scenario, tuple(drive.cameras), rng)
    cameras = turn_cameras(tuple(drive.cameras.values()), scenario.mounting_error_deg, rng, lateral=False)
    given = replace(
        drive,
        name=f"{name}-{drive.name}",
        cameras={camera.name: camera for camera in cameras},
        poses=tuple(shift_poses(drive.poses, scenario.pose_error_m, rng)),
    )
    asked = in_time(sets)
    return SuiteDrive(
        name=given.name,
        scenario=name,
        signals=recorded.signals,
        drive=given,
        true_drive=replace(drive, name=given.name),
        truth={key: frame for key, frame in recorded.truth.items() if key in asked},
        sets=sets,
        detections=dict(recorded.detections),
        sources={key: _sources(found, recorded.truth.get(key)) for key, found in recorded.detections.items()},
        map_positions=dict(zip(drive.lights.ids, drive.lights.positions, strict=True)),
    )


def _sources(found: Detections, truth: TruthFrame | None) -> tuple[str | None, ...]:
    """The light that each detection shows: the one whose box it overlaps best, by one half at least."""
    sources: list[str | None] = [None] * len(found)
    if truth is not None:
        boxes = np.array([light.box_xyxy for light in truth.lights]).reshape(-1, 4)
        for i, j in match_seen_boxes(boxes, found.boxes_xyxy).items():
            sources[j] = truth.lights[i].truth_id
    return tuple(sources)
