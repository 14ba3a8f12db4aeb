import itertools

import numpy as np
import pytest
import torch
import torchvision.ops
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from autolights.core.boxes import area, clip, cxcywh_from_xyxy, iou_matrix, match_boxes, nms, xyxy_from_cxcywh

seeds = st.integers(0, 2**32 - 1)


def random_boxes(seed, n, side=40.0):
    random = np.random.default_rng(seed)
    lows = random.uniform(0, 60, (n, 2))
    return np.hstack([lows, lows + random.uniform(1, side, (n, 2))])


@given(seeds, st.integers(0, 8), st.integers(0, 8))
def test_overlap_agrees_with_torchvision(seed, n, m):
    a, b = random_boxes(seed, n), random_boxes(seed + 1, m)

    wanted = torchvision.ops.box_iou(torch.from_numpy(a), torch.from_numpy(b)).numpy()

    np.testing.assert_allclose(iou_matrix(a, b), wanted, atol=1e-12)


def test_boxes_without_area_overlap_nothing():
    flat, whole = np.array([[5.0, 5, 5, 9]]), np.array([[0.0, 0, 9, 9]])

    assert iou_matrix(flat, whole).tolist() == [[0]]
    assert iou_matrix(flat, flat).tolist() == [[0]]


@given(seeds, st.integers(0, 300), st.sampled_from([0.0, 0.3, 0.5, 0.9]))
def test_suppression_agrees_with_torchvision(seed, n, threshold):
    boxes = random_boxes(seed, n)
    scores = np.random.default_rng(seed).permutation(n) / max(n, 1)

    wanted = torchvision.ops.nms(torch.from_numpy(boxes), torch.from_numpy(scores), threshold).numpy()

    np.testing.assert_array_equal(nms(boxes, scores, iou_threshold=threshold, max_boxes=n), wanted)
    np.testing.assert_array_equal(nms(boxes, scores, iou_threshold=threshold, max_boxes=3), wanted[:3])


def test_equal_scores_keep_their_order():
    boxes = np.array([[0.0, 0, 10, 10], [0, 0, 10, 10], [50, 0, 60, 10]])

    assert nms(boxes, np.array([0.5, 0.5, 0.5]), iou_threshold=0.5, max_boxes=9).tolist() == [0, 2]


@given(seeds)
def test_layouts_are_inverse(seed):
    boxes = random_boxes(seed, 5)

    np.testing.assert_allclose(xyxy_from_cxcywh(cxcywh_from_xyxy(boxes)), boxes)


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        pytest.param([0, 0, 4, 5], 20, id="box"),
        pytest.param([4, 0, 0, 5], 0, id="inside-out"),
        pytest.param([0, 0, 0, 5], 0, id="flat"),
    ],
)
def test_area(box, expected):
    assert area(np.array([box], dtype=float)).tolist() == [expected]


def test_clip_cuts_at_the_edges_of_the_image_and_leaves_its_input():
    boxes = np.array([[-5.0, -5, 700, 300], [650, 10, 660, 20]])
    before = boxes.copy()

    assert clip(boxes, (640, 480)).tolist() == [[0, 0, 640, 300], [640, 10, 640, 20]]
    np.testing.assert_array_equal(boxes, before)


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
