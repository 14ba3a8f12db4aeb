"""Counting which class was shown and which one was seen."""

import numpy as np

from autolights.core import FloatArray, IntArray
from autolights.core.boxes import match_boxes


def count_confusions(
    truth_boxes_xyxy: FloatArray,
    truth_ids: IntArray,
    boxes_xyxy: FloatArray,
    class_ids: IntArray,
    *,
    class_count: int,
    iou_threshold: float,
) -> IntArray:
    """Compare the detections of one image with its labels.

    Args:
        truth_boxes_xyxy: (n, 4) pixels.
        truth_ids: (n,) class indices.
        boxes_xyxy: (m, 4) pixels of the detections that the runtime would report.
        class_ids: (m,) class indices.
        class_count: C.
        iou_threshold: Overlap from which a detection counts as the label's.

    Returns:
        (C + 1, C + 1) counts `[truth, predicted]`; a label without a detection counts in the last column, a detection
        without a label in the last row. Sum over images for a `ConfusionMatrix`.
    """
    truths, detections = match_boxes(truth_boxes_xyxy, boxes_xyxy, iou_threshold=iou_threshold)
    missed, invented = np.delete(truth_ids, truths), np.delete(class_ids, detections)
    shown = np.concatenate([truth_ids[truths], missed, np.full(len(invented), class_count)])
    seen = np.concatenate([class_ids[detections], np.full(len(missed), class_count), invented])
    counts = np.zeros((class_count + 1, class_count + 1), dtype=np.int64)
    np.add.at(counts, (shown, seen), 1)
    return counts
