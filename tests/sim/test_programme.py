"""Signal programmes against the rules of the signal description and of the MUTCD."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autolights.core import load_signals
from autolights.core.errors import UsageError
from autolights.sim.programme import FLASHING, PHASES, SHOWN, Programme, check_types, draw_programme

SIGNALS = load_signals()
STEP_S = 0.01


def runs(values: list[str]) -> list[tuple[str, float]]:
    """Each value with the seconds that it lasted, without the first and the last, which are cut off."""
    starts = [0, *(i for i in range(1, len(values)) if values[i] != values[i - 1]), len(values)]
    return [(values[a], (b - a) * STEP_S) for a, b in pairwise(starts)][1:-1]


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), start_s=st.floats(-40, 40))
def test_every_succession_is_legal_and_every_clearance_long_enough(seed: int, start_s: float) -> None:
    programme = draw_programme(start_s, np.random.default_rng(seed))
    times = np.arange(0, 1.5 * programme.cycle_s, STEP_S)
    for kind in SIGNALS.types:
        shown = runs([programme.show(kind, float(t), SIGNALS).lit_class for t in times])
        for (name, lasted), (successor, _) in pairwise(shown):
            assert successor in SIGNALS.state(name).next, f"{name} was followed by {successor}"
            if name in ("3-yellow", "4-yleft1", "5dh-yellow", "5dh-red-yleft"):
                assert 3 - STEP_S <= lasted <= 6 + STEP_S


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_arrow_flashes_50_to_60_times_a_minute_and_is_lit_for_half_to_two_thirds(seed: int) -> None:
    programme = draw_programme(0.0, np.random.default_rng(seed))
    times = np.arange(STEP_S, 6.5, STEP_S)  # within the through phase, which begins at 0
    shown = [programme.show("4", float(t), SIGNALS) for t in times]
    assert all(indication.flashing and indication.class_name == "4-yleft2" for indication in shown)
    whole = runs([indication.lit_class for indication in shown])
    lit = [lasted for name, lasted in whole if name == "4-yleft2"]
    dark = [lasted for name, lasted in whole if name == "4-off"]
    period = np.mean(lit) + np.mean(dark)
    assert 1.0 - STEP_S <= period <= 1.2 + STEP_S
    assert 0.5 - STEP_S <= np.mean(lit) / period <= 2 / 3 + STEP_S


def test_all_classes_occur_in_one_cycle() -> None:
    programme = draw_programme(0.0, np.random.default_rng(0))
    times = np.arange(0, programme.cycle_s, 0.1)
    seen = {programme.show(kind, float(t), SIGNALS).lit_class for kind in SIGNALS.types for t in times}
    assert seen == set(SIGNALS.classes)


def test_a_phase_knows_how_long_it_lasts() -> None:
    programme = Programme((4, 3, 1, 8, 3, 6), through_start_s=10, flash_period_s=1.1, flash_on_s=0.6)
    assert programme.phase_at(10.0) == ("through", 0.0, 8.0)
    assert programme.phase_at(9.5) == ("all_red", 0.5, 0.5)
    assert programme.phase_at(10.0 + programme.cycle_s + 9)[0] == "through_clearance"


@pytest.mark.parametrize(
    ("durations", "period", "on", "message"),
    [
        pytest.param((4, 2.5, 1, 8, 3, 6), 1.1, 0.6, "left_clearance must last 3 to 6 s, got 2.5", id="short-yellow"),
        pytest.param((4, 3, 1, 8, 7, 6), 1.1, 0.6, "through_clearance must last 3 to 6 s, got 7", id="long-yellow"),
        pytest.param((4, 3, 1, 8, 3, 6), 0.8, 0.5, "got 0.8 s lit for 0.5 s", id="fast-flash"),
        pytest.param((4, 3, 1, 8, 3, 6), 1.0, 0.7, "got 1.0 s lit for 0.7 s", id="long-flash"),
    ],
)
def test_illegal_timing_is_refused(
    durations: tuple[float, float, float, float, float, float], period: float, on: float, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        Programme(durations, 0.0, period, on)


def test_a_type_without_programme_is_refused_by_name() -> None:
    kind = SIGNALS.types["3"]
    states = {
        f"2-{name.removeprefix('3-')}": state.model_copy(update={"next": {}, "mirror": None})
        for name, state in list(kind.states.items())[:1]
    }
    other = SIGNALS.model_copy(update={"types": {"2": kind.model_copy(update={"states": states})}, "name": "other"})
    with pytest.raises(UsageError, match="signals 'other': the simulator has no programme for type '2'"):
        check_types(other)


def test_the_table_names_all_phases() -> None:
    for kind, shown in SHOWN.items():
        assert tuple(shown) == PHASES
        assert set(shown.values()) - {FLASHING} <= set(SIGNALS.types[kind].states)
