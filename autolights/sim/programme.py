"""Signal programmes: which class each type of head shows when, with legal timing."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from autolights.core import SignalSet
from autolights.core.errors import UsageError

Phase = Literal["left", "left_clearance", "all_red", "through", "through_clearance", "crossing"]

PHASES: tuple[Phase, ...] = ("left", "left_clearance", "all_red", "through", "through_clearance", "crossing")
FLASHING = "flashing"
# What our approach sees in each phase. The left turn first has the right of way, then may turn in gaps on the flashing
# arrow while the through traffic runs, and ends with it on the steady yellow arrow.
SHOWN: dict[str, dict[Phase, str]] = {
    "3": {
        "left": "3-red",
        "left_clearance": "3-red",
        "all_red": "3-red",
        "through": "3-green",
        "through_clearance": "3-yellow",
        "crossing": "3-red",
    },
    "4": {
        "left": "4-gleft",
        "left_clearance": "4-yleft1",
        "all_red": "4-rleft",
        "through": FLASHING,
        "through_clearance": "4-yleft1",
        "crossing": "4-rleft",
    },
    "5dh": {
        "left": "5dh-red-gleft",
        "left_clearance": "5dh-red-yleft",
        "all_red": "5dh-red",
        "through": "5dh-green",
        "through_clearance": "5dh-yellow",
        "crossing": "5dh-red",
    },
}


@dataclass(frozen=True)
class Indication:
    """What a head shows at one instant.

    Attributes:
        lit_class: The class of what is physically lit; the dark phase of a flash has its own.
        class_name: What is reported: a flash is one class in both phases.
        flashing: It belongs to a flash.
    """

    lit_class: str
    class_name: str
    flashing: bool


@dataclass(frozen=True)
class Programme:
    """The signal controller of a junction: one cycle, repeated.

    Attributes:
        durations_s: Of each phase, in the order of `PHASES`.
        through_start_s: An instant at which the through phase begins.
        flash_period_s: Of the flashing arrow; it starts lit with its phase.
        flash_on_s: How long it is lit in each period.

    Raises:
        UsageError: If a clearance is not 3 to 6 s, or a flash is not 1.0 to 1.2 s long and lit for 1/2 to 2/3 of it.

    References:
        MUTCD 11th ed. §4F.17 (yellow change 3 to 6 s) and §4G.01 (flash rate and duty).
    """

    durations_s: tuple[float, float, float, float, float, float]
    through_start_s: float
    flash_period_s: float
    flash_on_s: float

    def __post_init__(self) -> None:
        for phase in ("left_clearance", "through_clearance"):
            duration = self.durations_s[PHASES.index(phase)]
            if not 3 <= duration <= 6:
                raise UsageError(f"programme: {phase} must last 3 to 6 s, got {duration}")
        ratio = self.flash_on_s / self.flash_period_s
        if not (1.0 <= self.flash_period_s <= 1.2 and 1 / 2 <= ratio <= 2 / 3):
            raise UsageError(
                f"programme: a flash must last 1.0 to 1.2 s and be lit 1/2 to 2/3 of it, "
                f"got {self.flash_period_s} s lit for {self.flash_on_s} s"
            )

    @property
    def cycle_s(self) -> float:
        """Length of the cycle."""
        return sum(self.durations_s)

    def phase_at(self, time_s: float) -> tuple[Phase, float, float]:
        """The phase at an instant, the seconds since it began and the seconds until it ends."""
        before_through = sum(self.durations_s[: PHASES.index("through")])
        elapsed = (time_s - self.through_start_s + before_through) % self.cycle_s
        for phase, duration in zip(PHASES, self.durations_s, strict=True):
            if elapsed < duration:
                return phase, elapsed, duration - elapsed
            elapsed -= duration
        return PHASES[-1], self.durations_s[-1], 0.0

    def show(self, type_name: str, time_s: float, signals: SignalSet) -> Indication:
        """What a head of this type shows."""
        phase, elapsed, _ = self.phase_at(time_s)
        shown = SHOWN[type_name][phase]
        if shown != FLASHING:
            return Indication(shown, shown, flashing=False)
        pair = signals.types[type_name].flashing[0]
        lit = elapsed % self.flash_period_s < self.flash_on_s
        return Indication(pair.on if lit else pair.off, pair.reported, flashing=True)


def draw_programme(through_start_s: float, rng: np.random.Generator) -> Programme:
    """A programme as short as a lightly used actuated junction's, so that a short drive sees it change."""
    period = float(rng.uniform(1.0, 1.2))
    durations = (
        float(rng.uniform(3.8, 4.8)),
        float(rng.uniform(3.0, 3.3)),
        1.0,
        float(rng.uniform(7.0, 8.5)),
        float(rng.uniform(3.0, 3.6)),
        float(rng.uniform(6.5, 8.0)),
    )
    return Programme(durations, through_start_s, period, period * float(rng.uniform(0.52, 0.64)))


def check_types(signals: SignalSet) -> None:
    """Raise unless the programmes know every type and class of the description.

    Raises:
        UsageError: If a type or class is unknown.
    """
    for name, light_type in signals.types.items():
        wanted = set(SHOWN.get(name, {}).values()) - {FLASHING}
        if not wanted or not wanted <= set(light_type.states):
            raise UsageError(
                f"signals '{signals.name}': the simulator has no programme for type '{name}'; it knows {sorted(SHOWN)} "
                "as in signals/autolights_13"
            )
