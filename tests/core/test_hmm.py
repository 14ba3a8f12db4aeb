import json
from dataclasses import replace

import numpy as np
import pytest

from autolights.core import Certainty, HmmParameters, load_hmm, save_hmm
from autolights.core.errors import DataError


@pytest.fixture
def hmm():
    return HmmParameters(
        type="3",
        states=("3-green", "3-red"),
        initial=[0.25, 0.75],
        rates=[[-0.5, 0.5], [0.1, -0.1]],
        nominal_dt_s=0.1,
        transition=[[0.95, 0.05], [0.01, 0.99]],
        observation=[[0.9, 0.1], [0.2, 0.8]],
        evidence=[[0.9, 0.1], [0.1, 0.9]],
        miss_probs=[0.1, 0.0],
        counts=[[9, 1], [2, 8]],
        provenance={"prior": "uniform", "pseudocount": 1.0},
    )


def test_file_reads_back(hmm, tmp_path):
    save_hmm(tmp_path / "hmm.json", {"3": hmm})

    read = load_hmm(tmp_path / "hmm.json")["3"]

    assert read.to_json() == hmm.to_json()
    np.testing.assert_array_equal(read.transition, [[0.95, 0.05], [0.01, 0.99]])


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        pytest.param(
            "transition",
            [[0.9, 0.1], [0.01, 0.97]],
            r"transition\['3'\] rows must sum to 1, got \[1.0, 0.98\]",
            id="A",
        ),
        pytest.param("observation", [[1.1, -0.1], [0, 1]], r"observation\['3'\] must not be negative", id="B"),
        pytest.param(
            "evidence", [[0.9, 0.1], [0.2, 0.8]], r"evidence\['3'\] columns must sum to 1, got \[1.1, 0.9\]", id="C"
        ),
        pytest.param("initial", [0.5, 0.6], r"initial\['3'\] must sum to 1, got \[1.1\]", id="pi"),
        pytest.param("rates", [[-1, 0.5], [0, 0]], r"rates\['3'\] rows must sum to 0, got \[-0.5, 0.0\]", id="Q"),
        pytest.param("rates", [[1, -1], [0, 0]], r"rates\['3'\] must not be negative off the diagonal", id="Q-sign"),
        pytest.param("miss_probs", [0.1, 1.2], r"miss_probs\['3'\] must lie in \[0, 1\], got 1.2", id="misses"),
        pytest.param("miss_probs", [0.1], r"miss_probs\['3'\] must have shape \(2\), got \(1,\)", id="shape"),
        pytest.param("counts", [[np.nan, 0], [0, 0]], r"counts\['3'\] must be finite", id="nan"),
        pytest.param("nominal_dt_s", 0.0, r"nominal_dt_s\['3'\] must be positive", id="dt"),
    ],
)
def test_numbers_no_model_can_have(hmm, field, value, message):
    with pytest.raises(ValueError, match=message):
        replace(hmm, **{field: value})


def test_altered_file_is_named(hmm, tmp_path):
    path = tmp_path / "hmm.json"
    values = {"3": hmm.to_json()}
    values["3"]["observation"][0][0] = 0.5
    path.write_text(json.dumps(values))

    with pytest.raises(DataError, match=r"hmm\.json: HMM parameters: observation\['3'\] rows must sum to 1"):
        load_hmm(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        pytest.param("{", r"hmm\.json: not JSON", id="no-json"),
        pytest.param("[]", r"hmm\.json: must hold a JSON object, got list", id="list"),
        pytest.param('{"3": {}}', r"hmm\.json: HMM parameters: field 'initial' is missing", id="field"),
    ],
)
def test_broken_files(tmp_path, text, message):
    (tmp_path / "hmm.json").write_text(text)

    with pytest.raises(DataError, match=message):
        load_hmm(tmp_path / "hmm.json")


def test_missing_file(tmp_path):
    with pytest.raises(DataError, match=r"gone\.json: cannot be read \(No such file"):
        load_hmm(tmp_path / "gone.json")


def test_the_two_levels_of_older_bundles_are_read() -> None:
    old = {"threshold": 0.9, "sure_if_right": 0.75, "sure_if_wrong": 0.25}
    assert Certainty.from_json(old) == Certainty((0.9,), (0.25, 0.75), (0.75, 0.25))
    three = Certainty((0.5, 0.9), (0.1, 0.2, 0.7), (0.6, 0.3, 0.1), 0.8)
    assert Certainty.from_json(three.to_json()) == three


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (((0.9, 0.5), (0.2, 0.3, 0.5), (0.2, 0.3, 0.5)), r"thresholds must ascend within \(0, 1\), got \[0.9, 0.5\]"),
        (((0.5,), (0.2, 0.7), (0.5, 0.5)), r"if_right must hold 2 probabilities that sum to 1, .* got \[0.2, 0.7\]"),
        (((0.5,), (0.3, 0.7), (1.0,)), r"if_wrong must hold 2 probabilities"),
    ],
)
def test_levels_of_certainty_fit_together(values: tuple[tuple[float, ...], ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Certainty(*values)
