"""The suite run whole: every drive of every scenario through every pipeline, counted, and held against the targets."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import autolights
from autolights.core import Config, load_signals
from autolights.core.errors import UsageError
from autolights.core.json_files import read_json_object, validated, write_json
from autolights.core.progress import track
from autolights.pipeline import PipelineConfig
from autolights.sim.workers import in_order
from autolights.suite.config import SuiteConfig
from autolights.suite.drives import build_drive
from autolights.suite.figures import Figures, figures
from autolights.suite.measures import Tally, tally
from autolights.suite.run import run_pipelines, suite_hmm
from autolights.suite.targets import Verdict, judge


class SuiteResult(Config):
    """What came of the suite.

    Attributes:
        version: Of autolights.
        suite: What was run.
        pipelines: Settings by label.
        scenarios: Scenario → pipeline → figures.
        accuracy_scenarios: Those in `whole` as far as class accuracy goes.
        whole: Pipeline → figures over `accuracy_scenarios`.
        everything: Pipeline → figures over all scenarios.
        verdicts: The targets, for the pipeline that is judged.
    """

    version: str
    suite: SuiteConfig
    pipelines: dict[str, PipelineConfig]
    scenarios: dict[str, dict[str, Figures]]
    accuracy_scenarios: tuple[str, ...]
    whole: dict[str, Figures]
    everything: dict[str, Figures]
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
        UsageError: If a scenario or `judged` is unknown.
    """
    names = list(scenarios) or list(suite.scenarios)
    for name in names:
        if name not in suite.scenarios:
            raise UsageError(f"the suite has no scenario '{name}'; it has {', '.join(suite.scenarios)}")
    if judged not in pipelines:
        raise UsageError(f"no pipeline '{judged}' to be judged; there are {', '.join(pipelines)}")
    tasks = [(suite, dict(pipelines), name, index) for name in names for index in range(suite.scenarios[name].drives)]
    counts = {name: {label: Tally() for label in pipelines} for name in names}
    done = in_order(_run_drive, tasks, workers=workers)
    for (_, _, name, _), of_drive in zip(
        tasks, track(done, description="suite", total=len(tasks), unit="drives"), strict=True
    ):
        for label, counted in of_drive.items():
            counts[name][label] = counts[name][label] + counted

    accuracy_scenarios = tuple(name for name in names if suite.scenarios[name].counts_for_accuracy)
    return SuiteResult(
        version=autolights.__version__,
        suite=suite,
        pipelines=dict(pipelines),
        scenarios={
            name: {label: figures(counted) for label, counted in labels.items()} for name, labels in counts.items()
        },
        accuracy_scenarios=accuracy_scenarios,
        whole={label: figures(_sum(counts, accuracy_scenarios, label)) for label in pipelines},
        everything={label: figures(_sum(counts, names, label)) for label in pipelines},
        verdicts=judge(suite, {name: labels[judged] for name, labels in counts.items()}),
    )


def default_pipelines(config: PipelineConfig, paper: PipelineConfig) -> dict[str, PipelineConfig]:
    """The ablation: detections alone, with the map, with memory; and the paper's rules."""
    variants: dict[str, PipelineConfig] = {
        variant: config.model_copy(update={"variant": variant}) for variant in ("od", "fusion", "full")
    }
    return variants | {"paper": paper.model_copy(update={"variant": "full"})}


def _run_drive(task: tuple[SuiteConfig, dict[str, PipelineConfig], str, int]) -> dict[str, Tally]:
    suite, pipelines, name, index = task
    only = suite.scenarios[name].pipelines
    wanted = {label: config for label, config in pipelines.items() if not only or label in only}
    drive = build_drive(suite, name, index)
    hmm = suite_hmm(suite, load_signals(suite.scenarios[name].signals))
    return {label: tally(run) for label, run in run_pipelines(drive, hmm, wanted).items()}


def _sum(counts: Mapping[str, Mapping[str, Tally]], names: Sequence[str], label: str) -> Tally:
    return sum((counts[name][label] for name in names), Tally())
