import numpy as np
import pytest
import scipy.linalg

from autolights.core import ConfusionMatrix, load_signals
from autolights.core.errors import ConfigError, UsageError
from autolights.train.deliver.hmm_fitting import fit_hmm, stationary_distribution

SIGNALS = load_signals()
GREEN, RED, YELLOW = 0, 1, 2  # states of type "3"


def confusion(entries, score_threshold=0.25):
    """Counts from {(truth, predicted): n}; None is background."""
    index = {**SIGNALS.class_ids, None: len(SIGNALS.classes)}
    counts = np.zeros((len(index), len(index)), dtype=np.int64)
    for (truth, predicted), count in entries.items():
        counts[index[truth], index[predicted]] = count
    return ConfusionMatrix(SIGNALS.classes, counts, score_threshold, 0.5)


COUNTED = confusion(
    {
        ("3-green", "3-green"): 8,
        ("3-green", "3-red"): 2,
        ("3-green", None): 5,
        ("3-red", "3-red"): 97,
        ("3-red", "3-yellow"): 3,
        ("3-red", "4-rleft"): 20,
        ("3-red", None): 5,
        ("3-yellow", "3-yellow"): 1,
        (None, "3-red"): 1000,
    }
)


def test_observation_is_the_block_of_the_type_with_rows_normalised():
    hmm = fit_hmm(COUNTED, SIGNALS, pseudocount=1)["3"]

    expected = [[9 / 13, 3 / 13, 1 / 13], [1 / 103, 98 / 103, 4 / 103], [1 / 4, 1 / 4, 2 / 4]]
    np.testing.assert_allclose(hmm.observation, expected)
    assert hmm.counts.tolist() == [[8, 2, 0], [0, 97, 3], [0, 0, 1]]


def test_evidence_ignores_the_class_balance_unless_asked():
    b = np.array([[0.8, 0.2, 0], [0, 0.97, 0.03], [0, 0, 1]])

    uniform = fit_hmm(COUNTED, SIGNALS, pseudocount=1e-9)["3"].evidence
    empirical = fit_hmm(COUNTED, SIGNALS, pseudocount=1e-9, prior="empirical")["3"].evidence

    np.testing.assert_allclose(uniform, b / b.sum(axis=0), atol=1e-6)
    # With the data's balance: of 99 lights that looked red, 97 were.
    np.testing.assert_allclose(empirical[:, RED], [2 / 99, 97 / 99, 0], atol=1e-6)


def test_other_types_and_background_are_misses():
    hmm = fit_hmm(COUNTED, SIGNALS, pseudocount=1)["3"]

    np.testing.assert_allclose(hmm.miss_probs, [(5 + 1) / (15 + 2), (25 + 1) / (125 + 2), 1 / 3])
    assert hmm.provenance["missed_counts"] == [5, 25, 0]


def test_time_comes_from_the_signal_description():
    hmm = fit_hmm(COUNTED, SIGNALS, nominal_dt_s=0.05)["3"]

    # green 15 s → yellow 4 s → red 20 s → green
    rates = np.array([[-1 / 15, 0, 1 / 15], [1 / 20, -1 / 20, 0], [0, 1 / 4, -1 / 4]])
    np.testing.assert_allclose(hmm.rates, rates)
    np.testing.assert_allclose(hmm.transition, scipy.linalg.expm(rates * 0.05))
    np.testing.assert_allclose(hmm.initial, np.array([15, 20, 4]) / 39)
    assert hmm.nominal_dt_s == 0.05


@pytest.mark.parametrize("type_name", list(SIGNALS.types))
def test_initial_distribution_does_not_drift(type_name):
    hmm = fit_hmm(COUNTED, SIGNALS)[type_name]

    np.testing.assert_allclose(hmm.initial @ hmm.rates, 0, atol=1e-12)
    np.testing.assert_allclose(hmm.initial @ scipy.linalg.expm(hmm.rates * 1000), hmm.initial)
    assert (hmm.initial > 0).all()


def test_stationary_distribution_of_an_absorbing_chain():
    np.testing.assert_allclose(stationary_distribution(np.array([[-1.0, 1.0], [0.0, 0.0]])), [0, 1], atol=1e-12)


def test_all_types_are_fitted_in_the_order_of_the_detector():
    hmm = fit_hmm(COUNTED, SIGNALS)

    assert {name: parameters.states for name, parameters in hmm.items()} == {
        name: SIGNALS.states_of(name) for name in ("3", "4", "5dh")
    }


def test_provenance_tells_how_it_was_made():
    provenance = fit_hmm(confusion({}, score_threshold=0.4), SIGNALS, pseudocount=2, prior="empirical")["4"].provenance

    assert provenance["score_threshold"] == 0.4
    assert (provenance["prior"], provenance["pseudocount"], provenance["signals"]) == ("empirical", 2, "autolights_13")
    assert provenance["overrides"] == {}


def test_overrides_replace_what_they_name_only():
    plain = fit_hmm(COUNTED, SIGNALS)["3"]
    overrides = {
        3: {  # YAML reads a bare 3 as a number
            "rates": {"3-red": {"3-green": 0.5}},
            "observation": {"3-yellow": {"3-yellow": 0.9, "3-red": 0.1}},
            "initial": {"3-red": 1.0},
        }
    }

    tuned = fit_hmm(COUNTED, SIGNALS, overrides=overrides)["3"]

    assert tuned.rates[RED].tolist() == [0.5, -0.5, 0]
    np.testing.assert_array_equal(tuned.rates[[GREEN, YELLOW]], plain.rates[[GREEN, YELLOW]])
    np.testing.assert_allclose(tuned.transition, scipy.linalg.expm(tuned.rates * 0.1))
    assert tuned.observation[YELLOW].tolist() == [0, 0.1, 0.9]
    np.testing.assert_array_equal(tuned.observation[GREEN], plain.observation[GREEN])
    np.testing.assert_allclose(tuned.evidence, tuned.observation / tuned.observation.sum(axis=0))
    assert tuned.initial.tolist() == [0, 1, 0]
    assert tuned.provenance["overrides"] == overrides[3]


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        pytest.param({"7": {}}, "unknown type '7'; there are: 3, 4, 5dh", id="type"),
        pytest.param({"3": {"rate": {}}}, "unknown key 'rate' in types.3; did you mean 'rates'", id="field"),
        pytest.param(
            {"3": {"rates": {"3-red": {"4-off": 1}}}},
            "unknown class '4-off' in 3.rates; there are: 3-green",
            id="class",
        ),
        pytest.param({"3": {"rates": {"3-red": {"3-red": 1}}}}, "3.rates.3-red must hold rates of at", id="diagonal"),
        pytest.param({"3": {"rates": {"3-red": {"3-green": -1}}}}, "3.rates.3-red must hold", id="negative"),
        pytest.param({"3": {"initial": {"3-red": 0.9}}}, "3.initial must hold probabilities that sum to 1", id="sum"),
        pytest.param(
            {"3": {"observation": {"3-red": {"3-red": 1.2, "3-green": -0.2}}}},
            "3.observation.3-red must hold probabilities",
            id="negative-probability",
        ),
    ],
)
def test_wrong_overrides(overrides, message):
    with pytest.raises(ConfigError, match=message):
        fit_hmm(COUNTED, SIGNALS, overrides=overrides)


def test_a_state_that_was_never_seen_needs_a_pseudocount():
    with pytest.raises(UsageError, match=r"'4-gleft' was never detected as type '4'.*use a pseudocount"):
        fit_hmm(COUNTED, SIGNALS, pseudocount=0)


def test_classes_must_be_those_of_the_signals():
    other = ConfusionMatrix(("red", "green"), np.zeros((3, 3), dtype=np.int64), 0.25, 0.5)

    with pytest.raises(UsageError, match=r"knows the classes \['red', 'green'\], the signal description"):
        fit_hmm(other, SIGNALS)
