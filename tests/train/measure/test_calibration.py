import numpy as np
import pytest

from autolights.core.calibration import Calibration
from autolights.core.errors import DataError
from autolights.train.measure.calibration import expected_error, fit_calibration


def overconfident(count: int, temperature: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Truth drawn from softmax(logits); the detector reports softmax(logits * temperature)."""
    rng = np.random.default_rng(seed)
    logits = rng.normal(0, 2.5, (count, 4))
    honest = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    truth = (honest.cumsum(axis=1) < rng.random((count, 1))).sum(axis=1)
    loud = np.exp(logits * temperature)
    return loud / loud.sum(axis=1, keepdims=True), truth


@pytest.mark.parametrize("temperature", [0.7, 1.0, 2.5])
def test_the_temperature_that_was_put_in_is_found(temperature: float) -> None:
    fitted = fit_calibration(*overconfident(20_000, temperature))
    assert fitted is not None
    assert fitted.temperature == pytest.approx(temperature, rel=0.05)
    assert fitted.expected_error[1] < 0.015
    assert fitted.nll[1] <= fitted.nll[0]


def test_a_handful_of_looks_moves_little() -> None:
    class_probs = np.full((3, 4), 0.01)
    class_probs[:, 0] = 0.9
    fitted = fit_calibration(class_probs, np.zeros(3, dtype=int))
    assert fitted is not None
    assert 0.6 < fitted.temperature <= 1.0
    assert fitted.certainty.if_wrong == pytest.approx((1 / 3,) * 3, abs=1e-4), (
        "nothing wrong was seen, nothing is known"
    )


def test_being_sure_is_worth_what_was_counted() -> None:
    rng = np.random.default_rng(1)
    right = rng.random(5000) < 0.9
    sure = np.where(right, rng.random(5000) < 0.8, rng.random(5000) < 0.1)
    class_probs = np.full((5000, 3), 0.005)
    class_probs[:, 0] = np.where(sure, 0.97, 0.6)
    class_probs[:, 2] = np.where(sure, 0.01, 0.35)
    fitted = fit_calibration(class_probs, np.where(right, 0, 2))
    assert fitted is not None
    assert fitted.certainty.if_right[-1] == pytest.approx(0.8, abs=0.02)
    assert fitted.certainty.if_wrong[-1] == pytest.approx(0.1, abs=0.03)
    assert fitted.certainty.second_if_wrong > 0.99, "the truth came second each time"


def test_expected_error_by_hand() -> None:
    confidence, right = np.array([0.95, 0.95, 0.55, 0.55]), np.array([True, True, True, False])
    assert expected_error(confidence, right) == pytest.approx((2 * 0.05 + 2 * 0.05) / 4)


def test_nothing_matched_is_nothing_fitted() -> None:
    assert fit_calibration(np.empty((0, 3)), np.empty(0, dtype=int)) is None


def test_reads_back() -> None:
    fitted = fit_calibration(*overconfident(200, 2.0))
    assert fitted is not None
    assert Calibration.from_json(fitted.to_json()) == fitted
    with pytest.raises(DataError, match="calibration: field 'matched' is missing"):
        Calibration.from_json({k: v for k, v in fitted.to_json().items() if k != "matched"})
