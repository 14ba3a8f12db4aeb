import json
from dataclasses import replace

import numpy as np
import pytest

from autolights.core import HmmParameters, SignalSet
from autolights.track import TrackConfig
from autolights.track.states import Looks
from autolights.track.timed_states import TimedStates

Hmm = dict[str, HmmParameters]
GROUPS, MEMBERS = 3, 4
TRACKS = GROUPS * MEMBERS


def begin(signals: SignalSet, hmm: Hmm) -> TimedStates:
    states = TimedStates(signals, hmm, TrackConfig())
    states.append(np.arange(GROUPS).repeat(MEMBERS), np.arange(GROUPS).repeat(MEMBERS))
    return states


def step(states: TimedStates, signals: SignalSet, rng: np.random.Generator, stamp_ns: int, least: float) -> None:
    """Most lights are seen, most of them as what they show; now and then one dies."""
    own = [np.array([signals.class_ids[name] for name in signals.states_of(kind)]) for kind in signals.types]
    rows = np.flatnonzero(rng.random(TRACKS) < 0.7)
    class_probs = np.zeros((len(rows), len(signals.classes)))
    for probs, kind in zip(class_probs, (rows // MEMBERS).tolist(), strict=True):
        probs[own[kind]] = least * rng.random(len(own[kind]))
        shown = stamp_ns // 1_500_000_000 if rng.random() < 0.8 else rng.integers(9)
        probs[own[kind][shown % len(own[kind])]] = 0.97
    states.let_time_pass(stamp_ns)
    states.take_in(Looks(rows, class_probs, np.full(len(rows), 30.0), np.empty(0, dtype=np.int64)))
    states.end_set(rng.random(TRACKS) < 0.97, np.zeros(TRACKS, dtype=bool))


@pytest.mark.parametrize("least", [0.0, 1e-12, 1e-6])
@pytest.mark.parametrize("miss", [0.0, 0.01])
def test_where_the_model_knows_no_errors_beliefs_stay_probabilities(
    signals: SignalSet, hmm: Hmm, miss: float, least: float
) -> None:
    sure = {
        name: replace(
            own,
            observation=np.eye(len(own.states)),
            evidence=np.eye(len(own.states)),
            miss_probs=np.full(len(own.states), miss),
        )
        for name, own in hmm.items()
    }
    for seed in range(4):
        states, rng = begin(signals, sure), np.random.default_rng(seed)
        for i in range(60):
            step(states, signals, rng, 100_000_000 * i, least)
            reports = states.report()
            assert ((reports.probability >= 0) & (reports.probability <= 1)).all()
            beliefs = np.array(states.to_json()["beliefs"][0][0])
            assert beliefs.sum() == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("step_ns", [0, 100_000, 100_000_000])
def test_saved_and_restored_it_goes_on_with_equal_beliefs(signals: SignalSet, hmm: Hmm, step_ns: int) -> None:
    one, rng = begin(signals, hmm), np.random.default_rng(3)
    for i in range(20):
        step(one, signals, rng, 100_000_000 * i, 1e-3)
        one.report()
    other = TimedStates(signals, hmm, TrackConfig())
    other.restore(json.loads(json.dumps(one.to_json())), np.arange(GROUPS).repeat(MEMBERS))
    for i in range(1, 4):
        for states in (one, other):
            step(states, signals, np.random.default_rng(i), 1_900_000_000 + i * step_ns, 1e-3)
            states.report()
        assert one.to_json() == other.to_json()
