import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from autolights.core.errors import DataError
from autolights.evaluate import evaluate, gather_outcomes, summary, write_report
from autolights.evaluate.film import best_scene, encode_webm, film_frames
from autolights.evaluate.moments import saved_moments
from autolights.evaluate.palette import MAP, bgr
from autolights.evaluate.sequence import most_eventful
from autolights.evaluate.summary_json import load_metrics


def _write(town, out: Path, *, minutes: dict[str, float], with_training: bool = True) -> str:
    runs = [(town.run_dir, town.drive_dir)]
    write_report(
        out,
        train_dir=town.train_dir if with_training else None,
        metrics_path=town.metrics_path,
        bundle=town.bundle,
        runs=runs,
        evaluation=evaluate(runs, town.signals),
        minutes=minutes,
        title="The <town> & its lights",
    )
    return out.read_text()


@pytest.fixture(scope="module")
def page(town, tmp_path_factory: pytest.TempPathFactory) -> str:
    return _write(town, tmp_path_factory.mktemp("report") / "report.html", minutes={"train": 5.25})


def test_the_page_needs_nothing_else(page: str) -> None:
    # Names of XML namespaces are no requests.
    links = re.findall(r"""(?:href|src|poster)=["']([^"']{0,40})|url\(([^)]{0,40})|@import""", page)
    outside = [link for pair in links for link in pair if link and not link.startswith(("data:", "#"))]
    assert outside == []
    assert len(page) < 12e6
    assert "The &lt;town&gt; &amp; its lights" in page


@pytest.mark.parametrize(
    "text",
    [
        "What each part adds",
        "One light over time",
        "Where tracking saves the day",
        "3-yellow ✗",
        "#1 3-red ✓",
        "missed ✗",
        "flashing ✓",
        "data:video/webm;base64,",
        "Confusion matrix of the proposed pipeline",
        "Learning curves",
        "A: next state after 0.1 s",
        "5.25",
        "YOLOv5s (Table II)",
    ],
)
def test_the_page_shows(page: str, text: str) -> None:
    assert text in page


def test_figures_follow_dark_mode(page: str) -> None:
    figures = re.findall(r"<svg viewBox.*?</svg>", page, flags=re.DOTALL)
    assert len(figures) >= 7
    assert all("var(--ink)" in figure and "#1a1f26" not in figure for figure in figures)


def test_without_training_and_times_their_sections_are_left_out(town, tmp_path: Path) -> None:
    page = _write(town, tmp_path / "report.html", minutes={}, with_training=False)
    assert "Learning curves" not in page
    assert "Minutes of each stage" not in page


def test_moments_are_rescues_from_different_episodes(town) -> None:
    run = gather_outcomes(town.run_dir, town.drive_dir, town.signals)
    moments = saved_moments([run], town.signals)
    assert len(moments) >= 2
    stamps = sorted(moment.stamp_ns for moment in moments)
    assert all(later - earlier >= 2e9 for earlier, later in pairwise(stamps))
    assert {cause for moment in moments for cause in moment.causes} >= {"occluded", "flashing"}
    for moment in moments:
        assert any(mark.right is False for mark in moment.od)
        left, top, right, bottom = moment.crop_xyxy
        assert 0 <= left < right <= 320
        assert 0 <= top < bottom <= 200


def test_the_most_eventful_light_is_the_flashing_one(town) -> None:
    sequence = most_eventful([gather_outcomes(town.run_dir, town.drive_dir, town.signals)])
    assert sequence is not None
    assert sequence.proposed[0].truth.truth_id == "B"
    assert [row.stamp_ns for row in sequence.od] == [row.stamp_ns for row in sequence.proposed]


def test_the_film_plays(town, tmp_path: Path) -> None:
    run = gather_outcomes(town.run_dir, town.drive_dir, town.signals)
    scene = best_scene([run])
    assert scene is not None
    assert scene.fps == pytest.approx(10)
    frames = film_frames(scene, [], town.signals)
    webm = encode_webm(frames, scene.fps)
    assert webm is not None
    (tmp_path / "film.webm").write_bytes(webm)
    capture = cv2.VideoCapture(str(tmp_path / "film.webm"))
    count = 0
    while capture.read()[0]:
        count += 1
    assert count == len(frames) == len(scene.records)


def test_the_film_shows_the_map_as_the_runtime_sees_it(town) -> None:
    run = gather_outcomes(town.run_dir, town.drive_dir, town.signals)
    scene = best_scene([run])
    assert scene is not None
    scene = replace(scene, records=scene.records[:1])
    turned_away = replace(run.drive.lights, headings_deg=run.drive.lights.headings_deg + 180)
    unseen = replace(scene, run=replace(run, drive=replace(run.drive, lights=turned_away)))

    cyan = []
    for shot in (scene, unseen):
        (image,) = film_frames(shot, [], town.signals)
        cyan.append((np.abs(image.astype(int) - bgr(MAP)) < 20).all(axis=-1).sum())

    assert cyan[0] > 0
    assert cyan[1] == 0, "the runtime expects nothing of a light that looks away"


def test_summary_holds_the_figures_of_the_report(town) -> None:
    evaluation = evaluate([(town.run_dir, town.drive_dir)], town.signals)
    figures = summary(evaluation, town.metrics_path, {"train": 5.254})
    json.dumps(figures, allow_nan=False)
    assert figures["minutes"] == {"train": 5.25}
    assert figures["detector"] == {"ap": 0.65, "ap50": 0.9, "ap75": 0.75, "ap_s": 0.6, "ap_m": None, "fps": 100.0}
    assert set(figures["proposed"]) == {"fps", "ape_m", "ape_count", "class_accuracy", "misses", "labelled"}
    assert figures["od"]["class_accuracy"] < figures["proposed"]["class_accuracy"] <= 100
    assert set(figures) == {"minutes", "detector", "od", "od_fusion", "proposed"}


def test_broken_inputs_are_named(town, tmp_path: Path) -> None:
    path = tmp_path / "metrics.json"
    with pytest.raises(DataError, match=r"metrics.json: cannot be read .*autolights val"):
        load_metrics(path)
    path.write_text('{"ap": NaN, "ap50": 0.9}')
    with pytest.raises(DataError, match=r"metrics.json: field 'ap75' is missing"):
        load_metrics(path)
