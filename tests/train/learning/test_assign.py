import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from autolights.train.learning.assign import assign

ANCHORS = torch.tensor([[[2.0, 4.0], [1.0, 1.0], [8.0, 8.0]]])  # one level, in cells


def cells_of(labels, size_wh=(10, 10)):
    (level,) = assign(torch.tensor(labels).reshape(-1, 6), ANCHORS, [size_wh])
    return sorted(zip(level.anchors.tolist(), level.columns.tolist(), level.rows.tolist(), strict=True))


def label(cx, cy, width=2.0, height=4.0, size_wh=(10, 10)):
    """A label of image 0 and class 1, in cells."""
    return [0, 1, cx / size_wh[0], cy / size_wh[1], width / size_wh[0], height / size_wh[1]]


@pytest.mark.parametrize(
    ("cx", "cy", "cells"),
    [
        pytest.param(2.25, 5.75, {(2, 5), (1, 5), (2, 6)}, id="left-and-lower-neighbours"),
        pytest.param(2.75, 5.25, {(2, 5), (3, 5), (2, 4)}, id="right-and-upper-neighbours"),
        pytest.param(0.25, 0.25, {(0, 0)}, id="corner-has-no-neighbours"),
        pytest.param(9.75, 9.75, {(9, 9)}, id="far-corner-has-none-either"),
        pytest.param(10.0, 5.75, {(9, 5), (9, 6)}, id="on-the-far-edge"),
        pytest.param(2.5, 5.5, {(2, 5)}, id="middle-of-a-cell"),
    ],
)
def test_cells_by_hand(cx, cy, cells):
    found = {(x, y) for anchor, x, y in cells_of([label(cx, cy)]) if anchor == 0}

    assert found == cells


def test_anchors_within_a_factor_of_four_answer():
    assert {anchor for anchor, _, _ in cells_of([label(5.5, 5.5)])} == {0}  # 1 × 1 is 4 times too low: not below 4
    assert {anchor for anchor, _, _ in cells_of([label(5.5, 5.5, 2.1, 3.9)])} == {0, 1, 2}


def test_levels_do_not_mix():
    anchors = torch.cat([ANCHORS, ANCHORS / 2])
    labels = torch.tensor([label(2.25, 5.75), label(7.75, 3.25, 0.6, 0.7)])
    grids = [(10, 10), (5, 5)]

    together = assign(labels, anchors, grids)

    for level in range(2):
        (alone,) = assign(labels, anchors[level : level + 1], grids[level : level + 1])
        assert len(alone) > 0
        for name, values in vars(alone).items():
            torch.testing.assert_close(getattr(together[level], name), values)


def test_no_labels_no_positives():
    levels = assign(torch.zeros(0, 6), ANCHORS.expand(3, 3, 2), [(8, 8), (4, 4), (2, 2)])

    assert [len(level) for level in levels] == [0, 0, 0]
    assert levels[0].boxes.shape == (0, 4)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 1),
            st.integers(0, 2),
            *[st.integers(0, 64).map(lambda i: i / 64)] * 2,
            *[st.integers(1, 64).map(lambda i: i / 64)] * 2,
        ),
        max_size=5,
    )
)
def test_agrees_with_plain_loops(rows):
    width, height = 6, 4
    expected = []
    for image, class_id, cx, cy, w, h in rows:
        x, y, w, h = cx * width, cy * height, w * width, h * height
        for a, (anchor_w, anchor_h) in enumerate(ANCHORS[0].tolist()):
            if max(w / anchor_w, anchor_w / w, h / anchor_h, anchor_h / h) >= 4:
                continue
            shifts = [(0.0, 0.0)]
            shifts += [(-0.5, 0.0)] if x % 1 < 0.5 and x > 1 else []
            shifts += [(0.0, -0.5)] if y % 1 < 0.5 and y > 1 else []
            shifts += [(0.5, 0.0)] if (width - x) % 1 < 0.5 and width - x > 1 else []
            shifts += [(0.0, 0.5)] if (height - y) % 1 < 0.5 and height - y > 1 else []
            for dx, dy in shifts:
                column = min(max(math.floor(x + dx), 0), width - 1)
                row = min(max(math.floor(y + dy), 0), height - 1)
                expected.append((image, a, row, column, x - column, y - row, w, h, class_id))

    (level,) = assign(torch.tensor(rows, dtype=torch.float32).reshape(-1, 6), ANCHORS, [(width, height)])

    columns = (level.images, level.anchors, level.rows, level.columns, *level.boxes.T, level.class_ids)
    found = list(zip(*(column.tolist() for column in columns), strict=True))
    np.testing.assert_allclose(np.reshape(sorted(found), (-1, 9)), np.reshape(sorted(expected), (-1, 9)))
