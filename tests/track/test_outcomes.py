"""What is said, given what is believed and what was said before."""

import numpy as np
import pytest

from autolights.core import HmmParameters, SignalSet, load_signals
from autolights.track.hidden_chain import HiddenChain
from autolights.track.outcomes import Choice, Outcomes, choose

RED, YELLOW, GREEN = range(3)
GO_AGAINST_STOP = np.zeros((3, 3))
GO_AGAINST_STOP[GREEN, RED] = 1.0


def choose_one(mass: list[float], said: int, change_odds: float = 3.0, *, red_is_seen: bool = False) -> Choice:
    odds = np.full((1, 3), change_odds)
    odds[0, said] = 1.0
    denied = np.array([[False, False, red_is_seen]])
    return choose(
        np.array([mass]), GO_AGAINST_STOP[None], denied, np.array([said]), odds, max_go_risk=0.1, min_probability=0.25
    )


@pytest.mark.parametrize(
    ("mass", "said", "expected"),
    [
        pytest.param([0.4, 0.6, 0.0], -1, YELLOW, id="first-sight-the-most-probable"),
        pytest.param([0.4, 0.6, 0.0], RED, RED, id="not-three-times-as-probable"),
        pytest.param([0.2, 0.8, 0.0], RED, YELLOW, id="more-than-three-times"),
        pytest.param([0.05, 0.0, 0.95], RED, GREEN, id="go-where-stop-is-all-but-excluded"),
        pytest.param([0.3, 0.0, 0.7], RED, RED, id="go-is-held-back-behind-stop"),
        pytest.param([0.12, 0.5, 0.38], GREEN, YELLOW, id="go-is-not-said-again-under-risk"),
    ],
)
def test_what_is_said(mass: list[float], said: int, expected: int) -> None:
    choice = choose_one(mass, said)
    assert choice.outcome.tolist() == [expected]
    assert not choice.doubtful.any()
    assert choice.probability.tolist() == [mass[expected]]


@pytest.mark.parametrize(
    ("mass", "said"),
    [
        pytest.param([0.3, 0.0, 0.7], -1, id="go-at-first-sight-under-risk"),
        pytest.param([0.2, 0.0, 0.8], RED, id="stop-too-improbable-to-be-said-again"),
        pytest.param([0.2, 0.0, 0.8], GREEN, id="go-was-said-and-is-risky-now"),
        pytest.param([0.24, 0.24, 0.24], -1, id="nothing-is-probable"),
    ],
)
def test_what_is_withheld(mass: list[float], said: int) -> None:
    choice = choose_one(mass, said)
    assert choice.doubtful.all()
    assert choice.outcome.tolist() == [int(np.argmax(mass))], "named, but not to be acted upon"


def test_no_go_while_a_camera_is_sure_of_stop() -> None:
    assert choose_one([0.3, 0.0, 0.7], RED, red_is_seen=True).outcome.tolist() == [RED]
    assert choose_one([0.01, 0.0, 0.99], GREEN, red_is_seen=True).doubtful.tolist() == [True]
    assert choose_one([0.01, 0.0, 0.99], GREEN).doubtful.tolist() == [False]


def test_holding_go_back_is_told() -> None:
    assert choose_one([0.3, 0.0, 0.7], RED).go_held.tolist() == [True]
    assert choose_one([0.05, 0.0, 0.95], RED).go_held.tolist() == [False]


def test_what_is_lit_denies_go_to_the_movements_that_it_stops(hmm: dict[str, HmmParameters]) -> None:
    signals = load_signals()
    chain = HiddenChain.of("5dh", signals, hmm["5dh"], stages=8, odd_changes_per_hour=1.0)
    outcomes = Outcomes.of("5dh", signals, hmm["5dh"], chain)
    denied = {
        (lit, outcomes.names[i].class_name)
        for lit, row in zip(hmm["5dh"].states, outcomes.denied_by, strict=True)
        for i in np.flatnonzero(row)
    }
    stops = ("5dh-red", "5dh-red-gleft", "5dh-red-yleft")
    assert denied == {(lit, "5dh-green") for lit in stops} | {("5dh-red", "5dh-red-gleft")}


def test_only_the_end_of_a_flash_is_the_same_class_without_flashing(hmm: dict[str, HmmParameters]) -> None:
    signals: SignalSet = load_signals()
    chain = HiddenChain.of("4", signals, hmm["4"], stages=8, odd_changes_per_hour=1.0)
    outcomes = Outcomes.of("4", signals, hmm["4"], chain)
    flash = [name.flashing for name in outcomes.names].index(True)
    steady = outcomes.names.index(outcomes.names[flash]._replace(flashing=False))
    expected = np.zeros_like(outcomes.stops_flashing)
    expected[flash, steady] = True
    np.testing.assert_array_equal(outcomes.stops_flashing, expected)
