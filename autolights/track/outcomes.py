"""What may be said about a light, and which of it is said: a wrong "go" is dearer than a late one."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from autolights.core import BoolArray, FloatArray, HmmParameters, IntArray, SignalSet
from autolights.track.hidden_chain import HiddenChain


class Outcome(NamedTuple):
    """One thing that can be said.

    Attributes:
        class_name: The state; a flashing pair has one name for both phases.
        flashing: Whether the indication flashes.
    """

    class_name: str
    flashing: bool


@dataclass(frozen=True, eq=False)
class Choice:
    """What is said about n lights.

    Attributes:
        outcome: (n,) index.
        probability: (n,) belief in it.
        go_held: (n,) whether something that says "go" was more probable, but not certain enough.
        doubtful: (n,) whether nothing is certain enough to act upon.
    """

    outcome: IntArray
    probability: FloatArray
    go_held: BoolArray
    doubtful: BoolArray


@dataclass(frozen=True, eq=False)
class Outcomes:
    """The outcomes of one type.

    Attributes:
        names: g outcomes.
        membership: (K, g) 1 where a hidden state belongs to an outcome.
        contradiction: (g, g) `[i, j]`: 1 where i says "go" to a movement that j tells to stop.
        denied_by: (k, g) `[c, i]`: 1 where i says "go" to a movement that class c, if it is lit, tells to stop.
        stops_flashing: (g, g) `[i, j]`: whether j is i without its flashing.
    """

    names: tuple[Outcome, ...]
    membership: FloatArray
    contradiction: FloatArray
    denied_by: FloatArray
    stops_flashing: BoolArray

    @classmethod
    def of(cls, type_name: str, signals: SignalSet, params: HmmParameters, chain: HiddenChain) -> Self:
        """The outcomes of a type.

        The dark phase is reported as its pair. A class outside of a flash keeps its name.
        """
        pairs = signals.types[type_name].flashing
        own = [
            Outcome(params.states[phase.class_index], False) if phase.pair is None
            else Outcome(pairs[phase.pair].reported, True)
            for phase in chain.phases
        ]  # fmt: skip
        names = tuple(dict.fromkeys(own))
        membership = np.array([[float(own[i] == name) for name in names] for i in chain.phase_of])
        says = [signals.meanings(name.class_name) for name in names]
        lit = [signals.meanings(name) for name in params.states]
        contradiction = np.array([[_denies(there, here) for there in says] for here in says])
        denied_by = np.array([[_denies(there, here) for here in says] for there in lit])
        stops = [[i.class_name == j.class_name and i.flashing and not j.flashing for j in names] for i in names]
        return cls(names, membership, contradiction, denied_by, np.array(stops))


def _denies(there: Mapping[str, str], here: Mapping[str, str]) -> float:
    """1 where `here` says "go" to a movement that `there` tells to stop."""
    return float(any(there.get(movement) == "stop" for movement, what in here.items() if what == "go"))


def choose(
    mass: FloatArray,
    contradiction: FloatArray,
    denied: BoolArray,
    said: IntArray,
    odds: FloatArray,
    *,
    max_go_risk: float,
    min_probability: float,
) -> Choice:
    """Choose what to say of lights of mixed types.

    What was said before is said again until something else is so many times as probable as `odds` asks for: of two
    things that are about equally probable a user hears one, not both by turns. No "go" is said to a movement if the
    belief that it is told to stop exceeds `max_go_risk`, or while a camera is sure to see just that; then what was said
    before is said, if that is no "go" and not too improbable. Where nothing can be said, the most probable outcome is
    named, but not to be acted upon.

    Args:
        mass: (n, g) belief in each outcome, 0 where a light's type has fewer.
        contradiction: (n, g, g) `Outcomes.contradiction` of each light's type.
        denied: (n, g) whether a camera surely sees what forbids an outcome, in this very set.
        said: (n,) outcome that was said before; negative for none.
        odds: (n, g) by which the belief in each outcome is divided; 1 for what was said before, else at least 1.
        max_go_risk: Largest belief in "stop" under which "go" is said.
        min_probability: What is less probable is not to be acted upon.
    """
    risky = ((contradiction @ mass[:, :, None])[:, :, 0] > max_go_risk) | denied
    firsts = mass.shape[1] * np.arange(len(mass))  # from here on outcomes are elements of the flat arrays
    before, likely = firsts + np.maximum(said, 0), firsts + mass.argmax(axis=1)
    sayable = (said >= 0) & ~risky.take(before)
    chosen = np.where(sayable, firsts + (mass / odds).argmax(axis=1), likely)
    chosen = np.where(sayable & risky.take(chosen), before, chosen)
    doubtful = (mass.take(chosen) < min_probability) | risky.take(chosen)
    chosen = np.where(doubtful, likely, chosen)
    go_held = risky.take(likely) & (chosen != likely)
    return Choice(chosen - firsts, mass.take(chosen), go_held=go_held, doubtful=doubtful)
