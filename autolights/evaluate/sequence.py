"""The state-sequence figure: truth, detection alone and the proposed pipeline over time, for one light."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, TypeVar

from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle

from autolights.core import SignalSet
from autolights.evaluate.figures import new_figure, to_svg
from autolights.evaluate.outcomes import LightOutcome, RunOutcomes
from autolights.evaluate.palette import DARK, FLASHING, GRID, INK, MUTED, OCCLUSION, state_colors
from autolights.evaluate.timelines import timelines

T = TypeVar("T")

_WIDTH_IN = 10.0
_LETTER_IN = 0.075
_BAND = 0.66  # height of a row's band; rows are 1 apart


@dataclass(frozen=True, eq=False)
class LightSequence:
    """One light in one camera, frame by frame in the order of time.

    Attributes:
        od: Rows of detection alone.
        proposed: Rows of fusion and tracking, of the same frames.
    """

    od: Sequence[LightOutcome]
    proposed: Sequence[LightOutcome]

    @property
    def events(self) -> int:
        """Changes of state, beginnings of a flash and beginnings of an occlusion; the latter two count double."""
        return (
            sum(1 for _ in _runs(self.proposed, lambda row: row.truth.class_name))
            + 2 * sum(flag for _, _, flag in _runs(self.proposed, lambda row: row.truth.flashing))
            + 2 * sum(flag for _, _, flag in _runs(self.proposed, lambda row: not row.visible))
        )

    @property
    def rescued(self) -> int:
        """Frames in which the proposed pipeline is right and detection alone is not."""
        return sum(p.correct and not o.correct for o, p in zip(self.od, self.proposed, strict=True))


def most_eventful(runs: Iterable[RunOutcomes]) -> LightSequence | None:
    """The stretch with the most events; of equals the one in which tracking helps most. None without any rows."""
    best: LightSequence | None = None
    for run in runs:
        if "od" not in run.variants or "full" not in run.variants:
            continue
        od = {(row.camera, row.stamp_ns, row.truth.truth_id): row for row in run.variants["od"].outcomes}
        for stretch in timelines(run.variants["full"].outcomes):
            candidate = LightSequence(
                [od[row.camera, row.stamp_ns, row.truth.truth_id] for row in stretch], list(stretch)
            )
            if best is None or (candidate.events, candidate.rescued) > (best.events, best.rescued):
                best = candidate
    return best


def sequence_figure(sequence: LightSequence, signals: SignalSet) -> Markup:
    """Bands in the states' colours, one row each for truth, detection alone and the proposed pipeline."""
    rows = sequence.proposed
    names = signals.states_of(rows[0].truth.type)
    with new_figure(_WIDTH_IN, 2.9, "sequence") as figure:
        axes = figure.subplots()
        _shade(axes, rows, lambda row: row.truth.flashing, FLASHING, 0.22)
        _shade(axes, rows, lambda row: not row.visible, OCCLUSION, 0.38)
        _draw_row(axes, 0, rows, lambda row: row.truth.class_name, signals)
        _draw_row(axes, 1, sequence.od, lambda row: row.reported_class, signals)
        _draw_row(axes, 2, rows, lambda row: row.reported_class, signals)
        end_s = (rows[-1].stamp_ns - rows[0].stamp_ns) / 1e9
        axes.set(xlim=(0, max(end_s, 0.1)), ylim=(2.55, -0.55), xlabel="seconds")
        axes.set_yticks([0, 1, 2], ["truth", "OD", "proposed"], color=INK, fontsize=10)
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False, axis="y")
        axes.spines["left"].set_visible(False)
        shown = {name for row in rows for name in (row.truth.class_name, row.reported_class)}
        shown |= {row.reported_class for row in sequence.od}
        handles = [
            Patch(facecolor=state_colors(n, signals)[-1], hatch=_hatch(n, signals), edgecolor=INK, linewidth=0, label=n)
            for n in names
            if n in shown
        ]
        handles += [
            Patch(facecolor="none", edgecolor=MUTED, linestyle=":", label="not reported"),
            Patch(facecolor=FLASHING, alpha=0.3, label="flashing"),
            Patch(facecolor=OCCLUSION, alpha=0.45, label="occluded"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 8), fontsize=8)
        return to_svg(figure, title="States of one light over time: truth, detection alone, proposed")


def _shade(
    axes: Axes, rows: Sequence[LightOutcome], flag: Callable[[LightOutcome], bool], color: str, alpha: float
) -> None:
    for start, end, raised in _runs(rows, flag):
        if raised:
            axes.axvspan(start, end, color=color, alpha=alpha, linewidth=0)


def _draw_row(
    axes: Axes, y: int, rows: Sequence[LightOutcome], value: Callable[[LightOutcome], str | None], signals: SignalSet
) -> None:
    span_s = (rows[-1].stamp_ns - rows[0].stamp_ns) / 1e9
    top = y - _BAND / 2
    for start, end, name in _runs(rows, value):
        if name is None:
            axes.add_patch(
                Rectangle((start, top), end - start, _BAND, facecolor="none", edgecolor=MUTED, linestyle=":")
            )
            continue
        colors = state_colors(name, signals)
        height = _BAND / len(colors)
        for i, color in enumerate(colors):
            axes.add_patch(
                Rectangle(
                    (start, top + i * height),
                    end - start,
                    height,
                    facecolor=color,
                    hatch=_hatch(name, signals),
                    edgecolor=INK,
                    linewidth=0,
                )
            )
        if len(name) * _LETTER_IN < (end - start) / max(span_s, 0.1) * 0.88 * _WIDTH_IN:
            axes.text((start + end) / 2, y, name, **_name_style(colors, hatched=_hatch(name, signals) is not None))
    axes.axhline(y + 0.5, color=GRID, linewidth=0.6)


def _name_style(colors: Sequence[str], *, hatched: bool) -> dict[str, Any]:
    """Readable on the band: light on a dark lamp, and on a plain ground where the band is hatched."""
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 8, "clip_on": True}
    style["color"] = "#ffffff" if colors[0] == DARK else "#14181d"
    if hatched:
        style["bbox"] = {"facecolor": colors[0], "edgecolor": "none", "boxstyle": "round,pad=0.25"}
    return style


def _hatch(name: str, signals: SignalSet) -> str | None:
    """States of one type that show the same colours are told apart by their hatching."""
    states = signals.states_of(signals.type_of[name])
    alike = [state for state in states if state_colors(state, signals) == state_colors(name, signals)]
    return (None, "////", "....", "xxxx")[alike.index(name) % 4]


def _runs(rows: Sequence[LightOutcome], value: Callable[[LightOutcome], T]) -> Iterator[tuple[float, float, T]]:
    """Stretches of equal value: start and end in seconds since the first row, and the value."""
    first_ns = rows[0].stamp_ns
    index = 0
    for key, group in groupby(rows, key=value):
        count = sum(1 for _ in group)
        end = min(index + count, len(rows) - 1)
        yield (rows[index].stamp_ns - first_ns) / 1e9, (rows[end].stamp_ns - first_ns) / 1e9, key
        index += count
