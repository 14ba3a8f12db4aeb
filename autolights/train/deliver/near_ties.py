"""Lights that one of two lists lacks only because rounding decided what suppresses what."""

from typing import NamedTuple

import numpy as np

from autolights.core import BoolArray, FloatArray, IntArray
from autolights.core.boxes import iou_matrix


class Near(NamedTuple):
    """What rounding can decide.

    Attributes:
        iou_threshold: Of the suppression.
        iou: Overlaps this close to the threshold suppress or do not.
        score: Scores this close to each other come in either order.
    """

    iou_threshold: float
    iou: float
    score: float


def decided_by_rounding(
    boxes_xyxy: tuple[FloatArray, FloatArray],
    scores: tuple[FloatArray, FloatArray],
    single: tuple[IntArray, IntArray],
    near: Near,
) -> tuple[BoolArray, BoolArray]:
    """Which lights of one list alone are explained by a near tie in greedy suppression.

    A light is, if the other list holds one that may have suppressed it: one that overlaps it by about the threshold;
    or one of about its score, so that either could go first; or any one that is in that list alone and explained.

    Args:
        boxes_xyxy: (n, 4) and (m, 4) pixels, what greedy suppression has left of nearly the same rows.
        scores: (n,) and (m,).
        single: Of each list the indices of those that the other lacks.
        near: What counts as a tie.

    Returns:
        For each index in `single` whether it is explained.
    """
    overlaps = iou_matrix(*boxes_xyxy)
    lead = scores[1][None] - scores[0][:, None]  # of the second list's
    may_suppress: list[BoolArray] = []
    explained: list[BoolArray] = []
    for side, (overlap, ahead) in enumerate(((overlaps, lead), (overlaps.T, -lead.T))):
        overlap, ahead = overlap[single[side]], ahead[single[side]]
        may = (overlap > near.iou_threshold - near.iou) & (ahead > -near.score)
        tie = (overlap < near.iou_threshold + near.iou) | (ahead < near.score)
        may_suppress.append(may)
        explained.append(np.asarray((may & tie).any(axis=1)))
    for _ in range(len(single[0]) + len(single[1])):  # each round explains one more, or no further one does
        for side in (0, 1):
            others = single[1 - side][explained[1 - side]]
            explained[side] = explained[side] | may_suppress[side][:, others].any(axis=1)
    return explained[0], explained[1]
