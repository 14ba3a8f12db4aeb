import math

import numpy as np
import pytest

from autolights.train.measure.operating_point import THRESHOLDS, ThresholdSweep, recall_by_height, sweep_thresholds
from autolights.train.measure.predictions import Labels, Predictions


def labels(*boxes, ids=None):
    return Labels(np.array(boxes, dtype=float).reshape(-1, 4), np.array(ids or [0] * len(boxes), dtype=np.int64))


def reported(*boxes, scores, ids=None):
    return Predictions(
        np.array(boxes, dtype=float).reshape(-1, 4),
        np.array(ids or [0] * len(boxes), dtype=np.int64),
        np.array(scores, dtype=float),
    )


def light(height_px, x=0.0):
    return [x, 0.0, x + 10.0, float(height_px)]


def test_bands_are_by_height_in_the_image_and_their_low_ends_belong_to_them():
    sides = [3, 4, 7.9, 8, 16, 31, 32, 400]
    truth = labels(*(light(side, 20 * i) for i, side in enumerate(sides)))
    seen = reported(light(4, 20), light(8, 60), light(400, 140), scores=[0.9, 0.9, 0.9])

    bands = recall_by_height([truth, labels()], [seen, reported(scores=[])], iou_threshold=0.5)

    assert [(band.name, band.labels, band.found) for band in bands] == [
        ("4-8", 2, 1),
        ("8-16", 1, 1),
        ("16-32", 2, 0),
        ("32+", 2, 1),
    ]
    assert [band.recall for band in bands] == [0.5, 1, 0, 0.5]


def test_a_light_of_another_class_is_not_found():
    bands = recall_by_height([labels(light(20))], [reported(light(20), scores=[0.9], ids=[1])], iou_threshold=0.5)

    assert bands[2].recall == 0
    assert math.isnan(bands[0].recall)


def test_sweep_by_hand():
    truth = [labels(light(20), light(20, 100)), labels(light(20), ids=[1])]
    seen = [
        reported(light(20), light(20, 200), scores=[0.9, 0.6]),  # right, and a false alarm
        reported(light(20), scores=[0.3], ids=[1]),
    ]

    sweep = sweep_thresholds(truth, seen, iou_threshold=0.5)

    at = {round(float(t), 2): i for i, t in enumerate(sweep.thresholds)}
    assert (sweep.precision[at[0.3]], sweep.recall[at[0.3]]) == (2 / 3, 2 / 3)
    assert (sweep.precision[at[0.35]], sweep.recall[at[0.35]]) == (1 / 2, 1 / 3)
    assert (sweep.precision[at[0.9]], sweep.recall[at[0.9]]) == (1, 1 / 3)
    assert math.isnan(sweep.precision[at[0.95]])
    assert sweep.best == (0.05, pytest.approx(2 / 3))
    assert sweep.f1[at[0.95]] == 0


def test_without_labels_there_is_no_best_threshold_but_the_lowest():
    sweep = sweep_thresholds([labels()], [reported(light(9), scores=[0.5])], iou_threshold=0.5)

    assert np.isnan(sweep.recall).all()
    assert sweep.best == (THRESHOLDS[0], 0)


def test_best_of_equal_thresholds_is_the_lowest():
    sweep = ThresholdSweep(np.array([0.1, 0.2, 0.3]), np.array([0.5, 0.8, 0.8]), np.array([0.5, 0.8, 0.8]))

    assert sweep.best == (0.2, pytest.approx(0.8))
