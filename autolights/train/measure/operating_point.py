"""How a detector does at one score threshold, as the runtime reports: precision, recall, and by height of the light."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autolights.core import FloatArray, IntArray
from autolights.core.boxes import match_boxes
from autolights.train.measure.predictions import Labels, Predictions

THRESHOLDS = np.arange(1, 20) / 20  # .05, .10, ... .95: coarse, as F1 is flat near its best
HEIGHT_EDGES_PX = (4.0, 8.0, 16.0, 32.0, math.inf)


@dataclass(frozen=True)
class HeightBand:
    """Lights of like height.

    Attributes:
        low_px: Smallest height in the original image.
        high_px: Lower than this; infinity in the last band.
        labels: How many there are.
        found: How many of them were detected with their class.
    """

    low_px: float
    high_px: float
    labels: int
    found: int

    @property
    def name(self) -> str:
        """Such as ``8-16`` and ``32+``."""
        return f"{self.low_px:g}+" if math.isinf(self.high_px) else f"{self.low_px:g}-{self.high_px:g}"

    @property
    def recall(self) -> float:
        """Share found; NaN without labels."""
        return self.found / self.labels if self.labels else math.nan


@dataclass(frozen=True, eq=False)
class ThresholdSweep:
    """Precision and recall over all classes at several score thresholds.

    Attributes:
        thresholds: (n,) rising.
        precision: (n,) share of the detections that are right; NaN where there is none.
        recall: (n,) share of the labels that were found with their class; NaN without labels.
    """

    thresholds: FloatArray
    precision: FloatArray
    recall: FloatArray

    @property
    def f1(self) -> FloatArray:
        """(n,) harmonic mean of precision and recall; 0 where either is 0 or unknown."""
        sums = self.precision + self.recall
        products = 2 * self.precision * self.recall
        return np.divide(products, sums, out=np.zeros_like(sums), where=sums > 0)

    @property
    def best(self) -> tuple[float, float]:
        """The threshold with the best F1 (of equal ones the lowest), and that F1."""
        i = int(np.argmax(self.f1))
        return float(self.thresholds[i]), float(self.f1[i])


def recall_by_height(
    labels: Sequence[Labels], reported: Sequence[Predictions], *, iou_threshold: float
) -> tuple[HeightBand, ...]:
    """Count which lights are found, from 4 to 8 px high, 8 to 16, 16 to 32, and 32 or more; lower ones are left out.

    Args:
        labels: One entry per image.
        reported: What the runtime says about each.
        iou_threshold: Overlap from which a detection counts as the label's.
    """
    heights, found = [np.empty(0)], [np.empty(0, dtype=bool)]
    for truth, seen in zip(labels, reported, strict=True):
        heights.append(truth.boxes_xyxy[:, 3] - truth.boxes_xyxy[:, 1])
        found.append(np.isin(np.arange(len(truth.class_ids)), _found(truth, seen, iou_threshold)))
    bands = np.digitize(np.concatenate(heights), HEIGHT_EDGES_PX)
    all_counts = np.bincount(bands, minlength=5)
    found_counts = np.bincount(bands[np.concatenate(found)], minlength=5)
    return tuple(
        HeightBand(HEIGHT_EDGES_PX[i - 1], HEIGHT_EDGES_PX[i], int(all_counts[i]), int(found_counts[i]))
        for i in range(1, 5)
    )


def sweep_thresholds(
    labels: Sequence[Labels], reported: Sequence[Predictions], *, iou_threshold: float
) -> ThresholdSweep:
    """Precision and recall if the runtime's score threshold were another one.

    Args:
        labels: One entry per image.
        reported: What the runtime says about each at the lowest of `THRESHOLDS`.
        iou_threshold: Overlap from which a detection counts as the label's.
    """
    right, said = np.zeros(len(THRESHOLDS)), np.zeros(len(THRESHOLDS))
    for truth, seen in zip(labels, reported, strict=True):
        for i, threshold in enumerate(THRESHOLDS):
            confident = seen.above(threshold)
            if not len(confident.scores):
                break
            said[i] += len(confident.scores)
            right[i] += len(_found(truth, confident, iou_threshold))
    label_count = sum(len(truth.class_ids) for truth in labels)
    return ThresholdSweep(
        THRESHOLDS,
        np.divide(right, said, out=np.full_like(right, np.nan), where=said > 0),
        right / label_count if label_count else np.full_like(right, np.nan),
    )


def _found(truth: Labels, seen: Predictions, iou_threshold: float) -> IntArray:
    """Rows of the labels that were detected with their class."""
    labels, detections = match_boxes(truth.boxes_xyxy, seen.boxes_xyxy, iou_threshold=iou_threshold)
    return np.asarray(labels[truth.class_ids[labels] == seen.class_ids[detections]])
