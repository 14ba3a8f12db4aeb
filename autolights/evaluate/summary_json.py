"""The report's figures for machines: ``summary.json``."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from autolights.core.errors import DataError
from autolights.core.estimates import Variant
from autolights.core.json_files import read_json_object
from autolights.evaluate.score import Evaluation

_NAMES: dict[Variant, str] = {"od": "od", "fusion": "od_fusion", "full": "proposed"}
AP_NAMES = ("ap", "ap50", "ap75", "ap_s", "ap_m")


def summary(evaluation: Evaluation, metrics_path: Path, minutes: Mapping[str, float]) -> dict[str, Any]:
    """The figures that a benchmark or a later run compares.

    Args:
        evaluation: Of the drives.
        metrics_path: The detector's ``metrics.json``; AP from 0 to 1.
        minutes: Of each stage.

    Returns:
        `minutes`; `detector` with AP figures and images per second; for each variant (`od`, `od_fusion`, `proposed`)
        `fps` in frame sets per second, `ape_m`, `ape_count`, `class_accuracy` in percent, `misses` and `labelled`.
        A figure that does not exist (no match, no such object) is None.

    Raises:
        DataError: If the metrics cannot be read.
    """
    metrics = load_metrics(metrics_path)
    detector: dict[str, Any] = {name: metrics[name] for name in AP_NAMES}
    detector["fps"] = _rounded(detector_fps(evaluation), 2)
    figures: dict[str, Any] = {
        "minutes": {name: round(value, 2) for name, value in minutes.items()},
        "detector": detector,
    }
    for variant, score in evaluation.variants.items():
        figures[_NAMES[variant]] = {
            "fps": _rounded(score.speed.sets_per_s if score.speed else None, 2),
            "ape_m": _rounded(score.ape_m, 4),
            "ape_count": score.ape_count,
            "class_accuracy": _rounded(score.class_accuracy, 3),
            "misses": score.misses,
            "labelled": score.labelled,
        }
    return figures


def detector_fps(evaluation: Evaluation) -> float | None:
    """Images per second through the detector alone; None if no run tells."""
    for score in evaluation.variants.values():
        if score.speed is not None and score.speed.detect_ms > 0:
            return 1000 * score.speed.images / (score.speed.sets * score.speed.detect_ms)
    return None


def load_metrics(path: Path) -> dict[str, Any]:
    """Read the detector's ``metrics.json``; figures that are not numbers (no such objects) become None.

    Raises:
        DataError: If the file is missing, no JSON object, or lacks one of the AP figures.
    """
    values = read_json_object(path, hint="run `autolights val` first")
    for name in AP_NAMES:
        if name not in values:
            raise DataError(f"{path}: field '{name}' is missing")
        values[name] = _number(values[name])
    values["per_class"] = {name: _number(value) for name, value in values.get("per_class", {}).items()}
    return values


def _number(value: Any) -> float | None:
    number = float("nan") if value is None else float(value)
    return number if number == number else None  # NaN differs from itself


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
