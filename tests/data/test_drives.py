import re
from pathlib import Path

import numpy as np
import pytest

from autolights.core import SignalSet
from autolights.core.errors import DataError, UsageError
from autolights.data import Drive, FrameRecord


def test_a_drive_comes_back_as_it_was_written(drive_parts, signals: SignalSet) -> None:
    drive = Drive.load(drive_parts.folder, signals)
    assert (drive.name, drive.utm_zone, drive.hemisphere, drive.height_datum) == ("town", 17, "north", "ellipsoid")
    assert drive.frames == tuple(sorted(drive_parts.frames, key=lambda frame: frame.stamp_ns))
    for camera in drive_parts.cameras:
        read = drive.cameras[camera.name]
        assert read.size_wh == camera.size_wh
        assert read.max_range_m == camera.max_range_m
        for name in ("intrinsics", "distortion", "cam_from_ins"):
            np.testing.assert_array_equal(getattr(read, name), getattr(camera, name))
    np.testing.assert_allclose([p.position for p in drive.poses], [p.position for p in drive_parts.poses], atol=1e-4)
    assert drive.pose_buffer().at(1_055_000_000).position[0] == pytest.approx(500_000.55, abs=1e-3)
    assert drive.lights.ids == drive_parts.lights.ids
    assert drive.truth_path.is_file()
    assert drive.read(drive.frames[0]).image_bgr.shape == (40, 64, 3)


def test_the_drive_in_the_documentation_loads(tmp_path: Path, signals: SignalSet) -> None:
    formats = Path(__file__).parents[2] / "docs/formats.md"
    blocks = re.findall(r"^```(?:yaml|text|json)\n(.*?)```$", formats.read_text(), re.DOTALL | re.MULTILINE)
    info, calibration, tables, lights = blocks[-4:]
    (tmp_path / "drive.yaml").write_text(info.replace("[narrow, wide]", "[narrow]"))
    (tmp_path / "calibration.yaml").write_text(calibration)
    for name, table in zip(("poses.csv", "frames.csv"), tables.split("\n\n"), strict=True):
        comment, _, rows = table.partition("\n")
        assert comment.startswith(f"# {name}")
        (tmp_path / name).write_text(rows + "\n")
    (tmp_path / "map.geojson").write_text(lights)
    (tmp_path / "images/narrow").mkdir(parents=True)
    (tmp_path / "images/narrow/00000.jpg").touch()

    drive = Drive.load(tmp_path, signals)

    assert (drive.name, list(drive.cameras), len(drive.frames), drive.lights.types) == ("sunny", ["narrow"], 1, ("4",))
    assert np.linalg.norm(drive.lights.positions[0] - drive.poses[0].position) < 100


def test_frames_of_two_cameras_make_sets(drive_parts, signals: SignalSet) -> None:
    sets = Drive.load(drive_parts.folder, signals).frame_sets()
    assert [[frame.camera for frame in frames] for frames in sets] == [["narrow", "wide"]] * 2


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        pytest.param([(0, "a"), (20, "b"), (100, "a"), (120, "b")], [2, 2], id="pairs"),
        pytest.param([(0, "a"), (60, "b"), (100, "a")], [1, 2], id="too-far-apart"),
        pytest.param([(0, "a"), (20, "a"), (30, "b")], [1, 2], id="one-camera-once-per-set"),
        pytest.param([(20, "b"), (100, "a"), (120, "b")], [1, 2], id="dropped-frame"),
    ],
)
def test_frame_sets(drive_parts, signals: SignalSet, frames: list[tuple[int, str]], expected: list[int]) -> None:
    drive = Drive.load(drive_parts.folder, signals)
    records = tuple(FrameRecord(ms * 1_000_000, camera, Path("x")) for ms, camera in frames)
    object.__setattr__(drive, "frames", records)
    assert [len(group) for group in drive.frame_sets(0.05)] == expected


def _edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("frames.csv", "1050000000,narrow", "1050000000,roof", r"frames.csv:2: unknown camera 'roof'.*narrow, wide"),
        ("frames.csv", "wide_1070", "lost_1070", r"frames.csv:3: image images/lost_1070000000.png is missing"),
        ("frames.csv", "1050000000,narrow", "1.05,narrow", r"frames.csv:2: stamp_ns must be whole nanoseconds"),
        ("frames.csv", "1150000000,narrow", "1050000000,narrow", r"camera 'narrow' has stamp 1050000000 2 times"),
        ("frames.csv", "stamp_ns,camera,path", "time,camera,path", r"frames.csv:1: the header must read stamp_ns"),
        ("drive.yaml", "utm_zone: 17", "utm_zone: 61", r"drive.yaml: 'utm_zone': .*60, got 61"),
        ("drive.yaml", "hemisphere: north", "hemisphere: up", r"drive.yaml: 'hemisphere'"),
        ("drive.yaml", "- wide", "- roof", r"calibration.yaml: camera 'roof' of drive.yaml is missing"),
        ("poses.csv", "1010000000", "990000000", r"poses.csv:3: stamps must rise, got 990000000 after 1000000000"),
        ("poses.csv", "500000.1000", "east", r"poses.csv:3: .*'east'"),
        ("poses.csv", "1.000000000\n", "0.100000000\n", r"poses.csv:2: quaternion_xyzw must have length 1"),
        ("poses.csv", "200.0000,", "", r"poses.csv:2: expected 8 values, got 7"),
    ],
)
def test_a_broken_file_is_named(drive_parts, signals: SignalSet, file: str, old: str, new: str, message: str) -> None:
    _edit(drive_parts.folder / file, old, new)
    with pytest.raises(DataError, match=message):
        Drive.load(drive_parts.folder, signals)


@pytest.mark.parametrize("file", ["calibration.yaml", "poses.csv", "map.geojson", "frames.csv"])
def test_a_missing_file_is_named(drive_parts, signals: SignalSet, file: str) -> None:
    (drive_parts.folder / file).unlink()
    with pytest.raises(DataError, match=file):
        Drive.load(drive_parts.folder, signals)


def test_a_folder_that_is_no_drive(drive_parts, signals: SignalSet) -> None:
    with pytest.raises(UsageError, match=r"elsewhere: no such folder"):
        Drive.load(drive_parts.folder / "elsewhere", signals)
    with pytest.raises(UsageError, match=r"images: holds no drive.yaml"):
        Drive.load(drive_parts.folder / "images", signals)


def test_too_few_poses(drive_parts, signals: SignalSet) -> None:
    path = drive_parts.folder / "poses.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    with pytest.raises(DataError, match=r"at least two poses are needed.*got 1"):
        Drive.load(drive_parts.folder, signals)


def test_a_damaged_image_and_one_of_another_size(drive_parts, signals: SignalSet) -> None:
    drive = Drive.load(drive_parts.folder, signals)
    image = drive.folder / drive.frames[0].path
    whole = image.read_bytes()
    image.write_bytes(whole[:20])
    with pytest.raises(DataError, match=rf"{image.name}: does not decode"):
        drive.read(drive.frames[0])
    image.write_bytes(whole)
    camera = drive.cameras["narrow"]
    object.__setattr__(camera, "size_wh", (128, 80))
    with pytest.raises(DataError, match=r"is 64 x 40, but the calibration of camera 'narrow' is for 128 x 80"):
        drive.read(drive.frames[0])
