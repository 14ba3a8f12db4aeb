"""A short drive: read back as a user would, its truth against its own calibration, poses and map."""

import json
from pathlib import Path

import numpy as np
import pytest

from autolights.core import load_config, load_signals, project_points
from autolights.core.light_box import light_corners, project_corners
from autolights.core.transforms import invert_rigid, transform_points
from autolights.data import Drive, TruthFrame, load_truth
from autolights.sim import DrivesConfig, simulate_drives
from autolights.sim.config import NARROW, WIDE, DriveConfig, SurveyConfig
from autolights.sim.script import write_script
from autolights.sim.survey import survey

SIGNALS = load_signals()
SMALL = tuple(camera.model_copy(update={"size_wh": (320, 200)}) for camera in (NARROW, WIDE))
# The through phase begins with the drive, so its first seconds hold the flash.
CONFIG = DrivesConfig(
    drives=(DriveConfig(name="short", duration_s=1.6, near_green_s=-1.0),),
    frame_rate_hz=5,
    cameras=SMALL,
    workers=1,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sim") / "drives"
    simulate_drives(CONFIG, out)
    return out


@pytest.fixture(scope="module")
def drive(folder: Path) -> Drive:
    return Drive.load(folder / "short", SIGNALS)


@pytest.fixture(scope="module")
def truth(drive: Drive) -> list[TruthFrame]:
    return load_truth(drive.truth_path)


def test_each_camera_has_its_own_stamps_in_sets_of_two(drive: Drive) -> None:
    sets = drive.frame_sets()
    assert len(sets) == 8
    for frames in sets:
        assert [frame.camera for frame in frames] == ["narrow", "wide"]
        assert 2e6 < frames[1].stamp_ns - frames[0].stamp_ns < 6e6
        assert drive.read(frames[0]).image_bgr.shape == (200, 320, 3)


def test_truth_boxes_lie_where_calibration_and_poses_put_the_lights(drive: Drive, truth: list[TruthFrame]) -> None:
    poses = drive.pose_buffer()
    seen = 0
    for frame in truth:
        camera = drive.cameras[frame.camera]
        cam_from_utm = camera.cam_from_ins @ invert_rigid(poses.at(frame.stamp_ns).utm_from_ins)
        for light in frame.lights:
            middle = project_points(transform_points(cam_from_utm, light.position), camera) + 0.5
            left, top, right, bottom = light.box_xyxy
            # The localisation's error of a few centimetres and 0.1 degrees is below two of these small pixels.
            assert left - 2 < middle[0] < right + 2
            assert abs(middle[1] - (top + bottom) / 2) < 2
            seen += 1
    assert seen > 60


def test_truth_boxes_are_those_of_the_housings_corners_from_the_true_pose(
    drive: Drive, truth: list[TruthFrame]
) -> None:
    script = write_script(CONFIG, 0, SIGNALS)
    for frame in truth:
        camera = drive.cameras[frame.camera]
        ins_from_utm = invert_rigid(
            script.utm_from_town @ script.motion.town_from_ins((frame.stamp_ns - script.start_ns) / 1e9)
        )
        corners = light_corners(
            np.array([light.position for light in frame.lights]),
            np.array([light.heading_deg for light in frame.lights]),
            SIGNALS.sizes_m(light.type for light in frame.lights),
        )
        expected = project_corners(corners, camera, camera.cam_from_ins @ ins_from_utm)
        # Truth files keep millimetres and hundredths of a pixel.
        np.testing.assert_allclose([light.box_xyxy for light in frame.lights], expected, atol=0.05)


def test_a_light_that_faces_us_has_the_opposite_heading(drive: Drive, truth: list[TruthFrame]) -> None:
    forward = drive.poses[0].utm_from_ins[:3, 0]
    driving_deg = np.degrees(np.arctan2(forward[0], forward[1]))
    turned = {
        light.truth_id: abs((light.heading_deg - driving_deg) % 360 - 180) for frame in truth for light in frame.lights
    }
    assert sum(angle < 15 for angle in turned.values()) >= 5
    assert all(angle < 15 or angle > 165 for angle in turned.values())


def test_a_flash_is_one_class_and_both_of_its_phases_are_noted(truth: list[TruthFrame]) -> None:
    shown = {(light.class_name, light.lit_class) for frame in truth for light in frame.lights if light.flashing}
    assert shown == {("4-yleft2", "4-yleft2"), ("4-yleft2", "4-off")}
    assert all(l.class_name == l.lit_class for frame in truth for l in frame.lights if not l.flashing)  # noqa: E741


def test_the_map_lacks_one_light_and_has_one_too_many(drive: Drive, truth: list[TruthFrame]) -> None:
    names = {light.truth_id: light.map_id for frame in truth for light in frame.lights}
    missing = [truth_id for truth_id, map_id in names.items() if map_id is None]
    assert len(missing) == 1
    known = {map_id for map_id in names.values() if map_id is not None}
    assert known < set(drive.lights.ids)
    script = write_script(CONFIG, 0, SIGNALS)
    assert len(drive.lights) == len(script.town.heads)  # one less, one more


def test_map_positions_err_by_the_survey_noise() -> None:
    script = write_script(CONFIG, 0, SIGNALS)
    exact = survey(script, SurveyConfig(noise_m=0, heading_noise_deg=0), np.random.default_rng(0))
    noisy = [survey(script, SurveyConfig(noise_m=0.2), np.random.default_rng(i)).positions for i in range(40)]
    errors = np.array(noisy) - exact.positions
    np.testing.assert_allclose(errors.std(axis=(0, 1)), 0.2, rtol=0.15)
    np.testing.assert_allclose(errors.mean(axis=(0, 1)), 0, atol=0.03)


def test_same_seed_same_bytes(folder: Path, tmp_path: Path) -> None:
    simulate_drives(CONFIG, tmp_path / "again")
    files = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    assert len(files) > 20
    for file in files:
        assert (folder / file).read_bytes() == (tmp_path / "again" / file).read_bytes(), file


def test_the_shipped_drives_show_every_class_and_both_lights_of_day() -> None:
    config = load_config("sim/drives_demo", DrivesConfig)
    assert {drive.lighting for drive in config.drives} >= {"sunny", "dusk"}
    shown = set()
    for index, drive in enumerate(config.drives):
        script = write_script(config, index, SIGNALS)
        for time_s in np.arange(0, drive.duration_s, 0.1):
            shown |= {
                indication.lit_class
                for head, indication in zip(script.town.heads, script.indications(time_s).values(), strict=True)
                if head.group == "ours" and 5 < head.position[0] - script.motion.x_at(time_s) < 55
            }
    assert shown == set(SIGNALS.classes)


def test_truth_lines_hold_what_the_format_names(folder: Path) -> None:
    line = json.loads((folder / "short" / "truth.jsonl").read_text().splitlines()[0])
    assert set(line) == {"stamp_ns", "camera", "lights"}
    assert {
        "truth_id",
        "map_id",
        "type",
        "class",
        "lit_class",
        "flashing",
        "box_xyxy",
        "occlusion",
        "truncated",
        "xyz",
    } <= set(line["lights"][0])
