"""The suite's figures of trackers whose virtues and vices are known."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy.stats

from autolights.core import CameraView, LightEstimate
from autolights.data import EstimateSet, TruthLight
from autolights.evaluate.outcomes import hold_against_truth
from autolights.suite import SuiteConfig
from autolights.suite.drives import SuiteDrive, build_drive
from autolights.suite.figures import figures, upper_bound
from autolights.suite.measures import Tally, false_flashes, merged_stretches, tally
from autolights.suite.run import DriveRun, Pairing


@pytest.fixture(scope="module")
def drive(suite: SuiteConfig) -> SuiteDrive:
    longer = suite.scenarios["plain"].model_copy(update={"duration_s": 40.0, "occlusions_per_minute": 0.0})
    # Both cameras expose at the same instant, so that they have the same truth.
    cameras = tuple(camera.model_copy(update={"stamp_offset_ms": 0.0}) for camera in suite.cameras)
    changes = {"scenarios": {"plain": longer}, "cameras": cameras, "stamp_jitter_ms": 0.0}
    return build_drive(suite.model_copy(update=changes), "plain", 0)


def say(light: TruthLight, stamp_ns: int, frames: Sequence[tuple[str, int]]) -> LightEstimate:
    """The truth as a report."""
    return LightEstimate(
        stamp_ns=stamp_ns,
        track_id=int("".join(c for c in light.truth_id if c.isdigit())),
        map_id=light.map_id,
        type=light.type,
        class_name=light.class_name,
        probability=0.9,
        flashing=light.flashing,
        withheld=False,
        position=light.position,
        covariance=None,
        distance_m=30.0,
        last_seen_ns=stamp_ns,
        views=tuple(CameraView(camera, stamp, None) for camera, stamp in frames),
    )


def follow(drive: SuiteDrive, change: Callable[[LightEstimate], LightEstimate | None], *, late_sets: int = 0) -> Tally:
    """Tally of `run_of`."""
    return tally(run_of(drive, change, late_sets=late_sets))


def run_of(drive: SuiteDrive, change: Callable[[LightEstimate], LightEstimate | None], *, late_sets: int) -> DriveRun:
    """The run of a tracker that knows the truth of `late_sets` ago and changes what it says by a rule."""
    truths = []
    for frames in drive.sets:
        keys = tuple((frame.camera, frame.stamp_ns) for frame in frames)
        truths.append((keys, {light.truth_id: light for key in keys for light in drive.truth[key].lights}))
    sets = []
    for i, (keys, _) in enumerate(truths):
        stamp_ns = max(stamp for _, stamp in keys)
        known = truths[max(i - late_sets, 0)][1]
        reports = (change(say(light, stamp_ns, keys)) for light in known.values())
        sets.append(EstimateSet(stamp_ns, "full", keys, tuple(r for r in reports if r is not None)))
    outcomes = hold_against_truth(drive.true_drive, drive.truth, sets, drive.signals, {})
    return DriveRun(drive, outcomes, (1.0,) * len(sets), Pairing(3, 1), Pairing(1, 1), {"late": 2})


def test_who_knows_the_truth_reaches_everything(drive: SuiteDrive) -> None:
    of = figures(follow(drive, lambda report: report))
    assert of.accuracy.percent == of.settled.percent == 100
    assert of.accuracy.total > of.settled.total > 1000
    assert of.unsafe.count == of.withheld.count == of.missed.count == of.flickers == of.false_flashes == 0
    assert of.unsafe.total > 500
    assert of.transition_frames.worst == 0
    assert of.transition_frames.count > 10
    assert of.onset_s.worst == 0
    assert of.map_error_m.worst == pytest.approx(0)
    assert 0.1 < (of.survey_error_m.mean or 0) < 0.25  # 0.1 m per axis
    assert of.pairing.percent == 75
    assert of.plain_pairing.percent == 50
    assert of.skipped == 2


def test_a_set_is_held_against_its_latest_image(suite: SuiteConfig) -> None:
    """The second camera exposes 60 ms later; what changes in between is news that the set already has."""
    longer = suite.scenarios["plain"].model_copy(update={"duration_s": 40.0, "occlusions_per_minute": 0.0})
    cameras = tuple(camera.model_copy(update={"stamp_offset_ms": 60.0 * i}) for i, camera in enumerate(suite.cameras))
    changes = {"scenarios": {"plain": longer}, "cameras": cameras, "stamp_jitter_ms": 0.0}
    drive = build_drive(suite.model_copy(update=changes), "plain", 0)
    between = 0
    for frames in drive.sets:
        first, second = ({light.truth_id: light for light in drive.truth[f.camera, f.stamp_ns].lights} for f in frames)
        between += sum(first[name].class_name != second[name].class_name for name in first.keys() & second.keys())

    of = figures(follow(drive, lambda report: report))

    assert between > 0
    assert of.accuracy.percent == 100
    assert of.unsafe.count == of.flickers == 0


def test_one_set_late_costs_one_frame(drive: SuiteDrive) -> None:
    of = figures(follow(drive, lambda report: report, late_sets=1))
    assert of.transition_frames.median == of.transition_frames.p95 == 1
    assert of.settled.percent == 100
    assert of.accuracy.percent is not None
    assert 95 < of.accuracy.percent < 100


def test_go_for_stop_is_unsafe(drive: SuiteDrive) -> None:
    def reckless(report: LightEstimate) -> LightEstimate:
        return replace(report, class_name="3-green") if report.class_name == "3-red" else report

    honest, of = follow(drive, lambda report: report), follow(drive, reckless)
    assert of.unsafe_possible == honest.unsafe_possible
    assert of.unsafe > 300
    assert of.unsafe_stretches > 3
    assert of.right < honest.right - of.unsafe


def test_withheld_is_missed_and_not_unsafe(drive: SuiteDrive) -> None:
    of = figures(follow(drive, lambda report: replace(report, withheld=True, class_name="3-green")))
    assert of.withheld.percent == of.missed.percent == 100
    assert of.unsafe.count == 0
    assert of.accuracy.count == 0


def test_calling_everything_flashing(drive: SuiteDrive) -> None:
    of = figures(follow(drive, lambda report: replace(report, flashing=True)))
    lights = {light.truth_id for frame in drive.truth.values() for light in frame.lights}
    assert len(lights) / 3 < of.false_flashes < 2 * len(lights)
    assert of.steady_hours > 0.02


def test_a_flash_that_ended_out_of_view_is_excused_like_any_other(drive: SuiteDrive) -> None:
    """Truth begins at its range; the track was there before."""
    run = run_of(drive, lambda report: replace(report, flashing=True), late_sets=0)
    (outcomes,) = run.outcomes.variants.values()
    stretch = next(s for s in merged_stretches(outcomes.outcomes) if not any(row.truth.flashing for row in s))
    start_ns = stretch[0].stamp_ns

    assert false_flashes(stretch)[0] == 1
    assert false_flashes(stretch, [start_ns - 10**8])[0] == 1, "it goes on for too long"
    short = [row for row in stretch if row.stamp_ns < start_ns + 10**9]
    assert false_flashes(short)[0] == 1
    assert false_flashes(short, [start_ns - 10**8])[0] == 0
    assert false_flashes(short, [start_ns - 2 * 10**9])[0] == 1


def test_flashes_end_where_the_truth_says(drive: SuiteDrive) -> None:
    """In view, what the programme knows and what the rows show is one."""
    ends = 0
    (outcomes,) = run_of(drive, lambda report: report, late_sets=0).outcomes.variants.values()
    for stretch in merged_stretches(outcomes.outcomes):
        for before, row in pairwise(stretch):
            if before.truth.flashing and not row.truth.flashing:
                ends_ns = drive.flash_ends_ns[row.truth.truth_id]
                assert ((ends_ns > before.stamp_ns - 10**7) & (ends_ns <= row.stamp_ns + 10**7)).any()
                ends += 1
    assert ends > 0


def test_flicker_is_counted(drive: SuiteDrive) -> None:
    def nervous(report: LightEstimate) -> LightEstimate:
        every_other = round(report.stamp_ns / 1e8) % 2
        return replace(report, class_name="3-yellow") if every_other and report.type == "3" else report

    of = figures(follow(drive, nervous))
    assert of.flickers_per_minute is not None
    assert of.flickers_per_minute > 100


def test_positions_off_by_a_metre(drive: SuiteDrive) -> None:
    of = figures(follow(drive, lambda r: replace(r, position=r.position + np.array([0.6, 0, 0.8]))))
    assert of.map_error_m.mean == pytest.approx(1.0)


def test_tallies_add_up(drive: SuiteDrive) -> None:
    one = follow(drive, lambda report: report, late_sets=1)
    two = one + one
    assert two.rows == 2 * one.rows
    assert len(two.transition_frames) == 2 * len(one.transition_frames)
    assert figures(two).accuracy.percent == figures(one).accuracy.percent
    assert figures(Tally()).accuracy.percent is None


@pytest.mark.parametrize(("count", "total"), [(0, 100_000), (3, 500), (7, 8)])
def test_the_bound_is_that_of_clopper_and_pearson(count: int, total: int) -> None:
    bound = upper_bound(count, total)
    assert bound is not None
    # At the bound, so few or fewer are seen in one of twenty cases.
    assert scipy.stats.binom.cdf(count, total, bound) == pytest.approx(0.05)


def test_bounds_of_nothing_and_of_all() -> None:
    assert upper_bound(0, 0) is None
    assert upper_bound(4, 4) == 1.0
    assert upper_bound(0, 100_000) == pytest.approx(3 / 100_000, rel=0.01)
