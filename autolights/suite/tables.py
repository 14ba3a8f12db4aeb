"""The suite's result as Markdown: the targets first, then every scenario."""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.special import stdtrit

from autolights.evaluate.score import Share
from autolights.suite.figures import Figures, Spread
from autolights.suite.result import SuiteResult
from autolights.suite.targets import Verdict

_MET = {True: "yes", False: "**no**", None: "–"}


def markdown(result: SuiteResult) -> str:
    """The whole result; each figure with its count."""
    names = list(result.scenarios)
    parts = [
        f"autolights {result.version}, seed {result.suite.seed}: {len(names)} scenarios, {result.drives} drives.",
        _targets(result.verdicts),
    ]
    for title, rows in (
        ("Over the suite (scenarios of 10 sets a second and more)", result.whole),
        ("Over all scenarios", result.everything),
    ):
        parts += [f"**{title}**", _figures_table(list(rows.items()))]
    for name in names:
        parts += [
            f"**{name}**: {result.suite.scenarios[name].about}",
            _figures_table(list(result.scenarios[name].items())),
        ]
    return "\n\n".join(parts) + "\n"


def comparison(result: SuiteResult, first: str, second: str) -> str:
    """Two pipelines on the same drives: the difference in class accuracy, paired drive by drive."""
    gains = np.subtract(result.accuracy_of_drives[second], result.accuracy_of_drives[first])
    if len(gains) < 2:
        return "Too few drives to compare."
    # Student's t over drives: the drives are the independent draws, not the frames.
    half_width = stdtrit(len(gains) - 1, 0.975) * gains.std(ddof=1) / np.sqrt(len(gains))
    return (
        f"{second} against {first}: class accuracy {gains.mean():+.2f} points "
        f"(95 % interval {gains.mean() - half_width:+.2f} to {gains.mean() + half_width:+.2f}, paired over "
        f"{len(gains)} drives; better on {(gains > 0).sum()}, worse on {(gains < 0).sum()})."
    )


def _targets(verdicts: Iterable[Verdict]) -> str:
    rows = [
        (v.name, v.target, _number(v.value, 3), _number(v.count, 0 if v.count >= 100 else 1), _MET[v.met])
        for v in verdicts
    ]
    return _table(("", "target", "measured", "of", "met"), rows)


def _figures_table(entries: Sequence[tuple[str, Figures]]) -> str:
    columns = [figure_rows(of) for _, of in entries]
    rows = [(name, *(column[i][1] for column in columns)) for i, (name, _) in enumerate(columns[0])]
    empty = [i for i, (_, *cells) in enumerate(rows) if all(cell == "–" for cell in cells)]
    return _table(("", *(label for label, _ in entries)), [row for i, row in enumerate(rows) if i not in empty])


def figure_rows(of: Figures) -> list[tuple[str, str]]:
    """What is counted, and the figure with its count, as texts."""
    bound = "" if of.unsafe_bound is None else f", < {100 * of.unsafe_bound:.3f} % at 95 %"
    return [
        ("class accuracy", _share(of.accuracy)),
        ("… without first sets", _share(of.settled)),
        (
            "unsafe reports",
            f"{of.unsafe.count} of {of.unsafe.total} in {of.unsafe_stretches} stretches{bound}"
            if of.unsafe.total
            else "–",
        ),
        ("visible lights withheld", _share(of.withheld)),
        ("visible lights missed", _share(of.missed)),
        ("flicker per light-minute", _rate(of.flickers_per_minute, of.flickers)),
        ("transition latency (frames)", _delays(of.transition_frames, of.transition_never, 1)),
        ("flash onset (s)", _delays(of.onset_s, of.onset_never, 2)),
        ("false flashing per light-hour", _rate(of.false_flashes_per_hour, of.false_flashes)),
        ("false reports per set", _rate(of.false_reports_per_set, of.false_reports)),
        ("association right", _share(of.pairing)),
        ("… by plain distance", _share(of.plain_pairing)),
        ("map lights after 15 m (m)", _mean(of.map_error_m)),
        ("… the map itself (m)", _mean(of.survey_error_m)),
        ("unmapped at 40 m (m)", _mean(of.far_error_m)),
        ("unmapped below 20 m (m)", _mean(of.near_error_m)),
        ("ms per set", _times(of.step_ms)),
        ("frames left out", str(of.skipped) if of.skipped else "–"),
    ]


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _number(value: float | None, decimals: int) -> str:
    return "–" if value is None else f"{value:,.{decimals}f}"


def _share(share: Share) -> str:
    return "–" if share.percent is None else f"{share.percent:.2f} % of {share.total}"


def _rate(rate: float | None, count: int) -> str:
    return "–" if rate is None else f"{rate:.3f} ({count})"


def _delays(spread: Spread, never: int, decimals: int) -> str:
    if not spread.count + never:
        return "–"
    lost = f", {never} never" if never else ""
    numbers = " / ".join(_number(value, decimals) for value in (spread.median, spread.p95, spread.worst))
    return f"{numbers} ({spread.count}{lost})"


def _mean(spread: Spread) -> str:
    return "–" if spread.mean is None else f"{spread.mean:.2f} ({spread.count})"


def _times(spread: Spread) -> str:
    return "–" if spread.median is None else f"{spread.median:.2f}, p99 {_number(spread.p99, 2)}"
