"""A validation as a figure: precision against recall, both against the score threshold, and recall by height."""

import io
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from autolights.core import ImageArray
from autolights.core.atomic import new_file
from autolights.train.measure.average_precision import RECALLS
from autolights.train.measure.metrics import DetectionMetrics

_INK, _MUTED, _GRID, _ACCENT = "#1a1f26", "#69707a", "#dfe3e8", "#3b6fe0"
_PRECISION, _RECALL = "#e0683b", "#7c5cd6"
_STYLE: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": _GRID,
    "axes.grid": True,
    "axes.labelcolor": _MUTED,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": _INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "figure.dpi": 130,
    "font.size": 9,
    "grid.color": _GRID,
    "grid.linewidth": 0.6,
    "legend.facecolor": "white",
    "legend.edgecolor": "none",
    "legend.labelcolor": _INK,
    "lines.linewidth": 1.4,
    "text.color": _INK,
    "xtick.color": _MUTED,
    "ytick.color": _MUTED,
}
_NAMED_CLASSES = 20  # more would not fit; those with the lowest AP50 are drawn and named


def save_curves(metrics: DetectionMetrics, path: Path) -> None:
    """Write the figure, e.g. ``pr_curves.png``; see `draw_curves`."""
    with mpl.rc_context(_STYLE), new_file(path) as temporary:
        _figure(metrics).savefig(temporary, format="png")


def draw_curves(metrics: DetectionMetrics) -> ImageArray:
    """The figure as an RGB picture; without labels its panels stay empty."""
    with mpl.rc_context(_STYLE):
        png = io.BytesIO()
        _figure(metrics).savefig(png, format="png")
    picture_bgr = cv2.imdecode(np.frombuffer(png.getvalue(), dtype=np.uint8), cv2.IMREAD_COLOR)
    assert picture_bgr is not None  # matplotlib wrote it
    return np.asarray(picture_bgr[..., ::-1], dtype=np.uint8)


def _figure(metrics: DetectionMetrics) -> Figure:
    figure = Figure(figsize=(13, 3.9), layout="constrained")
    by_recall, by_threshold, by_height = figure.subplots(1, 3, width_ratios=[1.6, 1, 0.9])
    _draw_precision_recall(by_recall, metrics)
    _draw_thresholds(by_threshold, metrics)
    _draw_heights(by_height, metrics)
    return figure


def _draw_precision_recall(axes: Axes, metrics: DetectionMetrics) -> None:
    ap50 = metrics.per_class_ap50
    worst_first = sorted(ap50, key=lambda name: ap50[name])
    palette = mpl.colormaps["tab20"]
    for name in reversed(worst_first[:_NAMED_CLASSES]):
        color = palette(list(ap50).index(name) % palette.N)
        axes.plot(RECALLS, metrics.curves[name], color=color, label=f"{name} {ap50[name]:.3f}")
    if ap50:
        mean = np.mean(list(metrics.curves.values()), axis=0)
        axes.plot(RECALLS, mean, color=_INK, linewidth=2.6, label=f"all {metrics.ap50:.3f}")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, title="AP50", reverse=True)
    axes.set(title="Precision and recall at overlap 0.5", xlabel="recall", ylabel="precision")
    axes.set(xlim=(0, 1.005), ylim=(0, 1.01))


def _draw_thresholds(axes: Axes, metrics: DetectionMetrics) -> None:
    sweep, confusion = metrics.sweep, metrics.confusion
    axes.plot(sweep.thresholds, sweep.precision, color=_PRECISION, label="precision")
    axes.plot(sweep.thresholds, sweep.recall, color=_RECALL, label="recall")
    axes.plot(sweep.thresholds, sweep.f1, color=_INK, linewidth=2.2, label="F1")
    best_threshold, best_f1 = sweep.best
    axes.plot(best_threshold, best_f1, "o", color=_INK, label=f"best {best_f1:.3f} at {best_threshold:.2f}")
    axes.axvline(confusion.score_threshold, color=_MUTED, linewidth=1, linestyle="--")
    axes.set(title=f"What the runtime reports (dashed: score {confusion.score_threshold:g})")
    axes.set(xlabel="score threshold", xlim=(0, 1), ylim=(0, 1.01))
    axes.legend(loc="lower left", fontsize=8)


def _draw_heights(axes: Axes, metrics: DetectionMetrics) -> None:
    bands = metrics.heights
    recalls = [band.recall if band.labels else 0.0 for band in bands]
    axes.bar(range(len(bands)), recalls, color=_ACCENT, width=0.62)
    for x, (band, recall) in enumerate(zip(bands, recalls, strict=True)):
        text = f"{recall:.2f}" if band.labels else "no label"
        axes.text(x, recall + 0.02, text, ha="center", color=_INK if band.labels else _MUTED)
    names = [f"{band.name}\nof {band.labels}" for band in bands]
    axes.set_xticks(range(len(bands)), names)
    axes.set(title=f"Recall at score {metrics.confusion.score_threshold:g}", xlabel="height of the light, px")
    axes.set(ylim=(0, 1.08))
    axes.grid(visible=False, axis="x")
    axes.tick_params(axis="x", length=0)
