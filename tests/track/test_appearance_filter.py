"""The filter on hidden states and appearances against the sum over all paths, and what must not matter."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from autolights.core import Certainty, HmmParameters, SignalSet, load_signals
from autolights.core.errors import UsageError
from autolights.track import hmm_predict, hmm_update
from autolights.track.appearance_filter import AppearanceFilter, LightsByType
from autolights.track.hidden_chain import HiddenChain
from autolights.track.look_reader import LookReader, miss_likelihood, seen_likelihood
from autolights.track.signal_groups import Partners

SIGNALS = load_signals()
Hmm = dict[str, HmmParameters]


class OneType:
    """The filter of one type, for (m, c, K) beliefs: each light's own, or in `update_together` its group's."""

    def __init__(self, chain: HiddenChain, params: HmmParameters, *, error_duration_s: float) -> None:
        self._filter = AppearanceFilter.of([chain], [params], error_duration_s=error_duration_s)
        self.chain, self.looks, self.first = chain, self._filter.looks[0], self._filter.first[0]

    def _lights(self, count: int) -> LightsByType:
        return self._filter.lights(np.zeros(count, dtype=np.int64))

    def predict(self, beliefs: np.ndarray, duration_ms: int) -> np.ndarray:
        moved, states = self._filter.predict(beliefs[:, None], self._lights(len(beliefs)), duration_ms)
        np.testing.assert_allclose(states[:, 0], moved[:, 0].sum(axis=1), atol=1e-12)
        return moved[:, 0]

    def update(self, beliefs: np.ndarray, likelihood: np.ndarray) -> np.ndarray:
        return self._updated(beliefs[:, None], likelihood)[:, 0]

    def update_together(self, beliefs: np.ndarray, likelihood: np.ndarray, partners: Partners) -> np.ndarray:
        both = np.stack([beliefs, beliefs], axis=1)
        return self._updated(both, likelihood, partners)[:, 1]

    def _updated(self, beliefs: np.ndarray, likelihood: np.ndarray, partners: Partners | None = None) -> np.ndarray:
        lights, states = self._lights(len(beliefs)), self._filter.states(beliefs)
        posterior, after = self._filter.update(beliefs, states, lights, likelihood, partners)
        np.testing.assert_allclose(after, posterior.sum(axis=2), atol=1e-12)
        return posterior

    def seconds(self, class_probs: np.ndarray) -> np.ndarray:
        """By how much it multiplies a belief that is the same everywhere."""
        rows, lights = np.arange(len(class_probs)), self._lights(len(class_probs))
        even = np.ones((len(rows), 1, *self.first.shape))
        told = (rows, *self._filter.seconds(class_probs, np.zeros(len(rows), dtype=np.int64)))
        states = self._filter.states(even)
        seen = self._filter.update(even, states, lights, np.ones((len(rows), len(self.first))), None, told)[0][:, 0]
        return seen / seen[:, -1:, :1]  # of a light that is missed there is no second class


def make_filter(
    params: HmmParameters, signals: SignalSet = SIGNALS, *, stages: int = 1, error_duration_s: float = 0.4
) -> OneType:
    chain = HiddenChain.of(params.type, signals, params, stages=stages, odd_changes_per_hour=36.0)
    return OneType(chain, params, error_duration_s=error_duration_s)


def test_filter_is_the_sum_over_all_paths_of_states_and_appearances(hmm: Hmm) -> None:
    own = make_filter(replace(hmm["3"], certainty=Certainty((0.8,), (0.3, 0.7), (0.9, 0.1))))
    rng = np.random.default_rng(1)
    k, c, classes = len(own.chain), len(own.looks), 3
    # Uneven times, twice the same instant.
    steps_ms, likelihoods = [100, 0, 330], rng.random((3, c))
    belief = own.first[None]
    for duration_ms, likelihood in zip(steps_ms, likelihoods, strict=True):
        belief = own.update(own.predict(belief, duration_ms), likelihood[None])

    points = [*product(range(c), range(k))]
    mass = {point: own.first[point] for point in points}
    for duration_ms, likelihood in zip(steps_ms, likelihoods, strict=True):
        change = scipy.linalg.expm(own.chain.rates * duration_ms / 1000)
        stay = scipy.linalg.expm(own.chain.stay_rates * duration_ms / 1000)
        rho = np.exp(-duration_ms / 400)
        after = dict.fromkeys(points, 0.0)
        for (a, q), (b, r) in product(points, points):
            # A new state is seen anew, as surely as the one before.
            same_level = b < c - 1 and a // classes == b // classes
            level = slice(b // classes * classes, b // classes * classes + classes)
            seen = own.looks[b, r] / own.looks[level, r].sum() if same_level else 0.0
            hidden = change[q, r] * (a == b)  # what hides a light goes on to hide it
            held = hidden if a == c - 1 else stay[q, r] * (a == b) + (change[q, r] - stay[q, r]) * seen
            step = rho * held + (1 - rho) * change[q, r] * own.looks[b, r]
            after[b, r] += mass[a, q] * step * likelihood[b]
        mass = after
    summed = np.array([mass[point] for point in points]).reshape(c, k)
    np.testing.assert_allclose(belief[0], summed / summed.sum(), atol=1e-12)


@pytest.mark.parametrize("type_name", ["3", "5dh"])
def test_without_lasting_errors_and_misses_it_is_the_papers_filter(hmm: Hmm, type_name: str) -> None:
    params = hmm[type_name]
    chain = HiddenChain.of(type_name, SIGNALS, params, stages=1, odd_changes_per_hour=1e-9)
    own = OneType(chain, params, error_duration_s=0)
    belief, paper = own.first[None], params.initial
    rng = np.random.default_rng(4)
    for duration_ms in (100, 40, 0, 200):
        x = rng.dirichlet(np.ones(len(params.states)))
        seen = likelihood(params, x, sharpness=1.0)
        seen[:, -1] = 0  # the paper knows no misses
        if duration_ms:
            belief = own.update(own.predict(belief, duration_ms), seen)
            paper = hmm_update(hmm_predict(paper, params, duration_ms / 1000), x, params)
    np.testing.assert_allclose(belief[0].sum(axis=0), paper, atol=1e-6)


def likelihood(params: HmmParameters, x: np.ndarray, **how: float) -> np.ndarray:
    """Of a class vector over the type's own states."""
    reader = LookReader.of([params], {name: i for i, name in enumerate(params.states)})
    return seen_likelihood(*reader.read(x[None], np.zeros(1, dtype=int), **how)[:2])


def look(params: HmmParameters, name: str | None) -> np.ndarray:
    if name is None:
        return miss_likelihood(len(params.states), params.certainty.levels)[None]
    return likelihood(params, np.where(np.array(params.states) == name, 0.9, 0.01))


def test_the_same_wrong_answer_again_is_hardly_news(hmm: Hmm) -> None:
    params = hmm["3"]
    red, yellow = (params.states.index(name) for name in ("3-red", "3-yellow"))
    odds = []
    for error_duration_s in (0.0, 0.4):
        own = make_filter(params, error_duration_s=error_duration_s)
        belief = own.first[None] * (own.chain.class_of == red)
        for name in ["3-red"] * 10 + ["3-yellow"] * 4:
            belief = own.update(own.predict(belief, 33), look(params, name))
        state = belief[0].sum(axis=0)
        odds.append(state[yellow] / state[red])
    assert odds[0] > 5 > 0.2 > odds[1]


def test_a_miss_is_a_hint_at_what_is_often_missed(hmm: Hmm) -> None:
    miss_probs = np.array([0.02, 0.4, 0.02, 0.02, 0.02])
    params = HmmParameters(**{**vars(hmm["4"]), "miss_probs": miss_probs})
    own = make_filter(params, stages=8)
    before = own.first[None]
    off = own.chain.class_of == params.states.index("4-off")
    once = own.update(before, look(params, None))
    odds = [belief.sum(axis=(0, 1))[off].sum() / belief.sum(axis=(0, 1))[~off].sum() for belief in (before, once)]
    assert odds[1] / odds[0] == pytest.approx(0.4 / 0.02, rel=0.06), "the ratio of the miss probabilities"
    again = own.update(own.predict(once, 50), look(params, None))
    twice = again.sum(axis=(0, 1))[off].sum() / again.sum(axis=(0, 1))[~off].sum()
    assert twice / odds[1] < 1.2, "what hides a light hides it for a while"


@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_order_of_cameras_and_splitting_of_sets_do_not_matter(hmm: Hmm, data: st.DataObject) -> None:
    params = hmm[data.draw(st.sampled_from(["3", "4", "5dh"]))]
    own = make_filter(params, stages=4)
    c = len(own.looks)
    first, second = data.draw(arrays(float, (2, 1, c), elements=st.floats(0.01, 1)))
    before = own.predict(own.first[None], data.draw(st.integers(0, 5000)))
    together = own.update(before, first * second)
    apart = own.update(own.predict(own.update(before, second), 0), first)
    np.testing.assert_allclose(together, apart, atol=1e-12)
    np.testing.assert_allclose(together.sum(), 1)
    assert (together >= 0).all()


@given(scale=st.sampled_from([2, 5, 10]), steps=st.lists(st.integers(0, 400), min_size=1, max_size=5))
@settings(max_examples=20, deadline=None)
def test_time_and_rates_scaled_together_change_nothing(hmm: Hmm, scale: int, steps: list[int]) -> None:
    params = hmm["5dh"]
    slow = HmmParameters(**{**vars(params), "rates": params.rates / scale})
    beliefs = []
    for own, factor, odd in ((params, 1, 36.0), (slow, scale, 36.0 / scale)):
        chain = HiddenChain.of("5dh", SIGNALS, own, stages=1, odd_changes_per_hour=odd)
        filt = OneType(chain, own, error_duration_s=0.4 * factor)
        belief = filt.first[None]
        for i, step in enumerate(steps):
            belief = filt.update(filt.predict(belief, step * factor), look(own, own.states[i % 5]))
        beliefs.append(belief)
    np.testing.assert_allclose(*beliefs, atol=1e-9)


def test_who_is_sure_is_believed_sooner(hmm: Hmm) -> None:
    params = replace(hmm["3"], certainty=Certainty((0.8,), (0.2, 0.8), (0.95, 0.05)))
    own = make_filter(params)
    red, green = (own.chain.class_of == params.states.index(name) for name in ("3-red", "3-green"))
    belief = own.first[None] * red
    belief = own.predict(belief / belief.sum(), 100)
    odds = []
    for share in (0.95, 0.7):
        x = np.where(np.array(params.states) == "3-green", share, (1 - share) / 2)
        state = own.update(belief, likelihood(params, x))[0].sum(axis=0)
        odds.append(state[green].sum() / state[red].sum())
    assert odds[0] / odds[1] > 20


def test_of_two_cameras_the_sure_one_is_heard(hmm: Hmm) -> None:
    params = replace(hmm["3"], certainty=Certainty((0.8,), (0.2, 0.8), (0.95, 0.05)))
    reader = LookReader.of([params], {name: i for i, name in enumerate(params.states)})
    doubting, knowing = np.array([[0.02, 0.5, 0.4]]), np.array([[0.01, 0.01, 0.95]])
    types = np.zeros(1, dtype=int)
    (said, level, alone, _), (said_2, level_2, alone_2, _) = reader.read(doubting, types), reader.read(knowing, types)
    together = seen_likelihood((said + alone) * (said_2 + alone_2), np.maximum(level, level_2))[0]
    assert alone_2 < alone, "who is sure seldom errs alone"
    assert np.argmax(together) == len(params.states) + 2, "yellow, for sure"


def test_an_unsure_camera_does_not_overrule_a_sure_one_however_long_it_dissents(hmm: Hmm) -> None:
    params = replace(hmm["3"], certainty=Certainty((0.8,), (0.2, 0.8), (0.95, 0.05)))
    own, reader = make_filter(params), LookReader.of([params], {name: i for i, name in enumerate(params.states)})
    red, green = (own.chain.class_of == params.states.index(name) for name in ("3-red", "3-green"))
    belief = own.first[None] * green
    belief /= belief.sum()
    looks = np.full((2, 3), 0.01)
    looks[0, params.states.index("3-green")] = 0.97
    looks[1, params.states.index("3-red")], looks[1, params.states.index("3-green")] = 0.7, 0.28
    for _ in range(10):
        said, reached, alone, _ = reader.read(looks, np.zeros(2, dtype=int))
        both = seen_likelihood((said + alone[:, None]).prod(axis=0)[None], reached.max(axis=0)[None])
        belief = own.update(own.predict(belief, 100), both)
        state = belief[0].sum(axis=0)
        assert state[green].sum() > 0.9 > 0.05 > state[red].sum()


def test_a_light_seen_clearly_has_not_changed_because_the_view_became_poor(hmm: Hmm) -> None:
    params = replace(hmm["3"], certainty=Certainty((0.8,), (0.2, 0.8), (0.95, 0.05)))
    own = make_filter(params)
    yellow, red = (params.states.index(name) for name in ("3-yellow", "3-red"))
    doubt = likelihood(params, np.eye(3)[red] * 0.4 + 0.2)
    odds = []
    for level in (0, 1):
        belief = np.zeros_like(own.first)[None]
        belief[0, level * 3 + yellow] = own.first[yellow] * (own.chain.class_of == yellow)
        state = own.update(own.predict(belief / belief.sum(), 100), doubt)[0].sum(axis=0)
        odds.append(state[own.chain.class_of == red].sum() / state[own.chain.class_of == yellow].sum())
    assert odds[0] > 2 * odds[1]


def test_after_an_error_the_truth_comes_second(hmm: Hmm) -> None:
    params = replace(hmm["4"], certainty=Certainty(second_if_wrong=0.9))
    own, k = make_filter(params), len(params.states)
    lead, second = (params.states.index(name) for name in ("4-rleft", "4-yleft1"))
    vector = np.full((1, k), 1e-6)
    vector[0, lead], vector[0, second] = 0.7, 0.2
    (factors,) = own.seconds(vector)
    of_class = {int(c): factors[lead, own.chain.class_of == c] for c in range(k)}
    errors = params.observation[lead] * (np.arange(k) != lead)
    for c, factor in of_class.items():
        expected = 0.9 if c == second else errors[second] / errors.sum() if c == lead else 0.1 / (k - 2)
        np.testing.assert_allclose(factor, expected, rtol=1e-6)
    np.testing.assert_allclose(np.delete(factors, lead, axis=0), 1.0, rtol=1e-12)


def test_a_class_that_only_noise_puts_second_says_nothing_of_the_others(hmm: Hmm) -> None:
    params = replace(hmm["4"], certainty=Certainty(second_if_wrong=0.9))
    own, k = make_filter(params), len(params.states)
    vector = np.full((1, k), 0.02)
    vector[0, 0] = 0.9
    (factors,) = own.seconds(vector)
    np.testing.assert_allclose(factors[0], 1 / (k - 1))


def test_types_must_tell_equally_many_levels_apart(hmm: Hmm) -> None:
    other = replace(hmm["3"], certainty=Certainty((0.8,), (0.2, 0.8), (0.95, 0.05)))
    with pytest.raises(UsageError, match=r"equally many levels of certainty apart, got \[1, 2\]"):
        LookReader.of([hmm["4"], other], {name: i for i, name in enumerate(SIGNALS.classes)})


def test_single_precision_says_the_same(hmm: Hmm) -> None:
    """Five minutes at ten sets a second: lights of all types, two in each group, whose looks contradict each other."""
    certainty = Certainty((0.73, 0.88), (0.03, 0.09, 0.88), (0.67, 0.25, 0.08), 0.6)
    params = [replace(own, certainty=certainty) for own in hmm.values()]
    chains = [HiddenChain.of(own.type, SIGNALS, own, stages=4, odd_changes_per_hour=1.0) for own in params]
    types = np.arange(len(params)).repeat(2)
    partners, rng = Partners.of(types), np.random.default_rng(5)
    filters = [
        AppearanceFilter.of(chains, params, error_duration_s=0.4, dtype=dtype) for dtype in (np.float64, np.float32)
    ]
    beliefs = [own.first[types][:, None].repeat(2, axis=1) for own in filters]
    worst = 0.0
    for i in range(3000):
        if i % 6 == 0:  # an appearance lasts
            look = rng.random((len(types), filters[0].first.shape[1])) ** rng.integers(1, 12) + 1e-9
        leading = rng.random((1, 5))
        states = []
        for n, own in enumerate(filters):
            lights = own.lights(types)
            moved, before = own.predict(beliefs[n], lights, 100)
            second = (np.array([i % len(types)]), *own.seconds(leading, types[[i % len(types)]])) if i % 3 else None
            beliefs[n], after = own.update(moved, before, lights, look, partners, second)
            states.append(after)
        assert beliefs[1].dtype == states[1].dtype == np.float32
        worst = max(worst, float(np.abs(states[0] - states[1]).max()))
    assert worst < 2e-4


def test_two_half_times_are_one(hmm: Hmm) -> None:
    own = make_filter(hmm["4"], stages=8)
    np.testing.assert_allclose(
        own.predict(own.predict(own.first[None], 40), 60).sum(axis=1), own.predict(own.first[None], 100).sum(axis=1)
    )


def test_a_group_of_one_is_a_light_alone(hmm: Hmm) -> None:
    own = make_filter(hmm["3"], stages=8)
    likelihood = np.random.default_rng(0).random((3, len(own.looks)))
    beliefs = own.predict(np.stack([own.first] * 3), 100)
    np.testing.assert_allclose(
        own.update_together(beliefs, likelihood, Partners.of(np.full(3, -1))),
        own.update(beliefs, likelihood),
        atol=1e-12,
    )


def test_a_group_is_one_light_seen_several_times_where_errors_do_not_last(hmm: Hmm) -> None:
    own = make_filter(hmm["3"], error_duration_s=0)
    likelihood = np.random.default_rng(0).random((2, len(own.looks)))
    beliefs = own.predict(np.stack([own.first] * 2), 100)
    together = own.update_together(beliefs, likelihood, Partners.of(np.zeros(2, dtype=np.int64)))
    state = own.predict(own.first[None], 100).sum(axis=1)[0]
    for row in likelihood:
        state = state * (row @ own.looks)
    for belief in together:
        np.testing.assert_allclose(belief.sum(axis=0), state / state.sum(), atol=1e-12)


def test_what_the_model_calls_impossible_is_believed_as_at_first_sight(hmm: Hmm) -> None:
    own = make_filter(hmm["3"])
    belief = np.zeros((1, *own.first.shape))
    belief[0, 0, 0] = 1.0
    likelihood = np.zeros((1, len(own.looks)))
    likelihood[0, 1] = 1.0
    np.testing.assert_allclose(own.update(belief, likelihood)[0].sum(axis=0), own.first[1] / own.first[1].sum())


def test_a_look_at_another_type_says_nothing(hmm: Hmm) -> None:
    params = replace(hmm["3"], certainty=Certainty((0.5, 0.8), (0.1, 0.2, 0.7), (0.6, 0.3, 0.1)))
    looks = likelihood(params, np.zeros(3))[0, :-1].reshape(3, 3)
    np.testing.assert_allclose(looks, looks[:1].repeat(3, axis=0), err_msg="each level is as likely as the others")
