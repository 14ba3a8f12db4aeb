"""The suite on rendered drives; the detector is one that was made by hand, from the truth."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from autolights.core import Detections, ImageArray, SignalSet, load_config, load_signals
from autolights.core.errors import DataError, UsageError
from autolights.data import Drive, load_truth
from autolights.pipeline import PipelineConfig
from autolights.sim.config import CameraConfig, DriveConfig, DrivesConfig
from autolights.sim.drives import simulate_drives
from autolights.suite import RecordedDrive, SuiteConfig, record, run_recorded
from autolights.suite.recorded import disturb
from autolights.suite.run import suite_hmm

CAMERAS = tuple(
    CameraConfig(name=name, size_wh=(320, 200), horizontal_fov_deg=50, max_range_m=60, stamp_offset_ms=offset)
    for name, offset in (("narrow", 0.0), ("wide", 4.0))
)


class Oracle:
    """Knows the truth of each image in the order of the drive; adds one box that shows nothing."""

    def __init__(self, folder: Path, signals: SignalSet) -> None:
        truth = {(frame.camera, frame.stamp_ns): frame for frame in load_truth(folder / "truth.jsonl")}
        drive = Drive.load(folder, signals)
        self._frames = [truth[frame.camera, frame.stamp_ns] for frame in drive.frames]
        self._signals = signals
        self._next = 0

    def batch(self, images_bgr: Sequence[ImageArray]) -> list[Detections]:
        assert len(images_bgr) == 1
        lights = self._frames[self._next].lights
        self._next += 1
        boxes = [*(light.box_xyxy for light in lights), (5.0, 190.0, 9.0, 199.0)]
        probs = np.full((len(boxes), len(self._signals.classes)), 0.01)
        for i, light in enumerate(lights):
            probs[i, self._signals.class_ids[light.lit_class]] = 0.95
        return [Detections(np.array(boxes), np.full(len(boxes), 0.95), probs)]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> RecordedDrive:
    folder = tmp_path_factory.mktemp("rendered") / "drives"
    signals = load_signals()
    drive = DriveConfig(name="short", duration_s=2.0)
    simulate_drives(DrivesConfig(drives=(drive,), cameras=CAMERAS, workers=1), folder)
    return record(folder / "short", signals, Oracle(folder / "short", signals))


def test_sources_are_found_by_overlap(recorded: RecordedDrive, suite: SuiteConfig) -> None:
    drive = disturb(recorded, "plain", suite.scenarios["plain"], (1,))
    for key, frame in drive.truth.items():
        assert drive.sources[key] == (*(light.truth_id for light in frame.lights), None)


def test_the_detector_looks_once_and_the_scenarios_disturb(recorded: RecordedDrive, suite: SuiteConfig) -> None:
    turned = disturb(recorded, "turned", suite.scenarios["turned"], (1,))
    for name, camera in recorded.drive.cameras.items():
        assert not np.allclose(turned.drive.cameras[name].cam_from_ins, camera.cam_from_ins)
        assert np.array_equal(turned.true_drive.cameras[name].cam_from_ins, camera.cam_from_ins)
    moved = disturb(recorded, "moved", suite.scenarios["moved"], (1,))
    shift = moved.drive.poses[3].position - recorded.drive.poses[3].position
    assert np.linalg.norm(shift) == pytest.approx(0.5)
    dead = disturb(recorded, "dead", suite.scenarios["dead"], (1,))
    assert sum(frame.camera == "narrow" for frames in dead.sets for frame in frames) == 10


def test_an_oracle_reaches_everything_but_the_first_sight(recorded: RecordedDrive, suite: SuiteConfig) -> None:
    config = load_config("runtime/default", PipelineConfig)
    result = run_recorded(suite, [recorded], suite_hmm(suite, recorded.signals), {"full": config}, scenarios=["plain"])
    of = result.scenarios["plain"]["full"]
    assert of.accuracy.total >= 90
    assert of.settled.percent == 100
    assert of.pairing.percent == 100


def test_only_what_a_recorded_drive_can_have(recorded: RecordedDrive) -> None:
    shipped = load_config("suite/default", SuiteConfig)
    with pytest.raises(UsageError, match="'dusk' cannot be had of a recorded drive"):
        run_recorded(shipped, [recorded], {}, {"full": PipelineConfig()}, scenarios=["dusk"])


def test_a_drive_without_truth_is_refused(recorded: RecordedDrive) -> None:
    truth = recorded.drive.truth_path
    hidden = truth.rename(truth.with_suffix(".hidden"))
    try:
        with pytest.raises(DataError, match=r"truth.jsonl: no such file; only a drive with truth"):
            record(recorded.drive.folder, recorded.signals, Oracle.__new__(Oracle))
    finally:
        hidden.rename(truth)
