"""All that is fixed about the types of lights in mode ``timed``: of one for people, of all in tables."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from autolights.core import BoolArray, FloatArray, HmmParameters, IntArray, SignalSet
from autolights.track.config import TrackConfig
from autolights.track.hidden_chain import HiddenChain
from autolights.track.outcomes import Outcomes

_MISSED = "missed"


@dataclass(frozen=True, eq=False)
class TypeModel:
    """One type.

    Attributes:
        params: Its HMM: k classes, L levels of certainty.
        chain: K hidden states.
        outcomes: g things that can be said of it.
    """

    params: HmmParameters
    chain: HiddenChain
    outcomes: Outcomes

    @classmethod
    def of(cls, name: str, signals: SignalSet, params: HmmParameters, config: TrackConfig) -> Self:
        """The model of a type."""
        chain = HiddenChain.of(
            name, signals, params, stages=config.dwell_stages, odd_changes_per_hour=config.odd_changes_per_hour
        )
        return cls(params, chain, Outcomes.of(name, signals, params, chain))

    def own_part(self, widest: int) -> tuple[IntArray, IntArray]:
        """Index of its own appearances and hidden states in beliefs that are made for up to `widest` classes."""
        levels, k = self.params.certainty.levels, len(self.params.states)
        appearances = np.append(np.add.outer(widest * np.arange(levels), np.arange(k)), levels * widest)
        return appearances[:, None], np.arange(len(self.chain))

    def explain(self, belief: FloatArray) -> dict[str, Any]:
        """A (L k + 1, K) belief in words: each class, each outcome, how the light looks, the stage of its phase."""
        states, levels = self.params.states, self.params.certainty.levels
        state, chain = belief.sum(axis=0), self.chain
        phase = int(np.bincount(chain.phase_of, state).argmax())
        stages = state[chain.phase_of == phase]
        return {
            "belief": _rounded(states, np.bincount(chain.class_of, state, minlength=len(states))),
            "outcomes": _rounded(
                [name.class_name + (", flashing" if name.flashing else "") for name in self.outcomes.names],
                state @ self.outcomes.membership,
            ),
            "appearance": _rounded(
                [f"{name}, certainty {i + 1} of {levels}" for i in range(levels) for name in states] + [_MISSED],
                belief.sum(axis=1),
            ),
            "dwell": {
                "phase": states[chain.phases[phase].class_index]
                + (" of a flash" if chain.phases[phase].pair is not None else ""),
                "min_s": round(chain.phases[phase].min_s, 3),
                "passed": round(float(stages @ np.arange(len(stages)) / stages.sum() / max(len(stages) - 1, 1)), 3),
            },
        }


@dataclass(frozen=True, eq=False)
class OutcomeTables:
    """How to read beliefs of n types, or of n lights by their types; 0 where one has fewer states or outcomes.

    Attributes:
        class_membership: (n, K, k) 1 where a hidden state shows a class.
        membership: (n, K, g) 1 where it belongs to an outcome.
        denied_by: (n, k, g) `Outcomes.denied_by`.
        contradiction: (n, g, g) `Outcomes.contradiction`.
        change_odds: (n, g, g) `[i, j]`: how many times as probable as i another outcome j must be to be said after it.
        class_ids: (n, g) as what an outcome is reported.
        flashing: (n, g) whether it flashes.
    """

    class_membership: FloatArray
    membership: FloatArray
    denied_by: FloatArray
    contradiction: FloatArray
    change_odds: FloatArray
    class_ids: IntArray
    flashing: BoolArray

    @classmethod
    def of(
        cls,
        models: Sequence[TypeModel],
        signals: SignalSet,
        config: TrackConfig,
        *,
        dtype: type[np.floating[Any]] = np.float64,
    ) -> Self:
        """Of these types, for beliefs of a `dtype`."""
        n, k = len(models), max(len(model.params.states) for model in models)
        states, g = max(len(model.chain) for model in models), max(len(model.outcomes.names) for model in models)
        tables = cls(
            np.zeros((n, states, k), dtype),
            np.zeros((n, states, g), dtype),
            np.zeros((n, k, g)),
            np.zeros((n, g, g), dtype),
            np.ones((n, g, g), dtype),
            np.zeros((n, g), dtype=np.int64),
            np.zeros((n, g), dtype=bool),
        )
        for t, model in enumerate(models):
            own, chain = model.outcomes, slice(len(model.chain))
            names, classes = slice(len(own.names)), slice(len(model.params.states))
            tables.class_membership[t, chain, classes] = np.eye(len(model.params.states))[model.chain.class_of]
            tables.membership[t, chain, names] = own.membership
            tables.denied_by[t, classes, names] = own.denied_by
            tables.contradiction[t, names, names] = own.contradiction
            again = np.eye(len(own.names), dtype=bool)
            tables.change_odds[t, names, names] = np.where(again | own.stops_flashing, 1.0, config.change_odds)
            tables.class_ids[t, names] = [signals.class_ids[name.class_name] for name in own.names]
            tables.flashing[t, names] = [name.flashing for name in own.names]
        return tables

    def take(self, types: IntArray) -> "OutcomeTables":
        """Of lights of these types."""
        return OutcomeTables(**{name: table.take(types, axis=0) for name, table in vars(self).items()})


def _rounded(names: Sequence[str], probabilities: NDArray[Any]) -> dict[str, float]:
    return dict(zip(names, np.round(probabilities.astype(np.float64), 4).tolist(), strict=True))
