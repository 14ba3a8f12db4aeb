"""The report: one HTML file that opens anywhere, with everything that a person wants to see of a run."""

import base64
import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

import autolights
from autolights.core import Bundle, ConfusionMatrix, FloatArray, ImageArray, SignalSet
from autolights.core.atomic import write_text
from autolights.core.errors import DataError
from autolights.data import FrameRecord, load_detections
from autolights.data.run_output import DETECTIONS
from autolights.evaluate.errors_by_cause import CAUSES
from autolights.evaluate.figures import class_accuracy_figure, confusion_figure, hmm_figure, learning_figure
from autolights.evaluate.film import best_scene, encode_webm, film_frames
from autolights.evaluate.moments import Mark, Moment, saved_moments
from autolights.evaluate.outcomes import RunOutcomes, gather_outcomes
from autolights.evaluate.palette import DARK, MISSED, main_color
from autolights.evaluate.paper import DETECTORS, PIPELINE
from autolights.evaluate.score import Evaluation
from autolights.evaluate.sequence import most_eventful, sequence_figure
from autolights.evaluate.summary_json import AP_NAMES, detector_fps, load_metrics
from autolights.evaluate.tables import detail_rows, number

RESULTS = "results.csv"
_PICTURE_WIDTH = 640  # px of a crop in the page; small crops are enlarged so that marks and image stay in step
_JPEG_QUALITY = 86
_LETTER_PX, _LABEL_PX = 7.3, 17.0


@dataclass(frozen=True)
class _Label:
    x: float
    y: float
    width: float
    text: str
    color: str
    ink: str


@dataclass(frozen=True)
class _Box:
    x: float
    y: float
    width: float
    height: float
    color: str
    missed: bool
    label: _Label


@dataclass(frozen=True)
class _Picture:
    """A crop with its marks, in pixels of the page."""

    uri: str
    width: int
    height: int
    boxes: tuple[_Box, ...]


def write_report(
    out_html: Path,
    *,
    train_dir: Path | None,
    metrics_path: Path,
    bundle: Bundle,
    runs: Sequence[tuple[Path, Path]],
    evaluation: Evaluation,
    minutes: Mapping[str, float],
    title: str,
) -> None:
    """Write the report; it needs no other file and asks nothing of a network.

    Args:
        out_html: The file; an older one is replaced.
        train_dir: A training run with ``results.csv``; None leaves the learning curves out.
        metrics_path: ``metrics.json`` of the validation.
        bundle: What was run.
        runs: (folder of the run, folder of the drive) of each.
        evaluation: Of the same runs.
        minutes: Of each stage; may be empty.
        title: Heading of the page.

    Raises:
        DataError: If a file is missing or breaks its format.
    """
    signals = bundle.signals
    outcomes = [gather_outcomes(run_dir, drive_dir, signals) for run_dir, drive_dir in runs]
    metrics = load_metrics(metrics_path)
    environment = Environment(
        loader=PackageLoader("autolights.evaluate"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = number
    page = environment.get_template("report.html.j2").render(
        title=title,
        version=autolights.__version__,
        bundle=bundle,
        evaluation=evaluation,
        metrics=metrics,
        ap_names=AP_NAMES,
        detector_fps=detector_fps(evaluation),
        paper=PIPELINE,
        paper_detectors=DETECTORS,
        causes=CAUSES,
        details=_details(evaluation),
        minutes=minutes,
        moments=[_moment_view(moment, signals) for moment in saved_moments(outcomes, signals)],
        film=_film(outcomes, [run_dir for run_dir, _ in runs], signals),
        **_figures(train_dir, bundle, outcomes, evaluation),
    )
    write_text(out_html, page)


def _figures(
    train_dir: Path | None, bundle: Bundle, outcomes: Sequence[RunOutcomes], evaluation: Evaluation
) -> dict[str, Any]:
    sequence = most_eventful(outcomes)
    od, full = evaluation.variants.get("od"), evaluation.variants.get("full")
    proposed_confusion: Markup | None = None
    per_class: Markup | None = None
    if full is not None:
        # No threshold of its own: the tracker reports what it believes.
        matrix = ConfusionMatrix(evaluation.classes, np.array(full.confusion), 0.0, 0.5)
        proposed_confusion = confusion_figure(matrix, name="proposed", predicted="reported")
        if od is not None:
            pairs = {name: (od.per_class[name].percent, full.per_class[name].percent) for name in evaluation.classes}
            per_class = class_accuracy_figure(pairs, bundle.signals)
    return {
        "learning": None if train_dir is None else learning_figure(_load_results(train_dir / RESULTS)),
        "detector_confusion": confusion_figure(bundle.confusion, name="detector", predicted="detected"),
        "proposed_confusion": proposed_confusion,
        "per_class": per_class,
        "sequence": sequence,
        "sequence_figure": None if sequence is None else sequence_figure(sequence, bundle.signals),
        "hmm": {name: hmm_figure(parameters) for name, parameters in bundle.hmm.items()},
    }


def _load_results(path: Path) -> dict[str, FloatArray]:
    """Columns of a training run's table; empty cells are NaN, and are not drawn."""
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error
    try:
        names = rows[0].keys() if rows else ()
        columns = {name: np.array([float(row[name] or "nan") for row in rows]) for name in names}
    except (TypeError, ValueError) as error:
        raise DataError(f"{path}: {error}") from error
    missing = {"epoch", "lr", "box", "obj", "cls", "ap", "ap50", "ap75"} - columns.keys()
    if missing:
        raise DataError(f"{path}: column '{min(missing)}' is missing")
    return columns


def _details(evaluation: Evaluation) -> list[tuple[str, list[str]]]:
    columns = [detail_rows(score) for score in evaluation.variants.values()]
    return [(rows[0][0], [text for _, text in rows]) for rows in zip(*columns, strict=True)]


def _film(outcomes: Sequence[RunOutcomes], run_dirs: Sequence[Path], signals: SignalSet) -> dict[str, Any] | None:
    scene = best_scene(outcomes)
    if scene is None:
        return None
    detections = load_detections(run_dirs[outcomes.index(scene.run)] / DETECTIONS)
    frames = film_frames(scene, detections, signals)
    if not frames:
        return None
    webm = encode_webm(frames, scene.fps)
    height, width = frames[0].shape[:2]
    return {
        "width": width,
        "height": height,
        "drive": scene.run.drive.name,
        "camera": scene.records[0].camera,
        "seconds": len(frames) / scene.fps,
        "poster": _jpeg_uri(frames[len(frames) // 3]),
        "webm": None if webm is None else f"data:video/webm;base64,{base64.b64encode(webm).decode()}",
    }


def _moment_view(moment: Moment, signals: SignalSet) -> dict[str, Any]:
    drive = moment.run.drive
    image = drive.read(_record(moment)).image_bgr
    left, top, right, bottom = moment.crop_xyxy
    scale = _PICTURE_WIDTH / (right - left)
    size_wh = (_PICTURE_WIDTH, round((bottom - top) * scale))
    way = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    crop = np.asarray(cv2.resize(image[top:bottom, left:right], size_wh, interpolation=way), dtype=np.uint8)
    uri = _jpeg_uri(crop)
    reasons = [CAUSES[cause] for cause in dict.fromkeys(moment.causes)]
    return {
        "od": _Picture(uri, *size_wh, _boxes(moment.od, moment, scale, size_wh, signals)),
        "proposed": _Picture(uri, *size_wh, _boxes(moment.proposed, moment, scale, size_wh, signals)),
        "where": f"{drive.name}, {moment.camera} camera, {(moment.stamp_ns - drive.frames[0].stamp_ns) / 1e9:.1f} s",
        "count": len(moment.rescued),
        "why": "; ".join(reasons),
    }


def _record(moment: Moment) -> FrameRecord:
    frames = moment.run.drive.frames
    return next(f for f in frames if (f.camera, f.stamp_ns) == (moment.camera, moment.stamp_ns))


def _boxes(
    marks: Sequence[Mark], moment: Moment, scale: float, size_wh: tuple[int, int], signals: SignalSet
) -> tuple[_Box, ...]:
    """Marks in the crop's pixels; labels dodge each other upwards and downwards."""
    left, top, _, _ = moment.crop_xyxy
    placed: list[_Label] = []
    boxes = []
    for mark in sorted(marks, key=lambda mark: mark.box_xyxy[0]):
        x1, y1, x2, y2 = ((edge - offset) * scale for edge, offset in zip(mark.box_xyxy, (left, top) * 2, strict=True))
        if x2 < 0 or y2 < 0 or x1 > size_wh[0] or y1 > size_wh[1]:
            continue
        color = MISSED if mark.class_name is None else main_color(mark.class_name, signals)
        sign = {True: " ✓", False: " ✗", None: ""}[mark.right]
        text = mark.label + sign
        width = _LETTER_PX * len(text) + 8
        x = float(np.clip((x1 + x2 - width) / 2, 2, size_wh[0] - width - 2))
        rows = [y1 - _LABEL_PX - 3, y2 + 3, y1 - 2 * _LABEL_PX - 5, y2 + _LABEL_PX + 5]
        free = [y for y in rows if 0 <= y <= size_wh[1] - _LABEL_PX and not _covers(placed, x, y, width)]
        ink = "#ffffff" if color == DARK else "#14181d"
        label = _Label(x, free[0] if free else rows[1], width, text, color, ink)
        placed.append(label)
        boxes.append(_Box(x1, y1, x2 - x1, y2 - y1, color, mark.class_name is None, label))
    return tuple(boxes)


def _covers(placed: Sequence[_Label], x: float, y: float, width: float) -> bool:
    return any(x < p.x + p.width and p.x < x + width and abs(y - p.y) < _LABEL_PX + 1 for p in placed)


def _jpeg_uri(image_bgr: ImageArray) -> str:
    _, data = cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return f"data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}"
