import json
from pathlib import Path

import numpy as np
import pytest

from autolights.core.errors import DataError
from autolights.data import TruthFrame, load_truth, save_truth


def test_truth_comes_back_as_it_was_written(drive_parts) -> None:
    read = load_truth(drive_parts.folder / "truth.jsonl")
    assert [(frame.stamp_ns, frame.camera, len(frame.lights)) for frame in read] == [
        (1_050_000_000, "narrow", 1),
        (1_070_000_000, "wide", 0),
        (1_150_000_000, "narrow", 1),
        (1_170_000_000, "wide", 0),
    ]
    light, written = read[0].lights[0], drive_parts.truth[0].lights[0]
    assert light.to_json() == written.to_json()
    np.testing.assert_allclose(light.position, written.position, atol=1e-3, rtol=0)


def test_a_frame_that_comes_twice(tmp_path: Path) -> None:
    save_truth(tmp_path / "truth.jsonl", [TruthFrame(5, "narrow", ())] * 2)
    with pytest.raises(DataError, match=r"truth.jsonl:2: camera 'narrow' has stamp 5 twice"):
        load_truth(tmp_path / "truth.jsonl")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param({"box_xyxy": [5, 5, 5, 9]}, r"truth.jsonl:1: .*left < right", id="flat-box"),
        pytest.param({"occlusion": 1.2}, r"truth.jsonl:1: .*occlusion must lie in \[0, 1\], got 1.2", id="occlusion"),
        pytest.param({"xyz": [1, 2]}, r"truth.jsonl:1: .*xyz must have shape \(3\)", id="position"),
        pytest.param({"class": ...}, r"truth.jsonl:1: truth light: field 'class' is missing", id="no-class"),
    ],
)
def test_a_wrong_light_is_named(drive_parts, change: dict[str, object], message: str) -> None:
    path: Path = drive_parts.folder / "truth.jsonl"
    frame = json.loads(path.read_text().splitlines()[0])
    light = {**frame["lights"][0], **change}
    frame["lights"] = [{name: value for name, value in light.items() if value is not ...}]
    path.write_text(json.dumps(frame) + "\n")
    with pytest.raises(DataError, match=message):
        load_truth(path)


def test_an_interrupted_line(drive_parts) -> None:
    path: Path = drive_parts.folder / "truth.jsonl"
    path.write_text(path.read_text()[:-20])
    with pytest.raises(DataError, match=r"truth.jsonl:4: not JSON .*interrupted"):
        load_truth(path)
