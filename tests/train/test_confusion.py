import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from autolights.core.boxes import iou_matrix
from autolights.train.confusion import count_confusions, match_boxes

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


def test_the_best_overlap_is_taken_first():
    truths = np.array([[0.0, 0, 100, 100], [0.0, 20, 100, 120]])
    seen = np.array([[0.0, 18, 100, 118]])  # overlaps both, the second one more

    rows, columns = match_boxes(truths, seen, iou_threshold=0.5)

    assert (rows.tolist(), columns.tolist()) == ([1], [0])


def test_an_overlap_of_exactly_the_threshold_counts():
    rows, _ = match_boxes(np.array([[0.0, 0, 10, 10]]), np.array([[0.0, 0, 10, 5]]), iou_threshold=0.5)

    assert rows.tolist() == [0]


corners = arrays(np.float64, st.tuples(st.integers(0, 4), st.just(2)), elements=st.integers(0, 6))


@given(corners, corners, st.integers(1, 3))
def test_no_pair_could_be_bettered_by_two_free_boxes(low_a, low_b, size):
    boxes_a, boxes_b = np.hstack([low_a, low_a + 3]), np.hstack([low_b, low_b + 2 + size])
    overlap = iou_matrix(boxes_a, boxes_b)

    rows, columns = match_boxes(boxes_a, boxes_b, iou_threshold=0.3)

    assert len(set(rows)) == len(rows)
    assert len(set(columns)) == len(columns)
    partner_a = dict(zip(rows.tolist(), overlap[rows, columns], strict=True))
    partner_b = dict(zip(columns.tolist(), overlap[rows, columns], strict=True))
    for a, b in itertools.product(range(len(boxes_a)), range(len(boxes_b))):
        if overlap[a, b] >= 0.3:
            assert partner_a.get(a, 0) >= overlap[a, b] or partner_b.get(b, 0) >= overlap[a, b]
