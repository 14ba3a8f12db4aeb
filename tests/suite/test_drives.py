import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from autolights.core import load_signals
from autolights.core.errors import UsageError
from autolights.suite import SuiteConfig
from autolights.suite.drives import build_drive, road_rates, scenario_drives
from autolights.suite.run import suite_hmm


def test_same_seed_same_drive(suite: SuiteConfig) -> None:
    first, again = (build_drive(suite, "plain", 0) for _ in range(2))
    assert first.sets == again.sets
    assert first.truth.keys() == again.truth.keys()
    for key, found in first.detections.items():
        assert np.array_equal(found.boxes_xyxy, again.detections[key].boxes_xyxy)
        assert first.sources[key] == again.sources[key]
    other = build_drive(suite.model_copy(update={"seed": 1}), "plain", 0)
    assert not np.array_equal(other.drive.lights.positions, first.drive.lights.positions)


def test_the_calibration_is_off_by_the_mounting_error(suite: SuiteConfig) -> None:
    drive = build_drive(suite, "turned", 0)
    for name, true in drive.true_drive.cameras.items():
        between = drive.drive.cameras[name].cam_from_ins[:3, :3] @ true.cam_from_ins[:3, :3].T
        assert np.degrees(Rotation.from_matrix(between).magnitude()) == pytest.approx(1.0)


def test_without_an_error_the_calibration_is_true(suite: SuiteConfig) -> None:
    drive = build_drive(suite, "plain", 0)
    for name, true in drive.true_drive.cameras.items():
        assert np.array_equal(drive.drive.cameras[name].cam_from_ins, true.cam_from_ins)


def test_poses_are_off_by_the_pose_error(suite: SuiteConfig) -> None:
    def error_m(name: str) -> np.ndarray:
        drive = build_drive(suite, name, 0)
        measured = drive.drive.pose_buffer()
        return np.array([measured.at(pose.stamp_ns).position - pose.position for pose in drive.true_drive.poses])

    assert np.linalg.norm(error_m("moved").mean(axis=0)) == pytest.approx(0.5, abs=0.06)
    assert np.linalg.norm(error_m("plain").mean(axis=0)) < 0.06
    assert error_m("plain").std(axis=0).max() < 0.06


def test_frames_are_dropped(suite: SuiteConfig) -> None:
    drive = build_drive(suite, "dropped", 0)
    assert sum(len(frames) for frames in drive.sets) / 1200 == pytest.approx(0.8, abs=0.04)
    assert len(drive.truth) == sum(len(frames) for frames in drive.sets)


def test_a_camera_dies_in_the_middle(suite: SuiteConfig) -> None:
    drive = build_drive(suite, "dead", 0)
    stamps = {
        name: [f.stamp_ns for frames in drive.sets for f in frames if f.camera == name] for name in ("narrow", "wide")
    }
    assert (max(stamps["narrow"]) - min(stamps["narrow"])) / 1e9 == pytest.approx(5.9, abs=0.01)
    assert (max(stamps["wide"]) - min(stamps["wide"])) / 1e9 == pytest.approx(11.9, abs=0.01)


def test_late_frames_come_behind_newer_ones_and_are_not_asked_about(suite: SuiteConfig) -> None:
    drive = build_drive(suite, "late", 0)
    newest = 0
    late = []
    for frames in drive.sets:
        stamp = max(frame.stamp_ns for frame in frames)
        late += [(f.camera, f.stamp_ns) for f in frames] if stamp < newest else []
        newest = max(newest, stamp)
    assert len(late) / 120 == pytest.approx(0.2, abs=0.1)
    assert not set(late) & set(drive.truth)
    assert set(late) <= set(drive.detections)
    assert len(drive.truth) + len(late) == sum(len(frames) for frames in drive.sets)


def test_the_map_lacks_lights_has_moved_ones_and_others_that_are_gone(suite: SuiteConfig) -> None:
    drive = build_drive(suite, "map", 0)
    truth = {light.truth_id: light for frame in drive.truth.values() for light in frame.lights}
    assert any(light.map_id is None for light in truth.values())
    off_m = np.array(
        [
            np.linalg.norm(drive.map_positions[light.map_id] - light.position)
            for light in truth.values()
            if light.map_id is not None
        ]
    )
    assert set(np.round(off_m, 6)) == {0.0, 1.0}
    assert sum(name.startswith("gone") for name in drive.drive.lights.ids) == 12


def test_sources_name_the_light_behind_each_detection(suite: SuiteConfig) -> None:
    drive = build_drive(suite, "plain", 0)
    centres_apart_px = []
    for key, found in drive.detections.items():
        boxes = {light.truth_id: np.array(light.box_xyxy) for light in drive.truth[key].lights}
        for box, source in zip(found.boxes_xyxy, drive.sources[key], strict=True):
            if source is not None and not any(np.isclose(box, [0, 0, 1280, 800])):  # cut boxes move their centres
                apart = (box[:2] + box[2:] - boxes[source][:2] - boxes[source][2:]) / 2
                centres_apart_px.append(np.linalg.norm(apart) / (boxes[source][3] - boxes[source][1]))
    assert len(centres_apart_px) > 500
    assert np.percentile(centres_apart_px, 99) < 0.5


def test_the_road_errs_by_another_matrix_than_the_models_know(suite: SuiteConfig) -> None:
    signals = load_signals()
    known = suite_hmm(suite, signals)["3"].observation
    ids = [signals.class_ids[name] for name in suite_hmm(suite, signals)["3"].states]
    road = road_rates(suite, signals)[np.ix_(ids, ids)]
    assert not np.allclose(known, road / road.sum(axis=1, keepdims=True), atol=0.003)


def test_unknown_scenario(suite: SuiteConfig) -> None:
    with pytest.raises(UsageError, match="no scenario 'fog'; it has plain"):
        next(scenario_drives(suite, "fog"))


def test_red_balls_flash_by_another_description(suite: SuiteConfig) -> None:
    drive = build_drive(suite, "flashing_red", 0)
    pair = drive.signals.types["3"].flashing[0]
    shown = {
        (light.class_name, light.lit_class, light.flashing) for frame in drive.truth.values() for light in frame.lights
    }
    # A red that flashes is red in both phases, and red again when it does not.
    assert {("3-red", "3-red", True), ("3-red", "3-off", True), ("3-red", "3-red", False)} <= shown
    assert {lit for _, lit, flashing in shown if flashing} == {pair.on, pair.off}
