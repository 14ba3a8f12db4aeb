"""What one pipeline did on one drive, counted from the rows that `evaluate` makes; counts of drives add up."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from autolights.core import FloatArray, IntArray
from autolights.evaluate.outcomes import LightOutcome
from autolights.evaluate.timelines import (
    MAX_GAP_S,
    Delay,
    duration_s,
    flash_onset_delays,
    flicker_count,
    timelines,
    transition_delays,
    unsafe_frames,
)
from autolights.suite.run import DriveRun

_SAME_SET_S = 0.01  # frames of one set are closer than this
_FLASH_ENDS_S = 1.3  # so long after a flash it may still be reported: the longest legal cycle and a frame
_SEEN_ON_WAY_M = 15.0
_FAR_M, _NEAR_M = (38.0, 42.0), 20.0


@dataclass(frozen=True, eq=False)
class Tally:
    """Counts and lists of one or several drives; two tallies add up.

    Attributes:
        sets: Sets of frames.
        rows: Labelled lights in view, over all camera frames.
        right: Those reported with the right class; a miss is wrong.
        settled: Those without the set of first sight and the first set of each new state.
        settled_right: Right ones of these.
        visible: Those of which at most half is hidden.
        visible_withheld: Of these.
        visible_missed: Of these, not reported or withheld.
        unsafe: Rows that say go to a movement that has been shown stop.
        unsafe_possible: Rows in which that was possible.
        unsafe_stretches: Stretches of one light in one camera with such a row.
        flickers: Changes of reports that the truth does not have.
        light_s: Seconds of lights in view, over all cameras.
        transition_frames: From each visible change to its report.
        transition_never: Changes that were over before they were reported.
        onset_s: From the onset of each flash to its report as flashing.
        onset_never: Flashes that were never reported.
        false_flashes: Beginnings of a report of flashing where nothing flashes, per light, not per camera.
        steady_s: Seconds in which a light was in view of any camera and did not flash.
        false_reports: Reports of lights that do not exist.
        paired_right: Detections behind reports of map lights that show that light.
        paired_wrong: Those that show another light, a look-alike or nothing.
        plain_right: The same of plain distances and one threshold in pixels.
        plain_wrong: The same.
        map_error_m: Of reported positions of map lights after 15 m travelled in view.
        survey_error_m: Of the map itself, the same lights.
        far_error_m: Of lights that the map lacks, 38 to 42 m ahead.
        near_error_m: The same below 20 m.
        step_ms: Fusion and tracking of each set.
        skipped: Frames that the pipeline left out.
    """

    sets: int = 0
    rows: int = 0
    right: int = 0
    settled: int = 0
    settled_right: int = 0
    visible: int = 0
    visible_withheld: int = 0
    visible_missed: int = 0
    unsafe: int = 0
    unsafe_possible: int = 0
    unsafe_stretches: int = 0
    flickers: int = 0
    light_s: float = 0.0
    transition_frames: FloatArray = field(default_factory=lambda: np.empty(0))
    transition_never: int = 0
    onset_s: FloatArray = field(default_factory=lambda: np.empty(0))
    onset_never: int = 0
    false_flashes: int = 0
    steady_s: float = 0.0
    false_reports: int = 0
    paired_right: int = 0
    paired_wrong: int = 0
    plain_right: int = 0
    plain_wrong: int = 0
    map_error_m: FloatArray = field(default_factory=lambda: np.empty(0))
    survey_error_m: FloatArray = field(default_factory=lambda: np.empty(0))
    far_error_m: FloatArray = field(default_factory=lambda: np.empty(0))
    near_error_m: FloatArray = field(default_factory=lambda: np.empty(0))
    step_ms: FloatArray = field(default_factory=lambda: np.empty(0))
    skipped: int = 0

    def __add__(self, other: "Tally") -> "Tally":
        def both(name: str) -> object:
            mine, others = getattr(self, name), getattr(other, name)
            return np.concatenate([mine, others]) if isinstance(mine, np.ndarray) else mine + others

        return Tally(**{entry.name: both(entry.name) for entry in fields(self)})  # type: ignore[arg-type]


def tally(run: DriveRun) -> Tally:
    """Count everything of one pipeline on one drive."""
    (rows,) = run.outcomes.variants.values()
    stretches = timelines(rows.outcomes)
    visible = [row for row in rows.outcomes if row.visible]
    settled = settled_rows(rows.outcomes)
    unsafe = [unsafe_frames(stretch, run.drive.signals) for stretch in stretches]
    transitions = [delay for stretch in stretches for delay in transition_delays(stretch)]
    onsets = [delay for stretch in stretches for delay in flash_onset_delays(stretch)]
    false = [
        false_flashes(stretch, run.drive.flash_ends_ns.get(stretch[0].truth.truth_id, ()))
        for stretch in merged_stretches(rows.outcomes)
    ]
    map_error_m, survey_error_m, far_error_m, near_error_m = _position_errors(run, rows.outcomes)
    return Tally(
        sets=len(run.step_ms),
        rows=len(rows.outcomes),
        right=sum(row.correct for row in rows.outcomes),
        settled=len(settled),
        settled_right=sum(row.correct for row in settled),
        visible=len(visible),
        visible_withheld=sum(row.withheld for row in visible),
        visible_missed=sum(row.reported_class is None for row in visible),
        unsafe=sum(len(found) for found, _ in unsafe),
        unsafe_possible=sum(possible for _, possible in unsafe),
        unsafe_stretches=sum(bool(found) for found, _ in unsafe),
        flickers=sum(flicker_count(stretch) for stretch in stretches),
        light_s=sum(duration_s(stretch) for stretch in stretches),
        transition_frames=_known(delay.frames for delay in transitions),
        transition_never=_never(transitions),
        onset_s=_known(delay.seconds for delay in onsets),
        onset_never=_never(onsets),
        false_flashes=sum(count for count, _ in false),
        steady_s=sum(steady_s for _, steady_s in false),
        false_reports=len(rows.false_reports),
        paired_right=run.pairing.right,
        paired_wrong=run.pairing.wrong,
        plain_right=run.plain_pairing.right,
        plain_wrong=run.plain_pairing.wrong,
        map_error_m=map_error_m,
        survey_error_m=survey_error_m,
        far_error_m=far_error_m,
        near_error_m=near_error_m,
        step_ms=np.array(run.step_ms),
        skipped=sum(run.skipped.values()),
    )


def settled_rows(rows: Iterable[LightOutcome]) -> list[LightOutcome]:
    """Rows without those of the set in which a light comes into view, or in which its state is new."""
    kept = []
    for stretch in merged_stretches(rows):
        new_ns = stretch[0].stamp_ns
        for before, row in zip([stretch[0], *stretch], stretch, strict=False):
            if row.truth.class_name != before.truth.class_name:
                new_ns = row.stamp_ns
            if row.stamp_ns - new_ns > _SAME_SET_S * 1e9:
                kept.append(row)
    return kept


def merged_stretches(rows: Iterable[LightOutcome]) -> list[list[LightOutcome]]:
    """Each light's rows of all cameras in the order of time, cut where it is out of view for more than a second."""
    by_light: dict[tuple[str, str], list[LightOutcome]] = defaultdict(list)
    for row in rows:
        by_light[row.drive, row.truth.truth_id].append(row)
    stretches: list[list[LightOutcome]] = []
    for of_light in by_light.values():
        of_light.sort(key=lambda row: row.stamp_ns)
        stamps = np.array([row.stamp_ns for row in of_light])
        cuts = (np.flatnonzero(np.diff(stamps) > MAX_GAP_S * 1e9) + 1).tolist()
        for start, end in zip([0, *cuts], [*cuts, len(of_light)], strict=True):
            stretches.append(of_light[start:end])
    return stretches


def false_flashes(stretch: Sequence[LightOutcome], ends_ns: Sequence[int] | IntArray = ()) -> tuple[int, float]:
    """How often a light is newly called flashing that does not flash, and for how many seconds it did not flash.

    A report that goes on after the end of a flash is excused for the longest legal cycle; then it is a false one.

    Args:
        stretch: One light's rows in the order of time.
        ends_ns: When its flashes ended, those that ended out of view too: truth has no rows there, tracks do.
    """
    count, steady_s, called = 0, 0.0, False
    flashed_ns: int | None = None
    for before, row in zip([stretch[0], *stretch], stretch, strict=False):
        if row.truth.flashing:
            flashed_ns = row.stamp_ns
        else:
            steady_s += (row.stamp_ns - before.stamp_ns) / 1e9
        calls = row.estimate is not None and not row.withheld and row.estimate.flashing
        if calls:
            flashed = [end for end in (*ends_ns, flashed_ns) if end is not None and end <= row.stamp_ns]
            calls = not flashed or row.stamp_ns - max(flashed) > _FLASH_ENDS_S * 1e9
        count += calls and not called
        called = calls
    return count, steady_s


def _position_errors(
    run: DriveRun, rows: Iterable[LightOutcome]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Metres: of map lights seen over 15 m of way, of the map itself, and of lights that it lacks, far and near."""
    poses = run.drive.true_drive.pose_buffer()
    places = {row.stamp_ns: poses.at(row.stamp_ns).position for row in rows}
    mapped, surveyed, far, near = [], [], [], []
    for stretch in merged_stretches(rows):
        way_m, last = 0.0, places[stretch[0].stamp_ns]
        for row in stretch:
            here = places[row.stamp_ns]
            way_m, last = way_m + float(np.linalg.norm(here - last)), here
            if row.error_m is None or row.estimate is None:
                continue
            if row.truth.map_id is None:
                distance_m = float(np.linalg.norm(here - row.truth.position))
                if _FAR_M[0] <= distance_m <= _FAR_M[1]:
                    far.append(row.error_m)
                elif distance_m < _NEAR_M:
                    near.append(row.error_m)
            elif way_m >= _SEEN_ON_WAY_M and row.estimate.map_id == row.truth.map_id:
                mapped.append(row.error_m)
                surveyed.append(float(np.linalg.norm(run.drive.map_positions[row.truth.map_id] - row.truth.position)))
    return np.array(mapped), np.array(surveyed), np.array(far), np.array(near)


def _known(values: Iterable[float | None]) -> FloatArray:
    return np.array([value for value in values if value is not None], dtype=np.float64)


def _never(delays: Sequence[Delay]) -> int:
    return sum(delay.seconds is None for delay in delays)
