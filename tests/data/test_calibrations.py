from pathlib import Path

import pytest

from autolights.core.errors import CalibrationError
from autolights.data import load_calibration, save_calibration


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        pytest.param("- - 73.1", "- - 0.0", r"calibration.yaml: camera 'narrow': .*singular K", id="singular-K"),
        pytest.param(
            "max_range_m: 64.0", "max_range_m: -1", r"calibration.yaml: camera 'narrow': max_range_m", id="range"
        ),
        pytest.param("max_range_m: 64.0", "range: 64", r"unknown key 'range' in cameras.narrow", id="unknown-key"),
        pytest.param("brown_conrady", "fisheye", r"'model' in cameras.narrow.distortion", id="unknown-lens-model"),
        pytest.param("  - - 0.0\n      - -1.0", "  - - 9.0\n      - -1.0", r"cam_from_ins must", id="not-rigid"),
    ],
)
def test_an_impossible_camera_is_named(drive_parts, old: str, new: str, message: str) -> None:
    path: Path = drive_parts.folder / "calibration.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(CalibrationError, match=message):
        load_calibration(path)


def test_no_cameras_and_no_file(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    with pytest.raises(CalibrationError, match=r"calibration.yaml: no such file"):
        load_calibration(path)
    save_calibration(path, [])
    with pytest.raises(CalibrationError, match=r"'cameras' is empty"):
        load_calibration(path)
