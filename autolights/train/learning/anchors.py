"""Do the anchors reach the labels, and which would do so better."""

import warnings
from collections.abc import Sequence

import numpy as np
import torch
from scipy.cluster.vq import kmeans2

from autolights.core import FloatArray
from autolights.train.learning.assign import MAX_SIDE_RATIO
from autolights.train.network.model import YoloV5

ENOUGH_RECALL = 0.98  # YOLOv5 keeps its anchors from there on
ANCHORS_PER_LEVEL = 3
_MAX_LABELS = 5000  # more do not move the estimate
_FIRST_STEP, _LAST_STEP = 0.2, 0.01  # of the refinement, as a share of a side


def anchor_recall(sides_px: FloatArray, anchors_px: FloatArray, ratio: float = MAX_SIDE_RATIO) -> float:
    """Share of labels that at least one anchor can answer for: the best possible recall.

    Args:
        sides_px: (n, 2) widths and heights of labels, as the network sees them.
        anchors_px: (..., 2) widths and heights of anchors.
        ratio: Neither side may differ by this factor or more.

    Returns:
        0 to 1; 1 without labels.
    """
    if not len(sides_px):
        return 1.0
    return float((_closeness(sides_px, anchors_px.reshape(-1, 2)).max(axis=1) > 1 / ratio).mean())


def estimate_anchors(sides_px: FloatArray, strides: Sequence[int], seed: int) -> FloatArray:
    """Find the anchors that come nearest to the labels.

    Clusters the logarithms of the sides, where equal distances are equal ratios, then moves one side of one anchor at a
    time for as long as the mean closeness of each label to its nearest anchor rises.

    Args:
        sides_px: (n, 2) widths and heights of labels, as the network sees them; at least as many different ones as
            anchors.
        strides: Of the levels, in any order.
        seed: Of the clusters' start.

    Returns:
        (levels, 3, 2) pixels; the finer a level the smaller its anchors.

    Raises:
        ValueError: If there are too few different sides.
    """
    count = ANCHORS_PER_LEVEL * len(strides)
    rng = np.random.default_rng(seed)
    if len(sides_px) > _MAX_LABELS:
        sides_px = rng.choice(sides_px, _MAX_LABELS, replace=False)
    different = len(np.unique(sides_px, axis=0))
    if different < count:
        raise ValueError(f"{count} anchors need at least {count} different label sizes, got {different}")
    with warnings.catch_warnings():
        # Such a cluster keeps its last centre, and the refinement moves it.
        warnings.filterwarnings("ignore", "One of the clusters is empty", UserWarning)
        centres, _ = kmeans2(np.log(sides_px), count, minit="++", seed=rng)
    anchors = _refine(sides_px, np.exp(centres))
    by_area = anchors[np.argsort(anchors.prod(axis=1))].reshape(len(strides), ANCHORS_PER_LEVEL, 2)
    rank_of_level = np.argsort(np.argsort(strides))
    return np.asarray(by_area[rank_of_level])


def fit_anchors(model: YoloV5, sides_px: FloatArray, *, seed: int = 0) -> str:
    """Re-estimate a network's anchors if they can reach too few of the labels.

    Args:
        model: Its anchors are changed in place, if others reach more.
        sides_px: (n, 2) widths and heights of labels, as the network sees them.
        seed: Of the estimate.

    Returns:
        What was found and done, in words.
    """
    anchors_px = model.anchors_px.cpu().double().numpy()
    recall = anchor_recall(sides_px, anchors_px)
    found = f"anchors can reach {recall:.1%} of {len(sides_px)} labels"
    if recall >= ENOUGH_RECALL:
        return f"{found}; kept"
    try:
        estimate = estimate_anchors(sides_px, model.strides, seed)
    except ValueError as error:
        return f"{found}; kept, as {error}"
    estimated_recall = anchor_recall(sides_px, estimate)
    if estimated_recall <= recall:
        return f"{found}; kept, as re-estimated ones reach {estimated_recall:.1%}"
    model.set_anchors(torch.from_numpy(estimate))
    return f"{found}; re-estimated: {estimated_recall:.1%}"


def _closeness(sides_px: FloatArray, anchors_px: FloatArray) -> FloatArray:
    """(n, k) the worse side's ratio, smaller to larger: 1 for equal sides, towards 0 for very different ones."""
    ratios = sides_px[:, None, :] / anchors_px[None, :, :]
    return np.asarray(np.minimum(ratios, 1 / ratios).min(axis=2))


def _fitness(closeness: FloatArray) -> float:
    """Mean closeness of the labels to their nearest anchor; one that no anchor reaches counts nothing."""
    best = closeness.max(axis=1)
    return float(np.where(best > 1 / MAX_SIDE_RATIO, best, 0).mean())


def _refine(sides_px: FloatArray, anchors_px: FloatArray) -> FloatArray:
    """Climb to the nearest maximum of the fitness, one side of one anchor at a time."""
    anchors_px = anchors_px.copy()
    closeness = _closeness(sides_px, anchors_px)
    best = _fitness(closeness)
    step = _FIRST_STEP
    while step >= _LAST_STEP:
        improved = False
        for anchor, side in np.ndindex(anchors_px.shape):
            for factor in (1 + step, 1 / (1 + step)):
                moved = anchors_px[anchor].copy()
                moved[side] *= factor
                tried = closeness.copy()
                tried[:, anchor] = _closeness(sides_px, moved[None])[:, 0]
                fitness = _fitness(tried)
                if fitness > best:
                    best, closeness, anchors_px[anchor], improved = fitness, tried, moved, True
        if not improved:
            step /= 2
    return anchors_px
