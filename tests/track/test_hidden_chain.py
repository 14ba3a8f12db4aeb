"""The chain behind the looks, against matrix exponentials, gamma distributions and a simulated light."""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse.linalg
import scipy.stats

from autolights.core import HmmParameters, SignalSet
from autolights.core.config import parse_config
from autolights.track.hidden_chain import HiddenChain, flash_durations_s


def chain(type_name: str, signals: SignalSet, hmm: dict[str, HmmParameters], stages: int = 8, odd: float = 1.0):
    return HiddenChain.of(type_name, signals, hmm[type_name], stages=stages, odd_changes_per_hour=odd)


@pytest.mark.parametrize("type_name", ["3", "4", "5dh"])
@pytest.mark.parametrize("duration_ms", [0, 1, 17, 100, 333, 5000, 60_000])
def test_transitions_are_the_matrix_exponential(type_name, duration_ms, signals, hmm) -> None:
    hidden = chain(type_name, signals, hmm)
    change, stay = hidden.over(duration_ms)
    # Not scipy.linalg.expm: its branch for triangular matrices (scipy 1.17) is off by 0.3 for a chain of equal stages.
    for transition, rates in ((change, hidden.rates), (stay, hidden.stay_rates)):
        expected = scipy.sparse.linalg.expm_multiply(rates * duration_ms / 1000, np.eye(len(hidden)))
        np.testing.assert_allclose(transition, expected, atol=1e-9)
    np.testing.assert_allclose(change.sum(axis=1), 1)
    assert (stay <= change + 1e-12).all(), "who stays is among those who are there"


@pytest.mark.parametrize("type_name", ["3", "5dh"])
def test_one_stage_and_no_surprises_is_the_chain_of_the_description(type_name, signals, hmm) -> None:
    hidden = chain(type_name, signals, hmm, stages=1, odd=1e-12)
    np.testing.assert_allclose(hidden.rates, hmm[type_name].rates, atol=1e-12)
    np.testing.assert_allclose(hidden.initial, hmm[type_name].initial)


def survival(hidden: HiddenChain, start: int, times_s: np.ndarray) -> np.ndarray:
    """Probability that the phase which begins in a hidden state has not ended yet."""
    return np.array([hidden.over(round(1000 * t))[1][start].sum() for t in times_s])


def test_yellow_lasts_three_seconds_and_then_some(signals, hmm) -> None:
    hidden = chain("3", signals, hmm, stages=8, odd=1e-9)
    yellow = hmm["3"].states.index("3-yellow")
    start = int(np.flatnonzero(hidden.phase_of == yellow)[0])
    times_s = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 9.0])
    # 3 s in eight stages (a gamma distribution), then an exponential of 1 s: by numerical convolution.
    grid = np.arange(0, 40, 0.001)
    least = scipy.stats.gamma(8, scale=3 / 8)
    density = np.convolve(least.pdf(grid), np.exp(-grid))[: len(grid)] * 0.001
    expected = 1 - np.interp(times_s, grid, np.cumsum(density) * 0.001)
    np.testing.assert_allclose(survival(hidden, start, times_s), expected, atol=2e-3)
    assert survival(hidden, start, np.array([1.0]))[0] > 0.99, "hardly ever over after a second"


def test_flash_durations_are_the_laws(signals) -> None:
    (on_least_s, on_s), (off_least_s, off_s) = flash_durations_s(signals.types["4"].flashing[0])
    assert (on_least_s, off_least_s) == (0.5, pytest.approx(1 / 3))
    assert (on_s, off_s) == (pytest.approx(1.1 * 7 / 12), pytest.approx(1.1 * 5 / 12))


def test_initial_distribution_keeps_the_classes(signals, hmm) -> None:
    for name, params in hmm.items():
        hidden = chain(name, signals, hmm)
        by_class = np.bincount(hidden.class_of, hidden.initial, len(params.states))
        np.testing.assert_allclose(by_class, params.initial)


def test_a_flash_of_a_shared_dark_class_remembers_its_color(beacon: dict, hmm_of: Callable) -> None:
    signals = parse_config(two_flashes(beacon), SignalSet, source="flashes")
    hidden = chain("b", signals, hmm_of(signals))
    pairs = {
        phase.pair: i for i, phase in enumerate(hidden.phases) if phase.class_index == 0 and phase.pair is not None
    }
    assert sorted(pairs) == [0, 1], "one dark phase for each pair"
    for pair, phase in pairs.items():
        last = int(np.flatnonzero(hidden.phase_of == phase)[-1])
        lit = int(np.flatnonzero(hidden.phase_of == phase - 1)[0])
        onward = hidden.rates[last].copy()
        onward[last] = 0
        assert hidden.phases[phase - 1].pair == pair
        assert onward[lit] / onward.sum() > 0.9, "it lights up in the colour that it had"


def two_flashes(beacon: dict) -> dict:
    """The beacon with a green that flashes too and shares the dark class."""
    light = beacon["types"]["b"]
    green = {**light["states"]["b-green"], "next": {"b-dark": 1, "b-red": 3}}
    dark = {**light["states"]["b-dark"], "next": {"b-red": 1, "b-green": 1}}
    pair = {"on": "b-green", "off": "b-dark", "reported": "b-green", "steady_on": True}
    states = {**light["states"], "b-green": green, "b-dark": dark}
    return {**beacon, "types": {"b": {**light, "states": states, "flashing": [*light["flashing"], pair]}}}


def test_time_does_not_run_backwards(signals, hmm) -> None:
    with pytest.raises(ValueError, match="time does not run backwards, got -1 ms"):
        chain("3", signals, hmm).over(-1)


def test_odd_frame_times_do_not_fill_the_memory(signals, hmm) -> None:
    hidden = chain("3", signals, hmm)
    for duration_ms in range(1, 500):
        hidden.over(duration_ms)
    assert len(hidden._cache) <= 64
