"""One light over time, and what time reveals: how late, how restless and how dangerous the reports are."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from autolights.core import SignalSet
from autolights.evaluate.outcomes import LightOutcome

MAX_GAP_S = 1.0  # a light that is out of view for longer starts anew
STOP_SHOWN_S = 0.3  # from when on "go" is no matter of latency any more

Timeline: TypeAlias = Sequence[LightOutcome]


@dataclass(frozen=True)
class Delay:
    """How long a change took to be reported; None where it was over before that."""

    seconds: float | None
    frames: int | None


def timelines(outcomes: Iterable[LightOutcome]) -> list[Timeline]:
    """Cut rows into stretches in which one camera has one light in view without a gap of more than a second.

    Each camera has its own timelines: a light that two cameras see counts in both, as in all figures per frame.
    """
    by_light: dict[tuple[str, str, str], list[LightOutcome]] = defaultdict(list)
    for row in outcomes:
        by_light[row.drive, row.camera, row.truth.truth_id].append(row)
    stretches: list[Timeline] = []
    for rows in by_light.values():
        rows.sort(key=lambda row: row.stamp_ns)
        start = 0
        for i in range(1, len(rows) + 1):
            if i == len(rows) or _seconds(rows[i - 1], rows[i]) > MAX_GAP_S:
                stretches.append(rows[start:i])
                start = i
    return stretches


def transition_delays(timeline: Timeline) -> list[Delay]:
    """From the first frame of a new state to the first that reports it, for changes that were in plain view.

    The onset of a flash is counted apart (`flash_onset_delays`).
    """
    delays = []
    for i in range(1, len(timeline)):
        row = timeline[i]
        changed = row.truth.class_name != timeline[i - 1].truth.class_name
        if changed and row.visible and not row.truth.flashing:
            delays.append(_delay(timeline, i, [r.correct for r in timeline], [r.truth.class_name for r in timeline]))
    return delays


def flash_onset_delays(timeline: Timeline) -> list[Delay]:
    """From the first frame of a flash in plain view to the first that reports the state as flashing."""
    known = [row.correct and row.estimate is not None and row.estimate.flashing for row in timeline]
    flashing = [row.truth.flashing for row in timeline]
    return [
        _delay(timeline, i, known, flashing)
        for i in range(1, len(timeline))
        if flashing[i] and not flashing[i - 1] and timeline[i].visible
    ]


def flicker_count(timeline: Timeline) -> int:
    """Changes of the reported state that the truth does not have; misses are skipped, they are counted elsewhere.

    A change is excused if it ends in the true state and the truth has changed since the last change that was excused.
    """
    count = 0
    truth_changed = False
    last_reported: str | None = None
    for i, row in enumerate(timeline):
        truth_changed |= i > 0 and row.truth.class_name != timeline[i - 1].truth.class_name
        reported = row.reported_class
        if reported is None:
            continue
        if last_reported is None:
            truth_changed = False  # the first report follows no other, so it owes nothing to earlier changes
        elif reported != last_reported:
            if truth_changed and row.correct:
                truth_changed = False
            else:
                count += 1
        last_reported = reported
    return count


def duration_s(timeline: Timeline) -> float:
    """From the first frame to the last."""
    return _seconds(timeline[0], timeline[-1])


def unsafe_frames(timeline: Timeline, signals: SignalSet) -> tuple[list[LightOutcome], int]:
    """Frames that say "go" to a movement to which the light has shown "stop" in plain view for at least 0.3 s.

    Time in which the light is hidden does not count towards the 0.3 s, but once they are full, an occlusion is no
    excuse.

    Returns:
        The unsafe rows, and the number of rows in which an unsafe report was possible.
    """
    unsafe: list[LightOutcome] = []
    possible = 0
    stop_seen_s: dict[str, float] = {}
    for i, row in enumerate(timeline):
        before = timeline[i - 1] if i else None
        in_view_s = _seconds(before, row) if before is not None and before.visible and row.visible else 0.0
        says = signals.meanings(row.truth.class_name)
        stopping = {movement for movement, meaning in says.items() if meaning == "stop"}
        stop_seen_s = {m: stop_seen_s[m] + in_view_s if m in stop_seen_s else 0.0 for m in sorted(stopping)}
        # Sums of frame times fall short of 0.3 by rounding.
        established = [m for m, seen_s in stop_seen_s.items() if seen_s >= STOP_SHOWN_S - 1e-6]
        possible += bool(established)
        reported = row.reported_class
        reported_says = {} if reported is None else signals.meanings(reported)
        if any(reported_says.get(movement) == "go" for movement in established):
            unsafe.append(row)
    return unsafe, possible


def _delay(timeline: Timeline, start: int, reported: Sequence[bool], truth: Sequence[str | bool]) -> Delay:
    for i in range(start, len(timeline)):
        if truth[i] != truth[start]:
            break
        if reported[i]:
            return Delay(_seconds(timeline[start], timeline[i]), i - start)
    return Delay(None, None)


def _seconds(earlier: LightOutcome, later: LightOutcome) -> float:
    return (later.stamp_ns - earlier.stamp_ns) / 1e9
