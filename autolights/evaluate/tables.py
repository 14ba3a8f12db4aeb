"""The evaluation as tables in a terminal, the paper's rows beside ours."""

import io

from rich.console import Console
from rich.table import Table

from autolights.evaluate.paper import PIPELINE
from autolights.evaluate.score import Delays, Evaluation, Share, VariantScore


def table(evaluation: Evaluation) -> str:
    """The paper's Table III, ours and theirs, and below it all that is counted beside it."""
    # Wider than the tables ever get: they take the room that they need, also where the output is no terminal.
    console = Console(width=200, file=io.StringIO(), record=True)
    console.print(_ablation_table(evaluation))
    console.print(_detail_table(evaluation))
    return "\n".join(line.rstrip() for line in console.export_text().splitlines())


def _ablation_table(evaluation: Evaluation) -> Table:
    table = Table(title=f"{', '.join(evaluation.drives)}: {evaluation.frames} camera frames", title_justify="left")
    table.add_column("")
    for name in ("sets/s", "APE (m)", "class accuracy (%)", "paper: FPS", "APE (m)", "class accuracy (%)"):
        table.add_column(name, justify="right")
    for variant, score in evaluation.variants.items():
        paper = PIPELINE[variant]
        table.add_row(
            paper.name,
            number(score.speed.sets_per_s if score.speed else None, 1),
            number(score.ape_m, 2),
            number(score.class_accuracy, 1),
            number(paper.fps, 0),
            number(paper.ape_m, 2),
            number(paper.class_accuracy, 1),
        )
    return table


def _detail_table(evaluation: Evaluation) -> Table:
    table = Table()
    table.add_column("")
    for variant in evaluation.variants:
        table.add_column(PIPELINE[variant].name, justify="right")
    columns = [dict(detail_rows(score)) for score in evaluation.variants.values()]
    for name in columns[0]:
        table.add_row(name, *(column[name] for column in columns))
    return table


def detail_rows(score: VariantScore) -> list[tuple[str, str]]:
    """What is counted, and the figure with its count, as texts."""
    return [
        ("labelled lights", str(score.labelled)),
        ("matched for APE", str(score.ape_count)),
        ("right on visible lights", share(score.visible)),
        ("right on occluded lights", share(score.occluded)),
        ("misses", str(score.misses)),
        ("visible lights withheld", share(score.withheld_visible)),
        ("false reports", str(score.false_reports)),
        ("false tracks", "–" if score.false_tracks is None else str(score.false_tracks)),
        ("transition latency", delays(score.transitions)),
        ("flash onset", delays(score.flash_onsets)),
        ("flicker per light-minute", f"{number(score.flickers_per_minute, 2)} ({score.flickers})"),
        ("unsafe reports", share(score.unsafe)),
    ]


def number(value: float | None, decimals: int) -> str:
    """A figure, or a dash where there is none."""
    return "–" if value is None else f"{value:.{decimals}f}"


def share(value: Share) -> str:
    """Percent, and what of what."""
    return f"{number(value.percent, 1)} % ({value.count} of {value.total})" if value.total else "–"


def delays(value: Delays) -> str:
    """Median and 95th percentile, and how many there were."""
    if not value.total:
        return "–"
    never = f", {value.never} never" if value.never else ""
    if value.median_s is None:
        return f"none of {value.total} reported"
    return f"{number(value.median_s, 2)} s, p95 {number(value.p95_s, 2)} s ({value.total}{never})"
