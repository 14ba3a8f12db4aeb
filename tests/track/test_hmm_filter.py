from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from autolights.core import HmmParameters
from autolights.track import hmm_predict, hmm_update, transition_over


@pytest.fixture(params=["3", "4", "5dh"])
def params(request: pytest.FixtureRequest, hmm: dict[str, HmmParameters]) -> HmmParameters:
    return hmm[request.param]


def test_filter_is_the_sum_over_all_state_paths(params: HmmParameters) -> None:
    rng = np.random.default_rng(3)
    k = len(params.states)
    # Not symmetric: columns of C sum to 1, rows do not.
    params = replace(params, evidence=rng.dirichlet(np.ones(k), k).T)
    # Uneven frame times; 0.0 is a second camera at the same instant: no prediction, another update.
    steps_s = [0.1, 0.0, 0.333, 0.05]
    vectors = rng.dirichlet(np.ones(k), len(steps_s))
    belief = params.initial
    for dt_s, x in zip(steps_s, vectors, strict=True):
        belief = hmm_update(hmm_predict(belief, params, dt_s), x, params)

    summed = np.zeros(k)
    for path in product(range(k), repeat=len(steps_s) + 1):
        mass = params.initial[path[0]]
        for t, (dt_s, x) in enumerate(zip(steps_s, vectors, strict=True), start=1):
            mass *= scipy.linalg.expm(params.rates * dt_s)[path[t - 1], path[t]]
            mass *= sum(x[seen] * params.evidence[path[t], seen] for seen in range(k))
        summed[path[-1]] += mass
    np.testing.assert_allclose(belief, summed / summed.sum(), atol=1e-12)


def test_paper_takes_one_nominal_step_whatever_the_time(params: HmmParameters) -> None:
    np.testing.assert_allclose(hmm_predict(params.initial, params, None), params.transition.T @ params.initial)


def test_two_short_steps_are_one_long_step(params: HmmParameters) -> None:
    belief = np.eye(len(params.states))[0]
    twice = hmm_predict(hmm_predict(belief, params, 0.2), params, 0.3)
    np.testing.assert_allclose(twice, hmm_predict(belief, params, 0.5), atol=1e-12)


def test_time_does_not_run_backwards(params: HmmParameters) -> None:
    with pytest.raises(ValueError, match=r"dt_s must not be negative, got -0\.1"):
        transition_over(params, -0.1)


def test_no_information_changes_nothing(params: HmmParameters) -> None:
    belief = np.random.default_rng(0).dirichlet(np.ones(len(params.states)))
    np.testing.assert_allclose(hmm_update(belief, np.zeros_like(belief), params), belief)


def test_temperature_comes_before_the_evidence(params: HmmParameters) -> None:
    k = len(params.states)
    x = np.random.default_rng(2).dirichlet(np.ones(k))
    softer = x**0.5 / (x**0.5).sum()
    np.testing.assert_allclose(
        hmm_update(params.initial, x, replace(params, temperature=2.0)), hmm_update(params.initial, softer, params)
    )


def test_what_the_model_calls_impossible_is_believed_afresh(params: HmmParameters) -> None:
    k = len(params.states)
    certain = replace(params, evidence=np.eye(k))
    posterior = hmm_update(np.eye(k)[0], np.eye(k)[1], certain)
    np.testing.assert_allclose(posterior, np.eye(k)[1])


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_beliefs_sum_to_one_and_inputs_stay(data: st.DataObject) -> None:
    params = HYPOTHESIS_PARAMS
    n, k = data.draw(st.integers(0, 4)), len(params.states)
    x = data.draw(arrays(float, (n, k), elements=st.floats(0, 1)))
    belief = np.tile(params.initial, (n, 1))
    given_x, given_belief = x.copy(), belief.copy()
    posterior = hmm_update(hmm_predict(belief, params, data.draw(st.floats(0, 100))), x, params)
    np.testing.assert_allclose(posterior.sum(axis=-1), 1)
    assert (posterior >= 0).all()
    np.testing.assert_array_equal(x, given_x)
    np.testing.assert_array_equal(belief, given_belief)


_K = 3
HYPOTHESIS_PARAMS = HmmParameters(
    type="t",
    states=("a", "b", "c"),
    initial=np.full(_K, 1 / _K),
    rates=np.array([[-1.0, 1, 0], [0, -0.5, 0.5], [0.2, 0, -0.2]]),
    nominal_dt_s=0.1,
    transition=np.eye(_K),
    observation=np.eye(_K),
    evidence=np.eye(_K),
    miss_probs=np.zeros(_K),
    counts=np.zeros((_K, _K)),
    provenance={},
)
