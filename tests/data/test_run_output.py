import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from autolights.core import CameraView, LightEstimate
from autolights.core.errors import DataError
from autolights.data import load_detections, load_estimates, load_run_info

ESTIMATE = LightEstimate(
    stamp_ns=7,
    track_id=3,
    map_id=None,
    type="3",
    class_name="3-red",
    probability=0.9,
    flashing=False,
    withheld=True,
    position=np.array([1.0, 2.0, 3.0]),
    covariance=None,
    distance_m=30.0,
    last_seen_ns=6,
    views=(CameraView("narrow", 7, (1.0, 2.0, 3.0, 4.0)), CameraView("wide", 6, None)),
)


def _line(**changes: Any) -> str:
    values = {"stamp_ns": 7, "variant": "full", "frames": [{"camera": "narrow", "stamp_ns": 7}]}
    return json.dumps({**values, "lights": [ESTIMATE.to_json()], **changes}) + "\n"


def test_estimates_come_back_variant_by_variant(tmp_path: Path) -> None:
    path = tmp_path / "estimates.jsonl"
    path.write_text(_line() + _line(variant="od", lights=[]))
    full, od = load_estimates(path)
    assert full.frames == (("narrow", 7),)
    assert full.lights[0].to_json() == ESTIMATE.to_json()
    assert full.lights[0].stamp_ns == 7
    assert od.lights == ()
    assert [entry.variant for entry in load_estimates(path, ["od"])] == ["od"]


def test_lines_of_format_1_tell_nothing_of_relevance(tmp_path: Path) -> None:
    path = tmp_path / "estimates.jsonl"
    old = {k: v for k, v in ESTIMATE.to_json().items() if k not in ("ahead_m", "intersection", "governs")}
    path.write_text(_line(lights=[old]) + _line(format=2))
    first, second = (entry.lights[0] for entry in load_estimates(path))
    assert (first.ahead_m, first.intersection, first.governs) == (None, None, None)
    assert second.to_json() == first.to_json()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (_line(lights=[{"track_id": 1}]), r"estimates.jsonl:1: light estimate: field .* is missing"),
        (_line(stamp_ns="now"), r"estimates.jsonl:1: .*'now'"),
        ('{"variant": "od"}\n', r"estimates.jsonl:1: field 'stamp_ns' is missing"),
        (_line(format=3), r"estimates.jsonl:1: format 3 is newer than 2; upgrade autolights or run again"),
        (_line(format="new"), r"estimates.jsonl:1: invalid literal"),
        ("[]\n", r"estimates.jsonl:1: must be an object, got list"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "estimates.jsonl"
    path.write_text(line)
    with pytest.raises(DataError, match=message):
        load_estimates(path)


def test_detections(tmp_path: Path) -> None:
    path = tmp_path / "detections.jsonl"
    empty = {"stamp_ns": 1, "camera": "wide", "boxes_xyxy": [], "scores": [], "classes": []}
    one = {"stamp_ns": 2, "camera": "wide", "boxes_xyxy": [[0, 1, 2, 3]], "scores": [0.5], "classes": ["3-red"]}
    path.write_text(json.dumps(empty) + "\n" + json.dumps(one) + "\n")
    frames = load_detections(path)
    assert frames[0].boxes_xyxy.shape == (0, 4)
    assert frames[1].classes == ("3-red",)
    path.write_text(json.dumps({**one, "scores": []}) + "\n")
    with pytest.raises(DataError, match=r"detections.jsonl:1: scores must have shape \(1\)"):
        load_detections(path)


def test_run_info(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    with pytest.raises(DataError, match=r"run.json: cannot be read .*finished run"):
        load_run_info(tmp_path)
    path.write_text('{"drive": "drives/town", "variants": {}}')
    assert load_run_info(tmp_path)["drive"] == "drives/town"
    path.write_text('{"drive": "drives/town"}')
    with pytest.raises(DataError, match=r"run.json: field 'variants' is missing"):
        load_run_info(tmp_path)
