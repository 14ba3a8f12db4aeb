import math

import cv2
import numpy as np
import pytest

from autolights.core import ConfusionMatrix
from autolights.train.measure.curves import draw_curves, save_curves
from autolights.train.measure.metrics import DetectionMetrics
from autolights.train.measure.operating_point import THRESHOLDS, HeightBand, ThresholdSweep


def metrics_of(class_count):
    names = tuple(f"class-{i}" for i in range(class_count))
    curves = {name: np.linspace(1, i / class_count, 101) for i, name in enumerate(names)}
    falling = THRESHOLDS[::-1] if class_count else np.full_like(THRESHOLDS, np.nan)
    return DetectionMetrics(
        ap=0.5 if class_count else math.nan,
        ap50=0.7 if class_count else math.nan,
        ap75=0.5,
        ap_s=0.5,
        ap_m=0.5,
        per_class_ap=dict.fromkeys(names, 0.5),
        curves=curves,
        images=9,
        labels=class_count,
        confusion=ConfusionMatrix(names, np.eye(class_count + 1, dtype=np.int64), 0.25, 0.5),
        heights=(HeightBand(4, 8, class_count, class_count // 2), HeightBand(32, math.inf, 0, 0)),
        sweep=ThresholdSweep(THRESHOLDS, THRESHOLDS, falling),
    )


@pytest.mark.parametrize("class_count", [0, 1, 13, 80])  # nothing to find, and more classes than the legend names
def test_any_number_of_classes_fits(class_count):
    picture = draw_curves(metrics_of(class_count))

    assert picture.shape == (507, 1690, 3)
    ink = (picture < 100).all(axis=2).any(axis=0)
    assert not ink[:3].any()  # no text is cut at the edge
    assert not ink[-3:].any()


def test_the_file_holds_the_picture(tmp_path):
    metrics = metrics_of(3)

    save_curves(metrics, tmp_path / "pr_curves.png")

    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "pr_curves.png"))[..., ::-1], draw_curves(metrics))
