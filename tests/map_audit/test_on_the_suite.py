"""The audit on a short drive of the suite's kind: a detector that misses and errs, a map with faults of its making."""

import numpy as np
import pytest

from autolights.core import load_config
from autolights.data import DetectedFrame, EstimateSet
from autolights.map_audit import MapAuditConfig, find, gather_evidence
from autolights.pipeline import LightPipeline, PipelineConfig
from autolights.suite import ScenarioConfig, SuiteConfig
from autolights.suite.drives import SuiteDrive, build_drive
from autolights.suite.run import suite_hmm

# One kind each: a light that is gone beside one that is missing or has moved is no other than one that moved.
ERRORS = {
    "missing": {"missing_share": 0.3, "noise_m": 0.05},
    "extra": {"extra_per_junction": 1, "noise_m": 0.05},
    "moved": {"moved_share": 0.4, "moved_m": 1.2, "noise_m": 0.05},
}


@pytest.fixture(scope="module")
def suite() -> SuiteConfig:
    shipped = load_config("suite/default", SuiteConfig)
    short = {"about": "faults", "drives": 1, "duration_s": 20.0, "junctions": 3}
    scenarios = {name: ScenarioConfig.model_validate(short | {"map_errors": e}) for name, e in ERRORS.items()}
    return shipped.model_copy(update={"scenarios": scenarios})


def run(drive: SuiteDrive, suite: SuiteConfig) -> list[EstimateSet]:
    given = drive.drive
    hmm = suite_hmm(suite, drive.signals)
    pipeline = LightPipeline(None, hmm, drive.signals, given.cameras, given.lights, poses=given.pose_buffer())
    sets = []
    for frames in drive.sets:
        keys = tuple((frame.camera, frame.stamp_ns) for frame in frames)
        lights = pipeline.step_detections(frames, [drive.detections[key] for key in keys])
        sets.append(EstimateSet(max(stamp for _, stamp in keys), "full", keys, tuple(lights)))
    return sets


@pytest.mark.parametrize("kind", list(ERRORS))
def test_faults_of_a_modelled_drive(suite: SuiteConfig, kind: str) -> None:
    drive = build_drive(suite, kind, 0)
    frames = [
        DetectedFrame(stamp, camera, d.boxes_xyxy, d.scores, tuple(drive.signals.classes[i] for i in d.class_ids))
        for (camera, stamp), d in drive.detections.items()
    ]
    config = MapAuditConfig()
    evidence = gather_evidence(drive.drive, run(drive, suite), frames, drive.signals, config)
    found = find(drive.drive.lights, [evidence], config, map_sigma_m=PipelineConfig().places.map_m)

    lights = drive.drive.lights
    truth = {light.truth_id: light for frame in drive.truth.values() for light in frame.lights}
    position_of = {light.map_id: light.position for light in truth.values() if light.map_id is not None}
    off_m = {
        light_id: np.linalg.norm(position_of[light_id] - lights.positions[row])
        for row, light_id in enumerate(lights.ids)
        if light_id in position_of
    }
    unmapped = np.array([light.position for light in truth.values() if light.map_id is None]).reshape(-1, 3)
    assert {finding.kind for finding in found.findings} == {kind}
    for finding in found.findings:
        if kind == "missing":
            assert np.linalg.norm(unmapped - finding.position, axis=1).min() < 1.0
        elif kind == "extra":
            assert finding.light_id.startswith("gone-")
        else:
            assert off_m[finding.light_id] > 0.9
            assert np.linalg.norm(finding.position - position_of[finding.light_id]) < 0.8
    # Nothing is confirmed that is wrong.
    assert all(off_m.get(light_id, np.inf) < 0.9 for light_id in found.confirmed)
    assert len(found.confirmed) >= 5
