import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from autolights.core import SignalSet
from autolights.core.errors import DataError
from autolights.evaluate import Evaluation, evaluate
from autolights.evaluate.outcomes import FalseReport, gather_outcomes
from autolights.evaluate.score import Speed, merge_speeds, score_variant


def test_figures_of_a_scene_by_hand(rows, signals: SignalSet) -> None:
    outcomes = rows("R:R R:G R?:- R:~R R?:R") + rows("fl*:off fl*:fl", truth_id="B")
    false = [FalseReport("d", 0, outcomes[0].estimate)] * 2
    score = score_variant("full", outcomes, false, signals, None)
    assert (score.labelled, score.correct, score.misses, score.withheld) == (7, 3, 2, 1)
    assert score.class_accuracy == pytest.approx(100 * 3 / 7)
    assert score.ape_m == pytest.approx(0.5)
    assert score.ape_count == 5, "wrong classes count, withheld reports do not"
    assert (score.visible.count, score.visible.total) == (2, 5)
    assert (score.occluded.count, score.occluded.total) == (1, 2)
    assert (score.withheld_visible.count, score.withheld_visible.total) == (1, 5)
    assert (score.per_class["4-yleft2"].count, score.per_class["4-yleft2"].total) == (1, 2)
    assert score.per_class["3-green"].percent is None
    assert (score.false_reports, score.false_tracks) == (2, 1)
    confusion = np.array(score.confusion)
    ids = signals.class_ids
    assert confusion.sum() == 7 + 2
    assert confusion[ids["3-red"]].nonzero()[0].tolist() == sorted([ids["3-red"], ids["3-green"], 13])
    assert confusion[ids["4-yleft2"], ids["4-off"]] == 1, "the dark phase is the flashing arrow"
    assert confusion[13, ids["3-red"]] == 2


def test_a_drive_without_any_light(signals: SignalSet) -> None:
    score = score_variant("od", [], [], signals, None)
    assert (score.class_accuracy, score.ape_m, score.flickers_per_minute, score.false_tracks) == (None,) * 4


def test_the_town(town) -> None:
    evaluation = evaluate([(town.run_dir, town.drive_dir)], town.signals)
    od, fusion, full = (evaluation.variants[name] for name in ("od", "fusion", "full"))
    assert od.labelled == fusion.labelled == full.labelled > 100
    assert (od.correct, od.misses) == (fusion.correct, fusion.misses), "fusion takes over the classes"
    assert od.occluded.count == 0
    assert od.occluded.total == od.misses == full.occluded.count > 0, "the tracker sees through the lorry"
    assert od.ape_m == pytest.approx(1.2, abs=1e-3)
    assert full.causes["transition"] == 4, "the tracker is one set late, in both cameras"
    assert (full.false_reports, full.false_tracks) == (0, 0)
    assert full.flash_onsets.median_s == pytest.approx(1.3, abs=0.01)
    assert od.flash_onsets.never == od.flash_onsets.total == 1
    assert od.causes["flashing"] > full.causes["flashing"]
    assert full.speed == Speed(sets=69, images=138, sets_per_s=40, images_per_s=80, detect_ms=20, track_ms=5)


def test_two_runs_count_as_one_long_run(town) -> None:
    once, twice = (evaluate([(town.run_dir, town.drive_dir)] * n, town.signals) for n in (1, 2))
    for name, score in once.variants.items():
        assert twice.variants[name].labelled == 2 * score.labelled
        assert twice.variants[name].class_accuracy == pytest.approx(score.class_accuracy)
        assert twice.variants[name].ape_m == pytest.approx(score.ape_m)


def test_an_evaluation_comes_back_from_its_file(town, tmp_path: Path) -> None:
    evaluation = evaluate([(town.run_dir, town.drive_dir)], town.signals)
    evaluation.save(tmp_path / "evaluation.json")
    assert Evaluation.load(tmp_path / "evaluation.json") == evaluation
    (tmp_path / "evaluation.json").write_text("{}")
    with pytest.raises(DataError, match=r"evaluation.json: drives: Field required"):
        Evaluation.load(tmp_path / "evaluation.json")


def test_speeds_add_up_by_time() -> None:
    def entry(sets: int, fps: float, ms: float) -> dict[str, object]:
        return {"sets": sets, "images": 2 * sets, "fps": fps, "detect_ms": {"mean": ms}, "track_ms": {"mean": 1.0}}

    speed = merge_speeds([entry(10, 10.0, 50), entry(30, 30.0, 30), None])
    assert speed is not None
    assert (speed.sets, speed.images, speed.sets_per_s, speed.detect_ms) == (40, 80, pytest.approx(20), 35)


@pytest.fixture
def own_run(town, tmp_path: Path) -> tuple[Path, Path]:
    shutil.copytree(town.run_dir, tmp_path / "run")
    shutil.copytree(town.drive_dir, tmp_path / "drive")
    return tmp_path / "run", tmp_path / "drive"


def _edit_lights(path: Path, change) -> None:
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    for line in lines:
        line["lights"] = change(line)
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


def test_reports_of_nothing_are_counted_and_those_of_lights_out_of_range_are_not(town, own_run) -> None:
    run_dir, _ = own_run

    def haunt(line: dict) -> list[dict]:
        ghosts = []
        for light in line["lights"][:1]:
            east, north, up = light["position"]
            views = [{**view, "box_xyxy": [1, 1, 5, 12]} for view in light["views"]]
            ghosts = [{**light, "map_id": "ghost", "track_id": 99, "position": [east, north + 20, up], "views": views}]
        return line["lights"] + ghosts

    _edit_lights(run_dir / "estimates.jsonl", haunt)
    before = evaluate([(town.run_dir, town.drive_dir)], town.signals)
    after = evaluate([own_run], town.signals)
    for name, score in after.variants.items():
        assert score.class_accuracy == before.variants[name].class_accuracy
        assert score.false_reports > 30
        assert np.array(score.confusion)[-1].sum() == score.false_reports
    assert after.variants["full"].false_tracks == 1


def test_frames_that_a_run_left_out_are_misses(town, own_run) -> None:
    run_dir, _ = own_run
    lines = (run_dir / "estimates.jsonl").read_text().splitlines(keepends=True)
    (run_dir / "estimates.jsonl").write_text("".join(lines[30:]))  # ten sets of three variants
    evaluation = evaluate([own_run], town.signals)
    whole = evaluate([(town.run_dir, town.drive_dir)], town.signals)
    assert evaluation.unanswered_frames == 20
    for name, score in evaluation.variants.items():
        assert score.labelled == whole.variants[name].labelled
        assert score.misses > whole.variants[name].misses


def test_frames_without_a_pose_are_not_scored(town, own_run) -> None:
    _, drive_dir = own_run
    poses = (drive_dir / "poses.csv").read_text().splitlines(keepends=True)
    (drive_dir / "poses.csv").write_text("".join(poses[:201]))  # up to 3.98 s
    evaluation = evaluate([own_run], town.signals)
    assert evaluation.skipped_frames == 58
    assert evaluation.frames == 138 - 58


def test_wrong_pairs_of_run_and_drive_are_named(town, own_run) -> None:
    run_dir, drive_dir = own_run
    info = json.loads((run_dir / "run.json").read_text())
    (run_dir / "run.json").write_text(json.dumps({**info, "drive": "elsewhere"}))
    with pytest.raises(DataError, match=r"run.json: is a run over drive 'elsewhere', not over 'town'"):
        gather_outcomes(run_dir, drive_dir, town.signals)
    (run_dir / "run.json").write_text(json.dumps(info))
    estimates = run_dir / "estimates.jsonl"
    estimates.write_text(estimates.read_text().replace('"class": "3-red"', '"class": "3-blue"', 1))
    with pytest.raises(DataError, match=r"estimates.jsonl: reports the class '3-blue'.*another one"):
        gather_outcomes(run_dir, drive_dir, town.signals)
    estimates.write_text("")
    with pytest.raises(DataError, match=r"estimates.jsonl: holds no estimates of od, fusion, full"):
        gather_outcomes(run_dir, drive_dir, town.signals)
    truth = drive_dir / "truth.jsonl"
    truth.write_text(truth.read_text().replace('"class": "3-red"', '"class": "3-blue"', 1))
    with pytest.raises(DataError, match=r"truth.jsonl: light '.*' at .* has the class '3-blue'"):
        gather_outcomes(town.run_dir, drive_dir, town.signals)
    truth.unlink()
    with pytest.raises(DataError, match=r"truth.jsonl: no such file; only a drive with truth"):
        gather_outcomes(town.run_dir, drive_dir, town.signals)
