"""The figures of a validation as tables for a terminal."""

import math
from collections.abc import Sequence

from autolights.train.measure.metrics import DetectionMetrics

_Cell = str | int | float


def metrics_as_text(metrics: DetectionMetrics) -> str:
    """Average precision, each class at the score threshold, recall by height; a dash where there is nothing to find."""
    confusion = metrics.confusion
    best_threshold, best_f1 = metrics.sweep.best
    precision, recall = metrics.per_class_precision, metrics.per_class_recall
    figures: list[_Cell] = [metrics.ap, metrics.ap50, metrics.ap75, metrics.ap_s, metrics.ap_m]
    classes: list[list[_Cell]] = [
        ["all", metrics.labels, metrics.ap, metrics.ap50, metrics.precision, metrics.recall],
    ]
    for name, counts in zip(confusion.classes, confusion.counts, strict=False):
        ap, ap50 = metrics.per_class_ap.get(name, math.nan), metrics.per_class_ap50.get(name, math.nan)
        classes.append([name, int(counts.sum()), ap, ap50, precision[name], recall[name]])
    bands: list[list[_Cell]] = [[band.name, band.labels, band.recall] for band in metrics.heights]
    left_out = f", {len(metrics.unreadable)} more do not decode" if metrics.unreadable else ""
    return "\n".join(
        [
            f"{metrics.images} images{left_out}, {metrics.labels} labels",
            *_lines(["AP", "AP50", "AP75", "AP_S", "AP_M"], [figures]),
            "",
            f"precision and recall at score {confusion.score_threshold:g}, overlap {confusion.iou_threshold:g} "
            f"(F1 is best at score {best_threshold:.2f}: {best_f1:.3f})",
            *_lines(["class", "labels", "AP", "AP50", "precision", "recall"], classes),
            "",
            *_lines(["height px", "labels", "recall"], bands),
        ]
    )


def _lines(heads: Sequence[str], rows: Sequence[Sequence[_Cell]]) -> list[str]:
    """Columns as wide as they must be: texts to the left, numbers to the right."""
    texts = [list(heads), *([_text(value) for value in row] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    names = [isinstance(value, str) for value in rows[0]]
    return [
        "  ".join(
            text.ljust(width) if is_name else text.rjust(width)
            for text, width, is_name in zip(line, widths, names, strict=True)
        )
        for line in texts
    ]


def _text(value: _Cell) -> str:
    if isinstance(value, float):
        return "-" if math.isnan(value) else f"{value:.3f}"
    return str(value)
