"""Figures as SVG that follows the page's light and dark mode."""

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from autolights.core import ConfusionMatrix, FloatArray, HmmParameters, SignalSet
from autolights.evaluate.palette import ACCENT, GRID, INK, MUTED, SERIES, STYLE_VARIABLES

_STYLE: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": GRID,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.labelcolor": MUTED,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "figure.facecolor": "none",
    "font.size": 9,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "legend.edgecolor": "none",
    "legend.facecolor": "none",
    "legend.labelcolor": INK,
    "lines.linewidth": 1.8,
    "svg.fonttype": "none",  # real text: small, sharp, and in the page's own font
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
}


@contextmanager
def new_figure(width_in: float, height_in: float, name: str) -> Iterator[Figure]:
    """A figure in the report's style, drawn without a screen; `name` makes its ids unique in the page."""
    with mpl.rc_context(_STYLE | {"svg.hashsalt": name}):
        yield Figure(figsize=(width_in, height_in), layout="constrained")


def to_svg(figure: Figure, *, title: str) -> Markup:
    """The figure as an inline SVG element; `title` is what a screen reader says."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    # Names such as axes_1 would repeat from figure to figure; nothing refers to them.
    svg = re.sub(r' id="(?:figure|axes|patch|text|line2d|matplotlib\.axis|xtick|ytick|legend)_?\d*"', "", svg)
    svg = re.sub(r'^<svg [^>]*?viewBox="([^"]*)"[^>]*>', rf'<svg viewBox="\1" role="img"><title>{title}</title>', svg)
    for color, variable in STYLE_VARIABLES.items():
        svg = svg.replace(color, variable)
    return Markup(svg)  # noqa: S704  (our own drawing; texts in it were escaped by matplotlib)


def heat_map(
    axes: Axes,
    values: FloatArray,
    texts: Sequence[Sequence[str]],
    rows: Sequence[str],
    columns: Sequence[str],
    *,
    font_size: float = 7.5,
) -> None:
    """Draw a matrix of values from 0 to 1 as cells of growing strength, with a text in each."""
    n, m = values.shape
    for i in range(n):
        for j in range(m):
            strength = float(np.clip(values[i, j], 0, 1))
            axes.add_patch(Rectangle((j, i), 1, 1, facecolor=ACCENT, alpha=strength**0.7, edgecolor="none"))
            color = "white" if strength > 0.35 else INK
            axes.text(j + 0.5, i + 0.53, texts[i][j], ha="center", va="center", color=color, fontsize=font_size)
    axes.set(xlim=(0, m), ylim=(n, 0), aspect="equal")
    axes.set_xticks(np.arange(m) + 0.5, columns, rotation=45, ha="right", rotation_mode="anchor", fontsize=font_size)
    axes.set_yticks(np.arange(n) + 0.5, rows, fontsize=font_size)
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    for k in range(n + 1):
        axes.axhline(k, color=GRID, linewidth=0.5)
    for k in range(m + 1):
        axes.axvline(k, color=GRID, linewidth=0.5)


def confusion_figure(confusion: ConfusionMatrix, *, name: str, predicted: str) -> Markup:
    """Counts in the cells, the share of the row in their colour; background last."""
    counts = confusion.counts
    totals = counts.sum(axis=1, keepdims=True)
    shares = counts / np.maximum(totals, 1)
    labels = [*confusion.classes, "background"]
    with new_figure(6.4, 6.1, name) as figure:
        axes = figure.subplots()
        heat_map(axes, shares, [[str(value) if value else "" for value in row] for row in counts], labels, labels)
        axes.set(xlabel=predicted, ylabel="truth")
        return to_svg(figure, title=f"Confusion matrix: truth against {predicted}")


def hmm_figure(hmm: HmmParameters) -> Markup:
    """A, B and C of one type."""
    states = [state.removeprefix(f"{hmm.type}-") for state in hmm.states]
    panels = (
        (f"A: next state after {hmm.nominal_dt_s:g} s", hmm.transition, "to", "from"),
        ("B: what the detector sees", hmm.observation, "seen", "state"),
        ("C: what is behind a sight", hmm.evidence, "seen", "state"),
    )
    with new_figure(10, 1.35 + 0.36 * len(states), f"hmm-{hmm.type}") as figure:
        for axes, (title, matrix, across, down) in zip(figure.subplots(1, 3), panels, strict=True):
            heat_map(axes, matrix, [[_probability(value) for value in row] for row in matrix], states, states)
            axes.set(xlabel=across, ylabel=down, title=title)
        return to_svg(figure, title=f"Matrices of the hidden Markov model of type {hmm.type}")


def learning_figure(columns: dict[str, FloatArray]) -> Markup:
    """Average precision, losses and learning rate over epochs, from the columns of ``results.csv``."""
    panels = (
        ("Average precision on validation images", ("ap", "ap50", "ap75"), ("AP", "AP50", "AP75")),
        ("Training loss", ("box", "obj", "cls"), ("box", "objectness", "class")),
        ("Learning rate", ("lr",), ("rate",)),
    )
    epochs = columns["epoch"]
    with new_figure(10, 2.7, "learning") as figure:
        for axes, (title, names, labels) in zip(figure.subplots(1, 3), panels, strict=True):
            for name, label, color in zip(names, labels, SERIES, strict=False):
                marker = "o" if len(epochs) < 2 else None
                axes.plot(epochs, columns[name], label=label, color=color, marker=marker)
            axes.set(title=title, xlabel="epoch")
            axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=6))
            if len(names) > 1:
                axes.legend(fontsize=8)
            axes.set_ylim(bottom=0)
            if names[0] == "ap":
                axes.set_ylim(0, 1)
        return to_svg(figure, title="Learning curves")


def class_accuracy_figure(per_class: dict[str, tuple[float | None, float | None]], signals: SignalSet) -> Markup:
    """For each class the accuracy (percent) of detection alone, and an arrow to the proposed pipeline's."""
    names = [name for name in signals.classes if per_class[name][0] is not None]
    with new_figure(6.4, 1.0 + 0.3 * len(names), "per-class") as figure:
        axes = figure.subplots()
        for y, name in enumerate(names):
            before, after = per_class[name]
            if before is None or after is None:
                continue
            axes.plot([before, after], [y, y], color=GRID, linewidth=4, solid_capstyle="round", zorder=1)
            axes.plot(before, y, "o", color=SERIES[1], markersize=6, label="OD" if y == 0 else None)
            axes.plot(after, y, "o", color=SERIES[0], markersize=7, label="Proposed" if y == 0 else None)
        axes.set_yticks(range(len(names)), names)
        axes.set(ylim=(len(names) - 0.4, -0.6), xlabel="class accuracy (%)", xlim=(None, 101))
        axes.grid(visible=False, axis="y")
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)
        figure.legend(loc="outside upper right", ncols=2, fontsize=8)
        return to_svg(figure, title="Class accuracy of each class, detection alone and proposed")


def _probability(value: float) -> str:
    if value < 0.0005:
        return ""
    return "1" if value >= 0.9995 else f"{value:.3f}".lstrip("0")
