import json
import math

import numpy as np
import pytest

from autolights.core import ConfusionMatrix
from autolights.train.measure.metrics import DetectionMetrics
from autolights.train.measure.operating_point import HeightBand, ThresholdSweep

# Rows are the truth, the last one false alarms; columns what was seen, the last one misses.
COUNTS = [[6, 1, 0, 1], [0, 2, 0, 2], [0, 0, 0, 0], [2, 0, 0, 0]]


@pytest.fixture
def metrics():
    return DetectionMetrics(
        ap=0.5,
        ap50=0.75,
        ap75=0.6,
        ap_s=0.4,
        ap_m=math.nan,
        per_class_ap={"red": 1 / 3, "green": 0.9},
        curves={"red": np.linspace(1, 0, 101), "green": np.ones(101)},
        images=7,
        labels=12,
        confusion=ConfusionMatrix(("red", "green", "off"), np.array(COUNTS), 0.25, 0.5),
        heights=(HeightBand(4, 8, 3, 1), HeightBand(32, math.inf, 0, 0)),
        sweep=ThresholdSweep(np.array([0.2, 0.4]), np.array([0.6, 1.0]), np.array([0.6, 0.5])),
        unreadable=("torn.jpg",),
    )


def test_precision_and_recall_are_read_from_the_confusion_matrix(metrics):
    assert (metrics.precision, metrics.recall) == (8 / 11, 8 / 12)
    assert metrics.per_class_precision == pytest.approx({"red": 6 / 8, "green": 2 / 3, "off": math.nan}, nan_ok=True)
    assert metrics.per_class_recall == pytest.approx({"red": 6 / 8, "green": 2 / 4, "off": math.nan}, nan_ok=True)


def test_metrics_file_holds_null_for_what_was_not_measured(metrics, tmp_path):
    metrics.save(tmp_path / "metrics.json")

    assert json.loads((tmp_path / "metrics.json").read_text()) == {
        "ap": 0.5,
        "ap50": 0.75,
        "ap75": 0.6,
        "ap_s": 0.4,
        "ap_m": None,
        "per_class": {"red": 0.33333, "green": 0.9},
        "per_class_ap50": {"red": 0.5, "green": 1.0},
        "images": 7,
        "labels": 12,
        "score_threshold": 0.25,
        "iou_threshold": 0.5,
        "precision": 0.72727,
        "recall": 0.66667,
        "per_class_precision": {"red": 0.75, "green": 0.66667, "off": None},
        "per_class_recall": {"red": 0.75, "green": 0.5, "off": None},
        "recall_by_height_px": {"4-8": {"labels": 3, "recall": 0.33333}, "32+": {"labels": 0, "recall": None}},
        "best_threshold": 0.4,
        "best_f1": 0.66667,
        "unreadable": ["torn.jpg"],
    }
