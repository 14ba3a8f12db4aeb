"""What became of each light in each camera frame of a run: the rows from which every figure is counted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from autolights.core import FloatArray, LightEstimate, PoseBuffer, SignalSet
from autolights.core.errors import DataError, PoseError
from autolights.core.estimates import VARIANTS, Variant
from autolights.data import Drive, EstimateSet, TruthFrame, TruthLight, load_estimates, load_run_info, load_truth
from autolights.data.run_output import ESTIMATES, RUN
from autolights.evaluate.in_view import lights_in_view
from autolights.evaluate.matching import match_lights, match_seen_boxes

OCCLUDED_ABOVE = 0.5  # share of the box from which a light counts as occluded


@dataclass(frozen=True, eq=False)
class LightOutcome:
    """One labelled light in one camera frame, and what a variant said about it.

    Attributes:
        drive: Name of the drive.
        camera: Of the frame.
        stamp_ns: Of the frame.
        truth: The light; in variant ``full`` with the state that the set's latest image of it shows.
        estimate: What was reported about it, withheld or not; None if nothing was.
    """

    drive: str
    camera: str
    stamp_ns: int
    truth: TruthLight
    estimate: LightEstimate | None

    @property
    def reported_class(self) -> str | None:
        """The class that one may act upon; None for a miss, and a withheld report is one."""
        return None if self.estimate is None or self.estimate.withheld else self.estimate.class_name

    @property
    def correct(self) -> bool:
        """Whether the report is right; the raw class name is compared, so a 4-off on a flashing light is wrong."""
        return self.reported_class == self.truth.class_name

    @property
    def withheld(self) -> bool:
        """Whether a report exists but is not to be acted upon."""
        return self.estimate is not None and self.estimate.withheld

    @property
    def visible(self) -> bool:
        """Whether at most half of the light is hidden."""
        return self.truth.occlusion <= OCCLUDED_ABOVE

    @property
    def error_m(self) -> float | None:
        """Distance between reported and true position; None for a miss."""
        if self.estimate is None or self.estimate.withheld:
            return None
        return float(np.linalg.norm(self.estimate.position - self.truth.position))


@dataclass(frozen=True, eq=False)
class FalseReport:
    """A report of a light that does not exist, or a second report of one that does."""

    drive: str
    stamp_ns: int
    estimate: LightEstimate


@dataclass(eq=False)
class VariantOutcomes:
    """All rows of one variant in one drive."""

    outcomes: list[LightOutcome] = field(default_factory=list)
    false_reports: list[FalseReport] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class RunOutcomes:
    """A run scored row by row.

    Attributes:
        drive: The drive that was run over.
        truth: Its truth by (camera, stamp_ns).
        estimates: What the run said, set by set and variant by variant.
        variants: Rows of each variant that the run holds.
        info: ``run.json``.
        poses: The drive's poses, ready to be asked.
        posed_frames: Camera frames, as (camera, stamp_ns), for which there is a pose.
        skipped_frames: Camera frames with truth but without a pose: nobody can say what is in view.
        unanswered_frames: Camera frames about which the run says nothing: their lights are misses.
    """

    drive: Drive
    truth: dict[tuple[str, int], TruthFrame]
    estimates: tuple[EstimateSet, ...]
    variants: dict[Variant, VariantOutcomes]
    info: dict[str, Any]
    poses: PoseBuffer
    posed_frames: frozenset[tuple[str, int]]
    skipped_frames: int
    unanswered_frames: int


def gather_outcomes(run_dir: Path, drive_dir: Path, signals: SignalSet) -> RunOutcomes:
    """Hold a run's estimates against the truth of its drive.

    Raises:
        DataError: If the drive has no truth, the run holds no known variant or is one over another drive, or a file
            breaks its format.
    """
    drive = Drive.load(drive_dir, signals)
    if not drive.truth_path.is_file():
        raise DataError(f"{drive.truth_path}: no such file; only a drive with truth can be evaluated")
    info = load_run_info(run_dir)
    # The run keeps the path of its drive; the folder may have been moved or renamed since, but hardly both.
    if Path(info["drive"]).name not in (drive.name, drive_dir.name):
        raise DataError(f"{run_dir / RUN}: is a run over drive '{info['drive']}', not over '{drive.name}'")
    sets = load_estimates(run_dir / ESTIMATES)
    for name in {light.class_name for entry in sets for light in entry.lights} - set(signals.class_ids):
        raise DataError(
            f"{run_dir / ESTIMATES}: reports the class '{name}', which signal description '{signals.name}' does not "
            "know; was it run with another one?"
        )
    truth = {(frame.camera, frame.stamp_ns): frame for frame in load_truth(drive.truth_path)}
    outcomes = hold_against_truth(drive, truth, sets, signals, info)
    if not outcomes.variants:
        raise DataError(f"{run_dir / ESTIMATES}: holds no estimates of {', '.join(VARIANTS)}")
    return outcomes


def hold_against_truth(
    drive: Drive,
    truth: dict[tuple[str, int], TruthFrame],
    sets: Sequence[EstimateSet],
    signals: SignalSet,
    info: dict[str, Any],
) -> RunOutcomes:
    """Hold estimates against truth, wherever both come from.

    Args:
        drive: Cameras and poses decide what is in view.
        truth: By (camera, stamp_ns).
        sets: What was said.
        signals: The signal description.
        info: As in ``run.json``.

    Raises:
        DataError: If the truth names a camera or a class that is not known.
    """
    scene = _Scene(drive, signals, truth)
    variants: dict[Variant, VariantOutcomes] = {}
    unanswered = 0
    for variant in VARIANTS:
        of_variant = [entry for entry in sets if entry.variant == variant]
        if of_variant:
            variants[variant], unanswered = _variant_outcomes(scene, variant, of_variant)
    return RunOutcomes(
        drive=drive,
        truth=truth,
        estimates=tuple(sets),
        variants=variants,
        info=info,
        poses=scene.poses,
        posed_frames=frozenset(scene.labelled),
        skipped_frames=len(truth) - len(scene.labelled),
        unanswered_frames=unanswered,
    )


class _Scene:
    """The truth of a drive, prepared for questions.

    Attributes:
        labelled: By camera frame: the lights in view, which count.
        others: By camera frame: the rest of the truth, which excuses a report but does not demand one.
        lights: Every light of the drive once; lights do not move.
        poses: Of the vehicle.
    """

    def __init__(self, drive: Drive, signals: SignalSet, truth: dict[tuple[str, int], TruthFrame]) -> None:
        self.name = drive.name
        self.labelled: dict[tuple[str, int], list[TruthLight]] = {}
        self.others: dict[tuple[str, int], list[TruthLight]] = {}
        self.lights: dict[str, TruthLight] = {}
        self.poses = drive.pose_buffer()
        for key, frame in truth.items():
            if frame.camera not in drive.cameras:
                raise DataError(f"{drive.truth_path}: unknown camera '{frame.camera}'")
            self.lights |= {light.truth_id: light for light in frame.lights}
            for light in frame.lights:
                if light.class_name not in signals.class_ids:
                    raise DataError(
                        f"{drive.truth_path}: light '{light.truth_id}' at {frame.stamp_ns} has the class "
                        f"'{light.class_name}', which signal description '{signals.name}' does not know"
                    )
            try:
                pose = self.poses.at(frame.stamp_ns)
            except PoseError:
                continue
            self.labelled[key] = lights_in_view(frame.lights, drive.cameras[frame.camera], pose)
            counted = {light.truth_id for light in self.labelled[key]}
            self.others[key] = [light for light in frame.lights if light.truth_id not in counted]
        self.map_ids = frozenset(light.map_id for light in self.lights.values() if light.map_id is not None)


def _variant_outcomes(scene: _Scene, variant: Variant, sets: Sequence[EstimateSet]) -> tuple[VariantOutcomes, int]:
    """Rows of a variant, and the number of camera frames with labelled lights about which it says nothing."""
    rows = VariantOutcomes()
    answered: set[tuple[str, int]] = set()
    for entry in sets:
        frames = [frame for frame in entry.frames if frame in scene.labelled]
        answered.update(frames)
        if variant == "full":  # a track speaks for the light, whichever camera sees it
            _score_lights(scene, rows, frames, entry.lights)
            continue
        for frame in frames:
            seen = [light for light in entry.lights if any((v.camera, v.stamp_ns) == frame for v in light.views)]
            if variant == "od":
                _score_boxes(scene, rows, frame, seen)
            else:
                _score_lights(scene, rows, [frame], seen)
    unanswered = [frame for frame in scene.labelled if frame not in answered]
    for frame in unanswered:
        rows.outcomes += _rows(scene, frame, {}, ())
    rows.outcomes.sort(key=lambda row: (row.stamp_ns, row.camera))
    return rows, len(unanswered)


def _score_boxes(
    scene: _Scene, rows: VariantOutcomes, frame: tuple[str, int], estimates: Sequence[LightEstimate]
) -> None:
    boxes = np.array([_box_in(estimate, frame) for estimate in estimates]).reshape(-1, 4)
    matches = match_seen_boxes(_boxes(scene.labelled[frame]), boxes)
    rows.outcomes += _rows(scene, frame, matches, estimates)
    left = [j for j in range(len(estimates)) if j not in matches.values()]
    excused = match_seen_boxes(_boxes(scene.others[frame]), boxes[left])
    _add_false(scene, rows, frame[1], [estimates[j] for i, j in enumerate(left) if i not in excused.values()])


def _score_lights(
    scene: _Scene, rows: VariantOutcomes, frames: Sequence[tuple[str, int]], estimates: Sequence[LightEstimate]
) -> None:
    matched_lights: set[str] = set()
    matched_estimates: set[int] = set()
    ordered = sorted(frames, key=lambda frame: frame[1])
    latest = {light.truth_id: light for frame in ordered for light in (*scene.labelled[frame], *scene.others[frame])}
    for frame in ordered:
        labelled = scene.labelled[frame]
        matches = match_lights(labelled, estimates, scene.map_ids)
        rows.outcomes += _rows(scene, frame, matches, estimates, latest)
        matched_lights |= {labelled[i].truth_id for i in matches}
        matched_estimates |= set(matches.values())
    if not frames:
        return
    left = [estimate for j, estimate in enumerate(estimates) if j not in matched_estimates]
    elsewhere = [light for light in scene.lights.values() if light.truth_id not in matched_lights]
    excused = set(match_lights(elsewhere, left, scene.map_ids).values())
    stamp_ns = max(stamp_ns for _, stamp_ns in frames)
    _add_false(scene, rows, stamp_ns, [estimate for j, estimate in enumerate(left) if j not in excused])


def _as_in(light: TruthLight, latest: TruthLight) -> TruthLight:
    """A light with the state that it has in the set's latest image of it: the set speaks of that instant."""
    if light.class_name == latest.class_name and light.flashing == latest.flashing:
        return light
    return replace(light, class_name=latest.class_name, lit_class=latest.lit_class, flashing=latest.flashing)


def _rows(
    scene: _Scene,
    frame: tuple[str, int],
    matches: dict[int, int],
    estimates: Sequence[LightEstimate],
    latest: Mapping[str, TruthLight] | None = None,
) -> list[LightOutcome]:
    camera, stamp_ns = frame
    labelled = scene.labelled[frame]
    truths = labelled if latest is None else [_as_in(light, latest[light.truth_id]) for light in labelled]
    return [
        LightOutcome(scene.name, camera, stamp_ns, light, estimates[matches[i]] if i in matches else None)
        for i, light in enumerate(truths)
    ]


def _add_false(scene: _Scene, rows: VariantOutcomes, stamp_ns: int, estimates: Sequence[LightEstimate]) -> None:
    rows.false_reports += [FalseReport(scene.name, stamp_ns, e) for e in estimates if not e.withheld]


def _boxes(lights: Sequence[TruthLight]) -> FloatArray:
    return np.array([light.box_xyxy for light in lights], dtype=np.float64).reshape(-1, 4)


def _box_in(estimate: LightEstimate, frame: tuple[str, int]) -> tuple[float, float, float, float]:
    for view in estimate.views:
        if (view.camera, view.stamp_ns) == frame and view.box_xyxy is not None:
            return view.box_xyxy
    return (0.0, 0.0, 0.0, 0.0)  # overlaps nothing
