"""Mode ``paper``: one fixed transition matrix per observation, and flashing by the duty cycle of what was seen.

References:
    Wu et al. 2023, Sec. III-C and III-D.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from autolights.core import BoolArray, FlashingPair, FloatArray, HmmParameters, IntArray, SignalSet
from autolights.track.config import TrackConfig
from autolights.track.flashing import FlashVerdict, flash_verdict
from autolights.track.hmm_filter import hmm_predict, hmm_update
from autolights.track.states import Looks, Reports


class Sighting(NamedTuple):
    """One detection in a track's memory, unfiltered (the paper's O_f).

    Attributes:
        set_ns: Stamp of the set of frames.
        class_id: Most probable class.
        height_px: Of the box.
    """

    set_ns: int
    class_id: int
    height_px: float


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


class PaperStates:
    """Beliefs of all tracks, and what was seen of each lately.

    Args:
        signals: The signal description.
        hmm: One model per type.
        config: How much is remembered.
    """

    def __init__(self, signals: SignalSet, hmm: Mapping[str, HmmParameters], config: TrackConfig) -> None:
        self._config = config
        self._signals = signals
        self._models = [TypeStates.of(name, signals, hmm[name]) for name in signals.types]
        self._types: list[int] = []
        self._beliefs: list[FloatArray] = []
        self._histories: list[deque[Sighting]] = []
        self._now_ns = 0

    def append(self, types: IntArray, groups: IntArray) -> None:
        """Take in new tracks; groups share nothing in the paper."""
        self._types += types.tolist()
        self._beliefs += [self._models[t].params.initial for t in types]
        self._histories += [deque() for _ in types]

    def keep(self, rows: IntArray) -> None:
        """Forget all tracks but these."""
        self._types = [self._types[row] for row in rows]
        self._beliefs = [self._beliefs[row] for row in rows]
        self._histories = [self._histories[row] for row in rows]

    def start_anew(self, rows: IntArray, types: IntArray) -> None:
        """Forget the belief in some tracks' states; what was seen of them stays until they die."""
        for row, t in zip(rows.tolist(), types.tolist(), strict=True):
            self._types[row], self._beliefs[row] = t, self._models[t].params.initial

    def merge(self, row: int, other: int, source: int) -> None:
        """Two tracks of one type are one light: the first gets what is believed of `source`."""
        self._beliefs[row], self._histories[row] = self._beliefs[source], self._histories[source]

    def let_time_pass(self, stamp_ns: int) -> None:
        """Note the time; beliefs move with observations alone."""
        self._now_ns = stamp_ns

    def take_in(self, looks: Looks) -> None:
        """One fixed A and one update for each look."""
        class_ids = np.argmax(looks.class_probs, axis=1) if len(looks.rows) else looks.rows
        for row, class_probs, class_id, height_px in zip(
            looks.rows.tolist(), looks.class_probs, class_ids.tolist(), looks.heights_px.tolist(), strict=True
        ):
            model = self._models[self._types[row]]
            predicted = hmm_predict(self._beliefs[row], model.params, None)
            self._beliefs[row] = hmm_update(predicted, class_probs[model.class_ids], model.params)
            self._remember(self._histories[row], Sighting(self._now_ns, class_id, height_px))

    def _remember(self, history: deque[Sighting], sighting: Sighting) -> None:
        history.append(sighting)
        oldest_ns = sighting.set_ns - self._config.history_s * 1e9
        while len(history) > self._config.history_size and history[0].set_ns < oldest_ns:
            history.popleft()

    def end_set(self, alive: BoolArray, over: BoolArray) -> None:
        """Forget what was seen of the dead; a belief is small enough to stay until it starts anew."""
        for row in np.flatnonzero(~alive):
            if self._histories[row] and self._histories[row][-1].set_ns != self._now_ns:
                self._histories[row].clear()

    def report(self) -> Reports:
        """What is said of each track."""
        told = [
            self._models[t].report(belief, history)
            for t, belief, history in zip(self._types, self._beliefs, self._histories, strict=True)
        ]
        n = len(told)
        return Reports(
            class_ids=np.array([self._signals.class_ids[state.class_name] for state in told], dtype=np.int64),
            flashing=np.array([state.flashing for state in told], dtype=bool),
            probability=np.array([state.probability for state in told]),
            doubtful=np.zeros(n, dtype=bool),
            go_held=np.zeros(n, dtype=bool),
            shares=np.zeros(n, dtype=bool),
            disputed=np.zeros(n, dtype=bool),
        )

    def explain(self, row: int) -> dict[str, Any]:
        """Belief in each state, and the number of sightings that the duty cycle has to go by."""
        states = self._models[self._types[row]].params.states
        belief = np.round(self._beliefs[row], 4).tolist()
        return {"belief": dict(zip(states, belief, strict=True)), "sightings": len(self._histories[row])}

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values."""
        return {
            "now_ns": self._now_ns,
            "beliefs": [belief.tolist() for belief in self._beliefs],
            "histories": [[list(sighting) for sighting in history] for history in self._histories],
        }

    def restore(self, values: dict[str, Any], types: IntArray) -> None:
        """Remember what `to_json` gave."""
        self._now_ns = values["now_ns"]
        self._types = types.tolist()
        self._beliefs = [np.array(belief, dtype=np.float64) for belief in values["beliefs"]]
        self._histories = [deque(Sighting(*sighting) for sighting in history) for history in values["histories"]]
