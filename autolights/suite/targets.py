"""The figures that the runtime has to reach, and whether it does."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from autolights.core import Config
from autolights.suite.config import SuiteConfig
from autolights.suite.figures import Figures, figures
from autolights.suite.measures import Tally

MIN_LIGHT_FRAMES = 100_000  # of which no unsafe report is to be seen


class Verdict(Config):
    """One target.

    Attributes:
        name: What is measured, and where.
        target: What it has to be.
        value: What it is; None where the scenarios that were run do not tell.
        count: Out of how many.
        met: Whether it is reached; None where nothing is known.
    """

    name: str
    target: str
    value: float | None
    count: float
    met: bool | None


@dataclass(frozen=True)
class _Target:
    name: str
    target: str
    scenarios: Callable[[SuiteConfig, str], bool]
    value: Callable[[Figures], float | None]
    count: Callable[[Figures], float]
    limit: float
    at_least: bool = False
    enough: float = 0.0


def judge(suite: SuiteConfig, counts: Mapping[str, Tally]) -> tuple[Verdict, ...]:
    """Hold one pipeline's tallies, by scenario, against all targets."""
    verdicts = []
    for target in _TARGETS:
        chosen = [counts[name] for name in counts if target.scenarios(suite, name)]
        measured = figures(sum(chosen, Tally()))
        value, count = target.value(measured), target.count(measured)
        met = None
        if value is not None:
            met = (value >= target.limit if target.at_least else value <= target.limit) and count >= target.enough
        verdicts.append(Verdict(name=target.name, target=target.target, value=value, count=count, met=met))
    return tuple(verdicts)


def _in_accuracy(suite: SuiteConfig, name: str) -> bool:
    return suite.scenarios[name].counts_for_accuracy


def _any(suite: SuiteConfig, name: str) -> bool:
    return True


def _at_10_hz(suite: SuiteConfig, name: str) -> bool:
    scenario = suite.scenarios[name]
    return scenario.counts_for_accuracy and scenario.frame_rate_hz == 10 and scenario.dropped_share == 0


def _flashing_arrows(suite: SuiteConfig, name: str) -> bool:
    scenario = suite.scenarios[name]
    return scenario.frame_rate_hz >= 10 and scenario.dropped_share == 0 and scenario.programme == "ordinary"


def _one(wanted: str) -> Callable[[SuiteConfig, str], bool]:
    return lambda _, name: name == wanted


_TARGETS = (
    _Target(
        "class accuracy, %",
        "≥ 98.0",
        _in_accuracy,
        lambda f: f.accuracy.percent,
        lambda f: f.accuracy.total,
        98.0,
        True,
    ),
    _Target(
        "class accuracy without first sets, %",
        "≥ 99.0",
        _in_accuracy,
        lambda f: f.settled.percent,
        lambda f: f.settled.total,
        99.0,
        True,
    ),
    _Target(
        "unsafe reports in at least 100,000 light-frames",
        "0",
        _any,
        lambda f: f.unsafe.count,
        lambda f: f.unsafe.total,
        0,
        enough=MIN_LIGHT_FRAMES,
    ),
    _Target("visible lights withheld, %", "≤ 1", _any, lambda f: f.withheld.percent, lambda f: f.withheld.total, 1.0),
    _Target(
        "flicker per light-minute", "≤ 0.05", _any, lambda f: f.flickers_per_minute, lambda f: f.light_minutes, 0.05
    ),
    _Target(
        "transition latency at 10 Hz, frames, median",
        "≤ 1",
        _at_10_hz,
        lambda f: f.transition_frames.median,
        lambda f: f.transition_frames.count,
        1.0,
    ),
    _Target(
        "transition latency at 10 Hz, frames, 95th percentile",
        "≤ 2",
        _at_10_hz,
        lambda f: f.transition_frames.p95,
        lambda f: f.transition_frames.count,
        2.0,
    ),
    _Target(
        "flash onset, yellow arrow, s, median",
        "≤ 0.8",
        _flashing_arrows,
        lambda f: f.onset_s.median,
        lambda f: f.onset_s.count,
        0.8,
    ),
    _Target(
        "flash onset, yellow arrow, s, worst",
        "≤ 1.2",
        _flashing_arrows,
        lambda f: f.onset_s.worst,
        lambda f: f.onset_s.count,
        1.2,
    ),
    _Target(
        "flash onset, lit state legal when steady, s, worst",
        "≤ 1.6",
        _one("flashing_red"),
        lambda f: f.onset_s.worst,
        lambda f: f.onset_s.count,
        1.6,
    ),
    _Target(
        "false flashing per light-hour",
        "≤ 0.1",
        _any,
        lambda f: f.false_flashes_per_hour,
        lambda f: f.steady_hours,
        0.1,
        enough=10.0,
    ),
    _Target(
        "map lights after 15 m in view, m",
        "≤ 0.25",
        _one("survey"),
        lambda f: f.map_error_m.mean,
        lambda f: f.map_error_m.count,
        0.25,
    ),
    _Target(
        "unmapped lights at 40 m, m",
        "≤ 1.0",
        _one("map_missing"),
        lambda f: f.far_error_m.mean,
        lambda f: f.far_error_m.count,
        1.0,
    ),
    _Target(
        "unmapped lights below 20 m, m",
        "≤ 0.5",
        _one("map_missing"),
        lambda f: f.near_error_m.mean,
        lambda f: f.near_error_m.count,
        0.5,
    ),
    _Target(
        "association with 1° mounting error, %",
        "≥ 99.5",
        _one("mounting_1.0"),
        lambda f: f.pairing.percent,
        lambda f: f.pairing.total,
        99.5,
        True,
    ),
    _Target(
        "fusion and tracking of a set of `steady`, ms, median",
        "≤ 1.0",
        _one("steady"),
        lambda f: f.step_ms.median,
        lambda f: f.step_ms.count,
        1.0,
    ),
    _Target(
        "fusion and tracking of a set of `steady`, ms, 99th percentile",
        "≤ 2.0",
        _one("steady"),
        lambda f: f.step_ms.p99,
        lambda f: f.step_ms.count,
        2.0,
    ),
)
