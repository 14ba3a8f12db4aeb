"""COCO's average precision, as in the paper's Table II."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from faster_coco_eval import COCO, COCOeval_faster

from autolights.core import FloatArray
from autolights.core.boxes import area
from autolights.train.measure.predictions import Labels, Predictions

MAX_DETECTIONS = 100  # best per image and class that COCO counts
RECALLS = np.linspace(0, 1, 101)  # at which COCO reads precision
_AREAS = ("all", "small", "medium")  # px² of the original image: any, below 32², 32² to 96²
_AREA_RANGES = ((0.0, 1e10), (0.0, 32.0**2), (32.0**2, 96.0**2))


@dataclass(frozen=True, eq=False)
class AveragePrecision:
    """Areas under precision-recall curves, in [0, 1]; NaN where there is no truth to find.

    Attributes:
        ap: Mean over IoU .50 to .95 in steps of .05, then over the classes that have truth.
        ap50: At IoU .50.
        ap75: At IoU .75.
        ap_s: Of boxes below 32² px.
        ap_m: Of boxes from 32² to 96² px.
        per_class_ap: As `ap`, by class name; classes without truth are left out.
        curves: Precision at `RECALLS` at IoU .50, (101,) by class name; the same classes.
    """

    ap: float
    ap50: float
    ap75: float
    ap_s: float
    ap_m: float
    per_class_ap: dict[str, float]
    curves: dict[str, FloatArray]

    @property
    def per_class_ap50(self) -> dict[str, float]:
        """As `ap50`, by class name."""
        return {name: float(precision.mean()) for name, precision in self.curves.items()}


def average_precision(
    labels: Sequence[Labels], predictions: Sequence[Predictions], classes: Sequence[str]
) -> AveragePrecision:
    """Score predictions against labels as COCO does.

    Args:
        labels: One entry per image.
        predictions: One entry per image, in the same order; at most 100 per image and class count.
        classes: Names by class index.

    Returns:
        Averages; a class without truth (in a size range) does not take part (in that range).

    Raises:
        ValueError: If there are not as many predictions as labels.

    References:
        Lin et al. 2014, "Microsoft COCO"; the digits are those of pycocotools.
    """
    if len(labels) != len(predictions):
        raise ValueError(f"predictions must cover the {len(labels)} labelled images, got {len(predictions)}")
    if not any(len(image.boxes_xyxy) for image in labels):
        return AveragePrecision(math.nan, math.nan, math.nan, math.nan, math.nan, {}, {})
    truth = COCO(_coco_truth(labels, classes))
    evaluation = COCOeval_faster(truth, truth.loadRes(_coco_results(predictions)), iouType="bbox")
    evaluation.params.maxDets = [MAX_DETECTIONS]
    evaluation.params.areaRng = [list(bounds) for bounds in _AREA_RANGES]
    evaluation.params.areaRngLbl = list(_AREAS)
    evaluation.evaluate()
    evaluation.accumulate()
    # (IoU thresholds, recalls, classes, areas, maxDets); -1 where there is no truth
    precision = np.asarray(evaluation.eval["precision"])[..., 0]
    known = [(i, name) for i, name in enumerate(classes) if (precision[:, :, i, 0] > -1).any()]
    return AveragePrecision(
        ap=_mean(precision[..., 0]),
        ap50=_mean(precision[0, ..., 0]),
        ap75=_mean(precision[5, ..., 0]),
        ap_s=_mean(precision[..., 1]),
        ap_m=_mean(precision[..., 2]),
        per_class_ap={name: _mean(precision[:, :, i, 0]) for i, name in known},
        curves={name: precision[0, :, i, 0] for i, name in known},
    )


def _coco_truth(labels: Sequence[Labels], classes: Sequence[str]) -> dict[str, Any]:
    """COCO's annotation format; image and category ids are one more than the indices."""
    annotations: list[dict[str, Any]] = []
    for image_id, image in enumerate(labels, start=1):
        rows = zip(image.boxes_xyxy.tolist(), image.class_ids.tolist(), area(image.boxes_xyxy).tolist(), strict=True)
        for (left, top, right, bottom), class_id, area_px in rows:
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": image_id,
                    "category_id": class_id + 1,
                    "bbox": [left, top, right - left, bottom - top],
                    "area": area_px,
                    "iscrowd": 0,
                }
            )
    return {
        "images": [{"id": i} for i in range(1, len(labels) + 1)],
        "categories": [{"id": i, "name": name} for i, name in enumerate(classes, start=1)],
        "annotations": annotations,
    }


def _coco_results(predictions: Sequence[Predictions]) -> FloatArray:
    """(n, 7) rows of image id, left, top, width, height, score, category id."""
    columns = [np.empty((0, 7))]
    for image_id, image in enumerate(predictions, start=1):
        boxes = image.boxes_xyxy
        ids = np.full((len(boxes), 1), image_id)
        scores, categories = image.scores[:, None], image.class_ids[:, None] + 1
        columns.append(np.concatenate([ids, boxes[:, :2], boxes[:, 2:] - boxes[:, :2], scores, categories], axis=1))
    return np.concatenate(columns, dtype=np.float64)


def _mean(precision: FloatArray) -> float:
    counted = precision[precision > -1]
    return float(counted.mean()) if counted.size else math.nan
