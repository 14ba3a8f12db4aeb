"""The figures of an evaluation: each variant of the pipeline over all drives (DESIGN: Scoring)."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from autolights.core import Config, SignalSet
from autolights.core.estimates import VARIANTS, Variant
from autolights.core.json_files import read_json_object, validated, write_json
from autolights.evaluate.errors_by_cause import count_causes
from autolights.evaluate.outcomes import (
    FalseReport,
    LightOutcome,
    RunOutcomes,
    gather_outcomes,
)
from autolights.evaluate.timelines import (
    Delay,
    duration_s,
    flash_onset_delays,
    flicker_count,
    timelines,
    transition_delays,
    unsafe_frames,
)


class Share(Config):
    """`count` of `total`."""

    count: int
    total: int

    @property
    def percent(self) -> float | None:
        """None of nothing."""
        return 100 * self.count / self.total if self.total else None


class Delays(Config):
    """How long changes took to be reported.

    Attributes:
        total: Changes.
        never: Those that were over before they were reported.
        median_s: Of the reported ones; None if there are none. So for the rest.
        p95_s: 95th percentile.
        median_frames: In frames of the camera.
        p95_frames: 95th percentile.
    """

    total: int
    never: int
    median_s: float | None
    p95_s: float | None
    median_frames: float | None
    p95_frames: float | None


class Speed(Config):
    """How fast a variant ran, images ready in memory.

    Attributes:
        sets: Sets of frames.
        images: Images in them.
        sets_per_s: End to end.
        images_per_s: End to end.
        detect_ms: Mean time of the detector per set.
        track_ms: Mean time of all the rest per set.
    """

    sets: int
    images: int
    sets_per_s: float
    images_per_s: float
    detect_ms: float
    track_ms: float


class VariantScore(Config):
    """Everything that is counted of one variant.

    Attributes:
        labelled: Labelled lights in view, over all camera frames.
        correct: Reported with the right class.
        misses: Not reported; withheld ones count.
        withheld: Reported, but withheld.
        ape_m: Mean distance in space between reported and true position; None without a match.
        ape_count: Reports in it, whatever their class.
        visible: Correct ones of the lights of which at most half is hidden.
        occluded: Correct ones of the others.
        per_class: Correct ones of each class of the truth.
        causes: Errors by cause.
        false_reports: Reports of nothing: per camera frame, for the tracker per set of frames.
        false_tracks: Distinct tracks among them; None for variants without memory.
        transitions: From a new state to its report.
        flash_onsets: From the onset of a flash to its report as flashing.
        flickers: Changes of reports that the truth does not have.
        light_minutes: Time in which lights were in view, over all cameras.
        unsafe: Reports that say "go" to a movement that has been shown "stop", of those that could.
        withheld_visible: Withheld ones of the visible lights.
        confusion: (C + 1, C + 1) counts `[truth, reported]`, background last.
        speed: None if the run does not tell.
    """

    labelled: int
    correct: int
    misses: int
    withheld: int
    ape_m: float | None
    ape_count: int
    visible: Share
    occluded: Share
    per_class: dict[str, Share]
    causes: dict[str, int]
    false_reports: int
    false_tracks: int | None
    transitions: Delays
    flash_onsets: Delays
    flickers: int
    light_minutes: float
    unsafe: Share
    withheld_visible: Share
    confusion: tuple[tuple[int, ...], ...]
    speed: Speed | None

    @property
    def class_accuracy(self) -> float | None:
        """Percent of the labelled lights that were reported with the right class; a miss is wrong."""
        return Share(count=self.correct, total=self.labelled).percent

    @property
    def flickers_per_minute(self) -> float | None:
        """Per minute of one light in view of one camera."""
        return self.flickers / self.light_minutes if self.light_minutes else None


class Evaluation(Config):
    """Scores of all variants over all drives.

    Attributes:
        drives: Names.
        classes: Rows and columns of the confusion matrices, background left out.
        frames: Camera frames that were scored.
        skipped_frames: Camera frames without a pose: nobody can say what is in view.
        unanswered_frames: Camera frames about which the runs say nothing; their lights are misses.
        variants: By name: ``od``, ``fusion``, ``full``.
    """

    drives: tuple[str, ...]
    classes: tuple[str, ...]
    frames: int
    skipped_frames: int
    unanswered_frames: int
    variants: dict[Variant, VariantScore]

    def to_json(self) -> dict[str, Any]:
        """The figures as JSON-ready values."""
        return self.model_dump(mode="json")

    def save(self, path: Path) -> None:
        """Write the figures as JSON."""
        write_json(path, self.to_json())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote.

        Raises:
            DataError: If the file is missing or is no evaluation; the text names file and field.
        """
        return validated(cls, read_json_object(path, hint="run `autolights evaluate` first"), path)


def evaluate(runs: Iterable[tuple[Path, Path]], signals: SignalSet) -> Evaluation:
    """Score runs over drives with truth, merged over all of them.

    Args:
        runs: (folder of the run, folder of the drive) of each.
        signals: The signal description of both.

    Raises:
        DataError: If a file breaks its format, a drive has no truth or a run does not belong to its drive.
    """
    return score_runs([gather_outcomes(run_dir, drive_dir, signals) for run_dir, drive_dir in runs], signals)


def score_runs(runs: Sequence[RunOutcomes], signals: SignalSet) -> Evaluation:
    """Count everything; a variant that only some of the runs hold is scored on those."""
    variants: dict[Variant, VariantScore] = {}
    for variant in VARIANTS:
        holding = [run for run in runs if variant in run.variants]
        if holding:
            variants[variant] = score_variant(
                variant,
                [row for run in holding for row in run.variants[variant].outcomes],
                [report for run in holding for report in run.variants[variant].false_reports],
                signals,
                merge_speeds([run.info["variants"].get(variant) for run in holding]),
            )
    return Evaluation(
        drives=tuple(run.drive.name for run in runs),
        classes=signals.classes,
        frames=sum(len(run.truth) - run.skipped_frames for run in runs),
        skipped_frames=sum(run.skipped_frames for run in runs),
        unanswered_frames=sum(run.unanswered_frames for run in runs),
        variants=variants,
    )


def score_variant(
    variant: Variant,
    outcomes: Sequence[LightOutcome],
    false_reports: Sequence[FalseReport],
    signals: SignalSet,
    speed: Speed | None,
) -> VariantScore:
    """Count the rows of one variant."""
    stretches = timelines(outcomes)
    unsafe = [unsafe_frames(stretch, signals) for stretch in stretches]
    distances = [row.error_m for row in outcomes if row.error_m is not None]
    tracks = {(report.drive, report.estimate.track_id) for report in false_reports}
    return VariantScore(
        labelled=len(outcomes),
        correct=sum(row.correct for row in outcomes),
        misses=sum(row.reported_class is None for row in outcomes),
        withheld=sum(row.withheld for row in outcomes),
        ape_m=float(np.mean(distances)) if distances else None,
        ape_count=len(distances),
        visible=_share_correct(row for row in outcomes if row.visible),
        occluded=_share_correct(row for row in outcomes if not row.visible),
        per_class={
            name: _share_correct(row for row in outcomes if row.truth.class_name == name) for name in signals.classes
        },
        causes=count_causes(outcomes),
        false_reports=len(false_reports),
        false_tracks=len(tracks) if variant == "full" else None,
        transitions=_delays([delay for stretch in stretches for delay in transition_delays(stretch)]),
        flash_onsets=_delays([delay for stretch in stretches for delay in flash_onset_delays(stretch)]),
        flickers=sum(flicker_count(stretch) for stretch in stretches),
        light_minutes=sum(duration_s(stretch) for stretch in stretches) / 60,
        unsafe=Share(count=sum(len(rows) for rows, _ in unsafe), total=sum(possible for _, possible in unsafe)),
        withheld_visible=Share(
            count=sum(row.withheld for row in outcomes if row.visible), total=sum(row.visible for row in outcomes)
        ),
        confusion=_confusion(outcomes, false_reports, signals),
        speed=speed,
    )


def merge_speeds(entries: Iterable[dict[str, Any] | None]) -> Speed | None:
    """Add up the times of several runs as ``run.json`` tells them."""
    known = [entry for entry in entries if entry and entry["sets"]]
    if not known:
        return None
    sets = np.array([entry["sets"] for entry in known])
    images = int(sum(entry["images"] for entry in known))
    seconds = float(sum(sets / [entry["fps"] for entry in known]))
    return Speed(
        sets=int(sets.sum()),
        images=images,
        sets_per_s=float(sets.sum() / seconds),
        images_per_s=images / seconds,
        detect_ms=float(np.average([entry["detect_ms"]["mean"] for entry in known], weights=sets)),
        track_ms=float(np.average([entry["track_ms"]["mean"] for entry in known], weights=sets)),
    )


def _share_correct(rows: Iterable[LightOutcome]) -> Share:
    flags = [row.correct for row in rows]
    return Share(count=sum(flags), total=len(flags))


def _delays(delays: Sequence[Delay]) -> Delays:
    seconds = [delay.seconds for delay in delays if delay.seconds is not None]
    frames = [delay.frames for delay in delays if delay.frames is not None]
    return Delays(
        total=len(delays),
        never=len(delays) - len(seconds),
        median_s=_percentile(seconds, 50),
        p95_s=_percentile(seconds, 95),
        median_frames=_percentile(frames, 50),
        p95_frames=_percentile(frames, 95),
    )


def _percentile(values: Sequence[float], percent: float) -> float | None:
    return float(np.percentile(values, percent)) if values else None


def _confusion(
    outcomes: Sequence[LightOutcome], false_reports: Sequence[FalseReport], signals: SignalSet
) -> tuple[tuple[int, ...], ...]:
    background = len(signals.classes)
    counts = np.zeros((background + 1, background + 1), dtype=np.int64)
    for row in outcomes:
        reported = background if row.reported_class is None else signals.class_ids[row.reported_class]
        counts[signals.class_ids[row.truth.class_name], reported] += 1
    for report in false_reports:
        counts[background, signals.class_ids[report.estimate.class_name]] += 1
    return tuple(tuple(int(value) for value in row) for row in counts)
