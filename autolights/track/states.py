"""From a belief over a type's states to what is said about the light."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from autolights.core import FlashingPair, FloatArray, HmmParameters, IntArray, SignalSet
from autolights.track.flashing import FlashVerdict, flash_verdict
from autolights.track.observation import Sighting


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

    def report(self, belief: FloatArray, sightings: Sequence[Sighting]) -> ReportedState:
        """Name the state of a light.

        The dark phase belongs to a flash and to nothing else: in steady operation one indication is always lit. So on
        and off are one hypothesis, and the first dark phase already tells a flash. The duty cycle of the raw sightings
        has the last word: it can prove a flash that the hidden states take for something else, and it can prove that a
        light is steady. A light that stays dark is then reported as off, and not as flashing.

        A pair whose on state may also stay lit (`FlashingPair.steady_on`) takes a dark phase to tell: that is believed
        now, or was seen in two sets of frames within the longest legal period. One misread frame is none.

        Args:
            belief: (k,).
            sightings: Unfiltered, in the order of time.
        """
        summed = belief @ self.membership
        likely = self.names[int(np.argmax(summed))]
        latest = sightings[-1].class_id if sightings else None
        for pair in self.pairs:
            if likely != pair.reported and latest not in self._phases(pair):
                continue
            verdict = self._verdict(sightings, pair)
            believed = likely == pair.reported and (not pair.steady_on or self._was_dark(belief, sightings, pair))
            if verdict == "flashing" or (verdict == "unknown" and believed):
                return ReportedState(pair.reported, float(summed[self.names.index(pair.reported)]), True)
        best = int(np.argmax(belief))
        return ReportedState(self.params.states[best], float(belief[best]), False)

    def _phases(self, pair: FlashingPair) -> tuple[int, int]:
        """Class ids of on and off."""
        states = self.params.states
        return int(self.class_ids[states.index(pair.on)]), int(self.class_ids[states.index(pair.off)])

    def _was_dark(self, belief: FloatArray, sightings: Sequence[Sighting], pair: FlashingPair) -> bool:
        if self.params.states[int(np.argmax(belief))] == pair.off:
            return True
        votes = self._votes(sightings, pair)
        since_ns = max(votes, default=0) - pair.period_s[1] * 1e9
        return sum(set_ns >= since_ns and vote <= 0 for set_ns, vote in votes.items()) >= 2

    def _verdict(self, sightings: Sequence[Sighting], pair: FlashingPair) -> FlashVerdict:
        votes = self._votes(sightings, pair)
        stamps_s = [set_ns / 1e9 for set_ns in votes]
        return flash_verdict(stamps_s, [vote > 0 for vote in votes.values()], pair)

    def _votes(self, sightings: Sequence[Sighting], pair: FlashingPair) -> dict[int, float]:
        """Stamp of a set → positive if the pair was lit: cameras vote by the height of their boxes."""
        on, off = self._phases(pair)
        votes: dict[int, float] = {}
        for set_ns, class_id, height_px in sightings:
            if class_id in (on, off):
                votes[set_ns] = votes.get(set_ns, 0.0) + (height_px if class_id == on else -height_px)
        return votes
