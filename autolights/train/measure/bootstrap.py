"""Is one detector better than another? The difference of their average precision, with an interval over photos."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autolights.core import BoolArray, FloatArray, IntArray
from autolights.core.boxes import iou_matrix
from autolights.train.measure.average_precision import MAX_DETECTIONS, RECALLS
from autolights.train.measure.predictions import Labels, Predictions

_OVERLAPS = np.linspace(0.5, 0.95, 10)
_CHUNK = 1 << 23  # weights of detections in memory at a time


@dataclass(frozen=True)
class Difference:
    """A figure of two detectors on the same photos.

    Attributes:
        a: Of the first, the mean over its runs.
        b: Of the second.
        low: Lower end of the difference's interval.
        high: Its upper end.
    """

    a: float
    b: float
    low: float
    high: float

    @property
    def difference(self) -> float:
        """How much better the first one is."""
        return self.a - self.b


def compare_detectors(
    labels: Sequence[Labels],
    photos: Sequence[str],
    a: Sequence[Sequence[Predictions]],
    b: Sequence[Sequence[Predictions]],
    *,
    class_count: int,
    resamples: int = 2000,
    confidence: float = 0.95,
    seed: int = 0,
) -> tuple[Difference, Difference]:
    """Compare two detectors by drawing the photos again, with replacement.

    Both are measured on the same draws, so that what makes a photo hard for both does not widen the interval. It is the
    interval over photos: that training again gives another detector is only in it as far as the means over runs are.

    Args:
        labels: One entry per image.
        photos: For each image the photo that it comes from; images of one photo are drawn together.
        a: For each run of the first detector its predictions, one entry per image.
        b: As `a`, of the second.
        class_count: C.
        resamples: How often the photos are drawn.
        confidence: Of the percentile interval.
        seed: Of the draws.

    Returns:
        The differences of AP50 and of AP.

    References:
        Efron and Tibshirani 1993, "An Introduction to the Bootstrap", Sec. 13.3.
    """
    groups = np.unique(photos, return_inverse=True)[1]
    group_count = int(groups.max()) + 1
    random = np.random.default_rng(seed)
    draws = random.multinomial(group_count, np.full(group_count, 1 / group_count), size=resamples)
    weights = np.concatenate([np.ones((1, group_count)), draws]).astype(np.float32)  # all photos once, then the draws
    sides = []
    for runs in (a, b):
        by_run = [_average_precisions(_match(labels, run, groups, class_count), weights) for run in runs]
        sides.append(np.mean(by_run, axis=0))
    tails = (1 - confidence) / 2
    result = []
    for figure_a, figure_b in ((sides[0][:, 0], sides[1][:, 0]), (sides[0].mean(axis=1), sides[1].mean(axis=1))):
        # A draw without any label has no figure.
        low, high = np.nanquantile((figure_a - figure_b)[1:], [tails, 1 - tails])
        result.append(Difference(float(figure_a[0]), float(figure_b[0]), float(low), float(high)))
    return result[0], result[1]


@dataclass(frozen=True, eq=False)
class _ClassMatches:
    """The n detections of one class in all images, best first.

    Attributes:
        groups: (n,) photo of each.
        correct: (n, 10) whether it is a label's, by overlap.
        label_counts: (G,) labels of the class in each photo.
    """

    groups: IntArray
    correct: BoolArray
    label_counts: FloatArray


def _match(
    labels: Sequence[Labels], predictions: Sequence[Predictions], groups: IntArray, class_count: int
) -> list[_ClassMatches]:
    """Match once what all draws share: within an image nothing depends on the other images."""
    group_count = int(groups.max()) + 1
    matches = []
    for class_id in range(class_count):
        scores: list[FloatArray] = [np.empty(0)]
        owners: list[IntArray] = [np.empty(0, dtype=np.int64)]
        correct: list[BoolArray] = [np.empty((0, len(_OVERLAPS)), dtype=bool)]
        label_counts = np.zeros(group_count)
        for truth, seen, group in zip(labels, predictions, groups, strict=True):
            wanted = truth.boxes_xyxy[truth.class_ids == class_id]
            label_counts[group] += len(wanted)
            of_class = np.flatnonzero(seen.class_ids == class_id)
            best = of_class[np.argsort(-seen.scores[of_class], kind="stable")][:MAX_DETECTIONS]
            scores.append(seen.scores[best])
            owners.append(np.full(len(best), group))
            correct.append(_match_image(wanted, seen.boxes_xyxy[best]))
        order = np.argsort(-np.concatenate(scores), kind="stable")
        matches.append(_ClassMatches(np.concatenate(owners)[order], np.concatenate(correct)[order], label_counts))
    return matches


def _match_image(wanted_xyxy: FloatArray, boxes_xyxy: FloatArray) -> BoolArray:
    """(n, 10) whether each box, the best first, takes a label that none before it took: the one it overlaps most."""
    correct = np.zeros((len(boxes_xyxy), len(_OVERLAPS)), dtype=bool)
    overlaps = iou_matrix(boxes_xyxy, wanted_xyxy)
    free = np.ones((len(_OVERLAPS), len(wanted_xyxy)), dtype=bool)
    for i in np.flatnonzero(overlaps.max(axis=1, initial=0.0) >= _OVERLAPS[0]):
        candidates = np.where(free & (overlaps[i] >= _OVERLAPS[:, None]), overlaps[i], -1.0)
        taken = candidates.argmax(axis=1)
        correct[i] = candidates.max(axis=1) >= 0
        free[correct[i], taken[correct[i]]] = False
    return correct


def _average_precisions(matches: Sequence[_ClassMatches], weights: FloatArray) -> FloatArray:
    """Average precision if each photo counted `weights` times.

    Args:
        matches: By class.
        weights: (B, G) whole numbers.

    Returns:
        (B, 10) by overlap, means over the classes that have labels; NaN where none has.
    """
    sums, classes = np.zeros((len(weights), len(_OVERLAPS))), np.zeros((len(weights), 1))
    for of_class in matches:
        label_counts = weights @ of_class.label_counts
        known = label_counts > 0
        found = np.flatnonzero(of_class.correct.any(axis=1))
        last = found[-1] + 1 if len(found) else 0  # what comes later changes no precision that is read
        rows = max(_CHUNK // max(last, 1), 1)
        for start in range(0, len(weights), rows):
            part = slice(start, start + rows)
            drawn = weights[part][:, of_class.groups[:last]]
            said = drawn.cumsum(axis=1)
            for k in range(len(_OVERLAPS)):
                hits = np.flatnonzero(of_class.correct[:last, k])
                right = drawn[:, hits].cumsum(axis=1)
                sums[part, k] += _interpolated(right, said[:, hits], label_counts[part]) * known[part]
        classes[known] += 1
    return np.divide(sums, classes, out=np.full_like(sums, np.nan), where=classes > 0)


def _interpolated(right: FloatArray, said: FloatArray, label_counts: FloatArray) -> FloatArray:
    """COCO's mean of precision at 101 recalls.

    Args:
        right: (B, n) correct detections up to each correct one.
        said: (B, n) detections up to it.
        label_counts: (B,)
    """
    right = right.astype(np.float64)
    precision = np.divide(right, said, out=np.zeros_like(right), where=said > 0)
    envelope = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
    recall = right / np.maximum(label_counts, 1)[:, None]
    # Each recall of the 101 is read at the first detection that reaches it.
    reached = np.searchsorted(RECALLS, recall, side="right")
    read_here = np.diff(reached, axis=1, prepend=0)
    return np.asarray((envelope * read_here).sum(axis=1) / len(RECALLS))
