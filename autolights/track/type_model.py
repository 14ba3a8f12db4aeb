"""All that is fixed about a type of light in mode ``timed``."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from autolights.core import FloatArray, HmmParameters, IntArray, SignalSet
from autolights.track.appearance_filter import AppearanceFilter
from autolights.track.config import TrackConfig
from autolights.track.hidden_chain import HiddenChain
from autolights.track.outcomes import Outcomes

_MISSED = "missed"


@dataclass(frozen=True, eq=False)
class TypeModel:
    """A type's filter, and how to read its beliefs.

    Attributes:
        states: k names of its classes.
        filter: K hidden states, c appearances.
        outcomes: What can be said of it.
        class_membership: (K, k) 1 where a hidden state shows a class.
        appearances: (c,) their places among those of the type with most states.
        appearance_names: (c,) for people.
    """

    states: tuple[str, ...]
    filter: AppearanceFilter
    outcomes: Outcomes
    class_membership: FloatArray
    appearances: IntArray
    appearance_names: tuple[str, ...]

    @classmethod
    def of(cls, name: str, signals: SignalSet, params: HmmParameters, widest: int, config: TrackConfig) -> Self:
        """The model of a type; `widest` is k of the type that has most classes."""
        levels = params.certainty.levels
        chain = HiddenChain.of(
            name,
            signals,
            params,
            stages=config.dwell_stages,
            odd_changes_per_hour=config.odd_changes_per_hour,
        )
        outcomes = Outcomes.of(name, signals, params, chain)
        k = len(params.states)
        return cls(
            states=params.states,
            filter=AppearanceFilter.of(chain, params, error_duration_s=config.error_duration_s),
            outcomes=outcomes,
            class_membership=np.eye(len(params.states))[chain.class_of],
            appearances=np.append(np.add.outer(widest * np.arange(levels), np.arange(k)), levels * widest),
            appearance_names=(
                *(f"{state}, certainty {i + 1} of {levels}" for i in range(levels) for state in params.states),
                _MISSED,
            ),
        )

    def explain(self, belief: FloatArray) -> dict[str, Any]:
        """A (c, K) belief in words: each class, each outcome, how the light looks, the stage of its phase."""
        state, chain = belief.sum(axis=0), self.filter.chain
        phase = int(np.bincount(chain.phase_of, state).argmax())
        stages = state[chain.phase_of == phase]
        return {
            "belief": _rounded(self.states, state @ self.class_membership),
            "outcomes": _rounded(
                [name.class_name + (", flashing" if name.flashing else "") for name in self.outcomes.names],
                state @ self.outcomes.membership,
            ),
            "appearance": _rounded(self.appearance_names, belief.sum(axis=1)),
            "dwell": {
                "phase": self.states[chain.phases[phase].class_index]
                + (" of a flash" if chain.phases[phase].pair is not None else ""),
                "min_s": round(chain.phases[phase].min_s, 3),
                "passed": round(float(stages @ np.arange(len(stages)) / stages.sum() / max(len(stages) - 1, 1)), 3),
            },
        }


def _rounded(names: Sequence[str], probabilities: FloatArray) -> dict[str, float]:
    return dict(zip(names, np.round(probabilities, 4).tolist(), strict=True))
