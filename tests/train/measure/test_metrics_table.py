import math

import numpy as np

from autolights.core import ConfusionMatrix
from autolights.train.measure.metrics import DetectionMetrics
from autolights.train.measure.metrics_table import metrics_as_text
from autolights.train.measure.operating_point import HeightBand, ThresholdSweep


def test_tables():
    metrics = DetectionMetrics(
        ap=0.5,
        ap50=0.75,
        ap75=0.6,
        ap_s=0.4,
        ap_m=math.nan,
        per_class_ap={"red": 0.5},
        curves={"red": np.full(101, 0.75)},
        images=7,
        labels=1234,
        confusion=ConfusionMatrix(("red", "off"), np.array([[900, 34, 300], [0, 0, 0], [100, 0, 0]]), 0.25, 0.5),
        heights=(HeightBand(4, 8, 40, 10), HeightBand(32, math.inf, 0, 0)),
        sweep=ThresholdSweep(np.array([0.2, 0.4]), np.array([0.6, 1.0]), np.array([0.6, 0.5])),
        unreadable=("torn.jpg",),
    )

    assert metrics_as_text(metrics).splitlines() == [
        "7 images, 1 more do not decode, 1234 labels",
        "   AP   AP50   AP75   AP_S  AP_M",
        "0.500  0.750  0.600  0.400     -",
        "",
        "precision and recall at score 0.25, overlap 0.5 (F1 is best at score 0.40: 0.667)",
        "class  labels     AP   AP50  precision  recall",
        "all      1234  0.500  0.750      0.870   0.729",
        "red      1234  0.500  0.750      0.900   0.729",
        "off         0      -      -      0.000       -",
        "",
        "height px  labels  recall",
        "4-8            40   0.250",
        "32+             0       -",
    ]
