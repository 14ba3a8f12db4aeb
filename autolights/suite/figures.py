"""The figures of the suite, each with its count, and with its confidence where that matters."""

from typing import Self

import numpy as np
from scipy.special import betaincinv

from autolights.core import Config, FloatArray
from autolights.evaluate.score import Share
from autolights.suite.measures import Tally

CONFIDENCE = 0.95


class Spread(Config):
    """Numbers in short; None where there are none."""

    count: int
    mean: float | None
    median: float | None
    p95: float | None
    p99: float | None
    worst: float | None

    @classmethod
    def of(cls, values: FloatArray) -> Self:
        """The spread of (n,) values."""
        if not len(values):
            return cls(count=0, mean=None, median=None, p95=None, p99=None, worst=None)
        median, p95, p99 = (float(value) for value in np.percentile(values, [50, 95, 99]))
        return cls(
            count=len(values), mean=float(values.mean()), median=median, p95=p95, p99=p99, worst=float(values.max())
        )


class Figures(Config):
    """What one pipeline did on one scenario, or on several; see `Tally` for what is counted.

    Attributes:
        accuracy: Right class, of all lights in view; a miss is wrong.
        settled: The same without the set of first sight and the first set of each new state.
        unsafe: Go reported to a movement that has been shown stop.
        unsafe_bound: Upper limit of that share at 95 % confidence, as if frames were independent.
        unsafe_stretches: Stretches of one light in one camera in which that happened.
        withheld: Of the visible lights.
        missed: Of the visible lights, withheld or not reported.
        flickers: Changes of reports that the truth does not have.
        light_minutes: Time of lights in view, over all cameras.
        transition_frames: From a visible change to its report.
        transition_never: Changes that were over before they were reported.
        onset_s: From the onset of a flash to its report as flashing.
        onset_never: Flashes that were never reported.
        false_flashes: Reports of flashing where nothing flashes.
        steady_hours: Time of lights that did not flash, in view of any camera.
        false_reports: Reports of lights that do not exist.
        sets: Sets of frames.
        pairing: Detections held for the right light.
        plain_pairing: The same by plain distances and one threshold in pixels.
        map_error_m: Of map lights after 15 m travelled in view.
        survey_error_m: Of the map itself, the same lights.
        far_error_m: Of lights that the map lacks, 38 to 42 m ahead.
        near_error_m: The same below 20 m.
        step_ms: Fusion and tracking of one set.
        skipped: Frames that the pipeline left out.
    """

    accuracy: Share
    settled: Share
    unsafe: Share
    unsafe_bound: float | None
    unsafe_stretches: int
    withheld: Share
    missed: Share
    flickers: int
    light_minutes: float
    transition_frames: Spread
    transition_never: int
    onset_s: Spread
    onset_never: int
    false_flashes: int
    steady_hours: float
    false_reports: int
    sets: int
    pairing: Share
    plain_pairing: Share
    map_error_m: Spread
    survey_error_m: Spread
    far_error_m: Spread
    near_error_m: Spread
    step_ms: Spread
    skipped: int

    @property
    def flickers_per_minute(self) -> float | None:
        """Per minute of one light in view of one camera."""
        return self.flickers / self.light_minutes if self.light_minutes else None

    @property
    def false_flashes_per_hour(self) -> float | None:
        """Per hour of one light in view."""
        return self.false_flashes / self.steady_hours if self.steady_hours else None

    @property
    def false_reports_per_set(self) -> float | None:
        """Reports of nothing in one set of frames."""
        return self.false_reports / self.sets if self.sets else None


def figures(counts: Tally) -> Figures:
    """The figures of a tally."""
    return Figures(
        accuracy=Share(count=counts.right, total=counts.rows),
        settled=Share(count=counts.settled_right, total=counts.settled),
        unsafe=Share(count=counts.unsafe, total=counts.unsafe_possible),
        unsafe_bound=upper_bound(counts.unsafe, counts.unsafe_possible),
        unsafe_stretches=counts.unsafe_stretches,
        withheld=Share(count=counts.visible_withheld, total=counts.visible),
        missed=Share(count=counts.visible_missed, total=counts.visible),
        flickers=counts.flickers,
        light_minutes=counts.light_s / 60,
        transition_frames=Spread.of(counts.transition_frames),
        transition_never=counts.transition_never,
        onset_s=Spread.of(counts.onset_s),
        onset_never=counts.onset_never,
        false_flashes=counts.false_flashes,
        steady_hours=counts.steady_s / 3600,
        false_reports=counts.false_reports,
        sets=counts.sets,
        pairing=Share(count=counts.paired_right, total=counts.paired_right + counts.paired_wrong),
        plain_pairing=Share(count=counts.plain_right, total=counts.plain_right + counts.plain_wrong),
        map_error_m=Spread.of(counts.map_error_m),
        survey_error_m=Spread.of(counts.survey_error_m),
        far_error_m=Spread.of(counts.far_error_m),
        near_error_m=Spread.of(counts.near_error_m),
        step_ms=Spread.of(counts.step_ms),
        skipped=counts.skipped,
    )


def upper_bound(count: int, total: int, confidence: float = CONFIDENCE) -> float | None:
    """One-sided upper limit of a share of which `count` of `total` were seen (Clopper and Pearson 1934).

    Of none in n at 95 % it is 1 − 0.05^(1/n) ≈ 3 / n, the rule of three.
    """
    if total == 0:
        return None
    return 1.0 if count == total else float(betaincinv(count + 1, total - count, confidence))
