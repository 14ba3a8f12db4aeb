"""From a belief over a type's states to what is said about the light."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from autolights.core import FlashingPair, FloatArray, HmmParameters, IntArray, SignalSet
from autolights.track.flashing import FlashVerdict


@dataclass(frozen=True)
class ReportedState:
    """What is said about a light.

    Attributes:
        class_name: The state; a flashing pair has one name.
        probability: Belief in it.
        flashing: Whether the indication flashes.
    """

    class_name: str
    probability: float
    flashing: bool


@dataclass(frozen=True, eq=False)
class TypeStates:
    """The states of one type of light, ready for the filter and for reports.

    Attributes:
        params: The hidden Markov model.
        class_ids: (k,) columns of a class vector that are states of this type.
        pairs: Flashing pairs.
        names: g names of what can be reported while nothing speaks against a flash.
        membership: (k, g) which state is reported under which name.
    """

    params: HmmParameters
    class_ids: IntArray
    pairs: tuple[FlashingPair, ...]
    names: tuple[str, ...]
    membership: FloatArray

    @classmethod
    def of(cls, type_name: str, signals: SignalSet, params: HmmParameters) -> Self:
        """The states of a type."""
        reported = [signals.reported(name) for name in params.states]
        names = tuple(dict.fromkeys(reported))
        return cls(
            params=params,
            class_ids=np.array([signals.class_ids[name] for name in params.states]),
            pairs=signals.types[type_name].flashing,
            names=names,
            membership=np.array([[float(own == name) for name in names] for own in reported]),
        )

    def likely_pair(self, belief: FloatArray) -> FlashingPair | None:
        """The flashing pair in one of whose phases the light probably is.

        The dark phase belongs to a flash and to nothing else: in steady operation one indication is always lit. So on
        and off are one hypothesis, and the first dark phase already tells a flash.
        """
        if not self.pairs:
            return None
        name = self.names[int(np.argmax(belief @ self.membership))]
        return next((pair for pair in self.pairs if pair.reported == name), None)

    def report(self, belief: FloatArray, pair: FlashingPair | None, verdict: FlashVerdict) -> ReportedState:
        """Name the state of a light.

        Args:
            belief: (k,).
            pair: The flashing pair that it may be in, if any.
            verdict: What its duty cycle says of that pair. A light that proves steady is reported phase by phase: one
                that stays dark is off, and not flashing.
        """
        if pair is None or verdict == "steady":
            best = int(np.argmax(belief))
            return ReportedState(self.params.states[best], float(belief[best]), False)
        summed = belief @ self.membership
        return ReportedState(pair.reported, float(summed[self.names.index(pair.reported)]), True)
