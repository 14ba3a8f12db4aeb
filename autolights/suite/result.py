"""The suite run whole: every drive of every scenario through every pipeline, held against the targets."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import autolights
from autolights.core import Config, HmmParameters, load_signals
from autolights.core.errors import UsageError
from autolights.core.json_files import read_json_object, validated, write_json
from autolights.core.progress import track
from autolights.pipeline import PipelineConfig
from autolights.sim.workers import in_order
from autolights.suite.config import SuiteConfig
from autolights.suite.drives import build_drive
from autolights.suite.figures import Figures, figures
from autolights.suite.measures import Tally, tally
from autolights.suite.recorded import RecordedDrive, disturb
from autolights.suite.run import run_pipelines, suite_hmm
from autolights.suite.targets import Verdict, judge

_ABLATION = ("od", "fusion", "paper")  # rungs below the pipeline that is judged, and the paper beside it


class SuiteResult(Config):
    """What came of the suite.

    Attributes:
        version: Of autolights.
        suite: What was run.
        pipelines: Settings by label.
        drives: How many were driven.
        scenarios: Scenario → pipeline → figures.
        accuracy_scenarios: Those in `whole` as far as class accuracy goes.
        whole: Pipeline → figures over `accuracy_scenarios`.
        everything: Pipeline → figures over all scenarios.
        accuracy_of_drives: Pipeline → class accuracy on each drive in `whole`, percent, the same order for all.
        verdicts: The targets, for the pipeline that is judged.
    """

    version: str
    suite: SuiteConfig
    pipelines: dict[str, PipelineConfig]
    drives: int
    scenarios: dict[str, dict[str, Figures]]
    accuracy_scenarios: tuple[str, ...]
    whole: dict[str, Figures]
    everything: dict[str, Figures]
    accuracy_of_drives: dict[str, tuple[float, ...]]
    verdicts: tuple[Verdict, ...]

    def to_json(self) -> dict[str, Any]:
        """The result as JSON-ready values."""
        return self.model_dump(mode="json")

    def save(self, path: Path) -> None:
        """Write the result as JSON."""
        write_json(path, self.to_json())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote.

        Raises:
            DataError: If the file is missing or is no result of the suite; the text names file and field.
        """
        return validated(cls, read_json_object(path, hint="is this what the benchmark suite wrote?"), path)


def run_suite(
    suite: SuiteConfig,
    pipelines: Mapping[str, PipelineConfig],
    *,
    scenarios: Sequence[str] = (),
    judged: str = "full",
    workers: int = 1,
) -> SuiteResult:
    """Run pipelines over scenarios.

    Args:
        suite: The scenarios.
        pipelines: Settings by label.
        scenarios: Names; none means all.
        judged: Label of the pipeline that is held against the targets.
        workers: Processes; the figures do not depend on it, the times do.

    Raises:
        UsageError: If a scenario, a class or `judged` is unknown.
    """
    names = _chosen(suite, scenarios)
    _check_confusion(suite)
    tasks = [(suite, dict(pipelines), name, index) for name in names for index in range(suite.scenarios[name].drives)]
    done = in_order(_run_drive, tasks, workers=workers)
    shown = track(done, description="suite", total=len(tasks), unit="drives")
    return _result(suite, pipelines, judged, zip((task[2] for task in tasks), shown, strict=True))


def run_recorded(
    suite: SuiteConfig,
    recorded: Sequence[RecordedDrive],
    hmm: Mapping[str, HmmParameters],
    pipelines: Mapping[str, PipelineConfig],
    *,
    scenarios: Sequence[str] = (),
    judged: str = "full",
) -> SuiteResult:
    """Run pipelines over recorded drives, disturbed as the scenarios have it.

    Args:
        suite: The scenarios; those that need another town, detector or frame rate are left out.
        recorded: Drives with truth and detections.
        hmm: Of the detector.
        pipelines: Settings by label.
        scenarios: Names; none means all that are possible.
        judged: Label of the pipeline that is held against the targets.

    Raises:
        UsageError: If a scenario is unknown or cannot be had of a recorded drive, or `judged` is unknown.
    """
    names = _chosen(suite, scenarios)
    if scenarios:
        for name in names:
            if not suite.scenarios[name].recordable:
                raise UsageError(
                    f"scenario '{name}' cannot be had of a recorded drive: it needs another town or detector"
                )
    names = [name for name in names if suite.scenarios[name].recordable]
    tasks = [(name, drive) for name in names for drive in recorded]

    def counted() -> Iterator[tuple[str, dict[str, Tally]]]:
        for name, drive in track(tasks, description="suite", total=len(tasks), unit="drives"):
            disturbed = disturb(drive, name, suite.scenarios[name], (suite.seed, *name.encode()))
            yield name, {label: tally(run) for label, run in run_pipelines(disturbed, hmm, pipelines).items()}

    return _result(suite, pipelines, judged, counted())


def default_pipelines(config: PipelineConfig, paper: PipelineConfig) -> dict[str, PipelineConfig]:
    """The ablation: detections alone, with the map, with memory; and the paper's rules."""
    variants: dict[str, PipelineConfig] = {
        variant: config.model_copy(update={"variant": variant}) for variant in ("od", "fusion", "full")
    }
    return variants | {"paper": paper.model_copy(update={"variant": "full"})}


def _chosen(suite: SuiteConfig, scenarios: Sequence[str]) -> list[str]:
    for name in scenarios:
        if name not in suite.scenarios:
            raise UsageError(f"the suite has no scenario '{name}'; it has {', '.join(suite.scenarios)}")
    return list(scenarios) or list(suite.scenarios)


def _result(
    suite: SuiteConfig,
    pipelines: Mapping[str, PipelineConfig],
    judged: str,
    drives: Iterable[tuple[str, Mapping[str, Tally]]],
) -> SuiteResult:
    if judged not in pipelines:
        raise UsageError(f"no pipeline '{judged}' to be judged; there are {', '.join(pipelines)}")
    counts: dict[str, dict[str, Tally]] = {}
    of_drives: dict[str, list[float]] = {label: [] for label in pipelines}
    driven = 0
    for name, of_drive in drives:
        driven += 1
        of_scenario = counts.setdefault(name, dict.fromkeys(pipelines, Tally()))
        for label, counted in of_drive.items():
            of_scenario[label] = of_scenario[label] + counted
            if suite.scenarios[name].counts_for_accuracy:
                of_drives[label].append(100 * counted.right / max(counted.rows, 1))
    accuracy_scenarios = tuple(name for name in counts if suite.scenarios[name].counts_for_accuracy)
    return SuiteResult(
        version=autolights.__version__,
        suite=suite,
        pipelines=dict(pipelines),
        drives=driven,
        scenarios={
            name: {label: figures(counted) for label, counted in labels.items()} for name, labels in counts.items()
        },
        accuracy_scenarios=accuracy_scenarios,
        whole={label: figures(_sum(counts, accuracy_scenarios, label)) for label in pipelines},
        everything={label: figures(_sum(counts, tuple(counts), label)) for label in pipelines},
        accuracy_of_drives={label: tuple(values) for label, values in of_drives.items()},
        verdicts=judge(suite, {name: labels[judged] for name, labels in counts.items()}),
    )


def _check_confusion(suite: SuiteConfig) -> None:
    """Each description takes the classes that it knows; one that none knows is a slip."""
    known = {name for entry in suite.scenarios.values() for name in load_signals(entry.signals).classes}
    named = {name for truth, errors in suite.confusion.items() for name in (truth, *errors)}
    if not named <= known:
        raise UsageError(f"confusion names '{min(named - known)}', which no scenario's signal description knows")


def _run_drive(task: tuple[SuiteConfig, dict[str, PipelineConfig], str, int]) -> dict[str, Tally]:
    suite, pipelines, name, index = task
    left_out = () if suite.scenarios[name].ablation else _ABLATION
    wanted = {label: config for label, config in pipelines.items() if label not in left_out}
    drive = build_drive(suite, name, index)
    hmm = suite_hmm(suite, load_signals(suite.scenarios[name].signals))
    return {label: tally(run) for label, run in run_pipelines(drive, hmm, wanted).items()}


def _sum(counts: Mapping[str, Mapping[str, Tally]], names: Sequence[str], label: str) -> Tally:
    return sum((counts[name][label] for name in names), Tally())
