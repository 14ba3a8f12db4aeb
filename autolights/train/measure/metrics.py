"""All figures of one validation, and the file that holds them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from autolights.core import ConfusionMatrix, FloatArray
from autolights.core.json_files import write_json
from autolights.train.measure.average_precision import AveragePrecision
from autolights.train.measure.operating_point import HeightBand, ThresholdSweep


@dataclass(frozen=True, eq=False)
class DetectionMetrics(AveragePrecision):
    """Average precision, and how the runtime does at its score threshold.

    Attributes:
        images: How many were looked at.
        labels: How many boxes they hold.
        confusion: Counted the way the runtime detects; it says at which score and overlap. Precision and recall are
            read from it.
        heights: Which lights were found at that threshold, by their height.
        sweep: Precision and recall at other thresholds.
        unreadable: Names of image files that do not decode and were left out.
    """

    images: int
    labels: int
    confusion: ConfusionMatrix
    heights: tuple[HeightBand, ...]
    sweep: ThresholdSweep
    unreadable: tuple[str, ...] = ()

    @property
    def precision(self) -> float:
        """Share of all detections whose light is there and of the class they say; NaN without a detection."""
        return _share(np.trace(self._right), self.confusion.counts[:, :-1].sum())

    @property
    def recall(self) -> float:
        """Share of all labels that were detected with their class; NaN without labels."""
        return _share(np.trace(self._right), self.confusion.counts[:-1].sum())

    @property
    def per_class_precision(self) -> dict[str, float]:
        """As `precision`, by class name; every class is there."""
        return self._per_class(self.confusion.counts[:, :-1].sum(axis=0))

    @property
    def per_class_recall(self) -> dict[str, float]:
        """As `recall`, by class name; every class is there."""
        return self._per_class(self.confusion.counts[:-1].sum(axis=1))

    def to_json(self) -> dict[str, Any]:
        """The figures as JSON-ready values, rounded to 5 digits; NaN becomes null.

        Curves and the confusion matrix stay out: checkpoints and bundles carry these figures.
        """
        best_threshold, best_f1 = self.sweep.best
        return {
            **{name: _rounded(getattr(self, name)) for name in ("ap", "ap50", "ap75", "ap_s", "ap_m")},
            "per_class": _all_rounded(self.per_class_ap),
            "per_class_ap50": _all_rounded(self.per_class_ap50),
            "images": self.images,
            "labels": self.labels,
            "score_threshold": self.confusion.score_threshold,
            "iou_threshold": self.confusion.iou_threshold,
            "precision": _rounded(self.precision),
            "recall": _rounded(self.recall),
            "per_class_precision": _all_rounded(self.per_class_precision),
            "per_class_recall": _all_rounded(self.per_class_recall),
            "recall_by_height_px": {
                band.name: {"labels": band.labels, "recall": _rounded(band.recall)} for band in self.heights
            },
            "best_threshold": best_threshold,
            "best_f1": _rounded(best_f1),
            "unreadable": list(self.unreadable),
        }

    def save(self, path: Path) -> None:
        """Write ``metrics.json``."""
        write_json(path, self.to_json())

    @property
    def _right(self) -> FloatArray:
        return self.confusion.counts[:-1, :-1].astype(np.float64)

    def _per_class(self, totals: Sequence[int]) -> dict[str, float]:
        rights = np.diagonal(self._right)
        return {
            name: _share(right, total)
            for name, right, total in zip(self.confusion.classes, rights, totals, strict=True)
        }


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole else math.nan


def _rounded(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 5)


def _all_rounded(values: dict[str, float]) -> dict[str, float | None]:
    return {name: _rounded(value) for name, value in values.items()}
