import numpy as np
import pytest

from autolights.train.measure.confusion import count_confusions

NO_BOXES, NO_IDS = np.empty((0, 4)), np.empty(0, dtype=np.int64)
BOX = [10.0, 10.0, 30.0, 50.0]
FAR_BOX = [200.0, 10.0, 220.0, 50.0]


@pytest.mark.parametrize(
    ("truth", "seen", "expected"),
    [
        pytest.param([(BOX, 0)], [(BOX, 0)], {(0, 0): 1}, id="right"),
        pytest.param([(BOX, 0)], [(BOX, 1)], {(0, 1): 1}, id="wrong-class"),
        pytest.param([(BOX, 1)], [], {(1, 2): 1}, id="missed"),
        pytest.param([], [(BOX, 1)], {(2, 1): 1}, id="false-alarm"),
        pytest.param([(BOX, 0)], [(FAR_BOX, 0)], {(0, 2): 1, (2, 0): 1}, id="elsewhere"),
        pytest.param([(BOX, 0)], [(BOX, 0), (BOX, 1)], {(0, 0): 1, (2, 1): 1}, id="second-detection-is-a-false-alarm"),
        pytest.param(
            [(BOX, 0), (FAR_BOX, 0)], [(FAR_BOX, 0), (BOX, 1)], {(0, 0): 1, (0, 1): 1}, id="same-class-counted-twice"
        ),
        pytest.param([], [], {}, id="nothing"),
    ],
)
def test_counts_by_hand(truth, seen, expected):
    def columns(rows):
        return np.array([box for box, _ in rows]).reshape(-1, 4), np.array([i for _, i in rows], dtype=np.int64)

    counts = count_confusions(*columns(truth), *columns(seen), class_count=2, iou_threshold=0.5)

    assert {(int(i), int(j)): int(counts[i, j]) for i, j in zip(*np.nonzero(counts), strict=True)} == expected
