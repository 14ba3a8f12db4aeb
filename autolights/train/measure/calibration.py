"""Does a probability of 0.9 mean nine times out of ten? Temperature and certainty, fitted on validation images.

References:
    Guo et al. 2017, On calibration of modern neural networks (temperature scaling, expected calibration error).
"""

import numpy as np
from scipy.optimize import minimize_scalar

from autolights.core import BoolArray, Certainty, FloatArray, IntArray
from autolights.core.calibration import Calibration

_TEMPERATURES = (0.2, 5.0)
_PRIOR_SIGMA = 0.5  # of log temperature: a handful of images must not make a detector all-knowing
_BINS = 15
_THRESHOLDS = np.arange(0.3, 0.995, 0.01)
_FLOOR = 1e-6  # of a sigmoid


def fit_calibration(class_probs: FloatArray, truth_ids: IntArray) -> Calibration | None:
    """Fit how to read class vectors.

    The temperature is the one under which the true classes are most probable, with a log-normal prior around 1 that
    weighs as much as one look. The threshold of certainty is the one that tells most about right and wrong, both
    counted with one more of each kind.

    Args:
        class_probs: (n, C) sigmoids of detections that were matched to labels.
        truth_ids: (n,) classes of the labels.

    Returns:
        None without a match.
    """
    if not len(truth_ids):
        return None
    every = np.arange(len(truth_ids))
    logs = np.log(np.maximum(class_probs, _FLOOR))

    def loss(log_temperature: float) -> float:
        nll = -_log_shares(logs, np.exp(log_temperature))[every, truth_ids].sum()
        return float(nll + (log_temperature / _PRIOR_SIGMA) ** 2 / 2)

    bounds = tuple(np.log(_TEMPERATURES))
    temperature = float(np.exp(minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 1e-4}).x))
    before, after = np.exp(_log_shares(logs, 1.0)), np.exp(_log_shares(logs, temperature))
    right = np.argmax(class_probs, axis=1) == truth_ids
    return Calibration(
        temperature=round(temperature, 4),
        certainty=_certainty(after.max(axis=1), right),
        matched=len(truth_ids),
        wrong=int((~right).sum()),
        nll=(_mean_nll(before, truth_ids), _mean_nll(after, truth_ids)),
        expected_error=(expected_error(before.max(axis=1), right), expected_error(after.max(axis=1), right)),
    )


def expected_error(confidence: FloatArray, right: BoolArray) -> float:
    """Mean distance between confidence and share of right answers, over 15 bins of confidence weighted by size."""
    bins = np.minimum((confidence * _BINS).astype(int), _BINS - 1)
    gaps = np.bincount(bins, confidence - right, _BINS)
    return round(float(np.abs(gaps).sum() / len(confidence)), 5)


def _log_shares(logs: FloatArray, temperature: float) -> FloatArray:
    scaled = logs / temperature
    scaled = scaled - scaled.max(axis=1, keepdims=True)
    return np.asarray(scaled - np.log(np.exp(scaled).sum(axis=1, keepdims=True)))


def _mean_nll(shares: FloatArray, truth_ids: IntArray) -> float:
    return round(float(-np.log(shares[np.arange(len(truth_ids)), truth_ids]).mean()), 5)


def _certainty(confidence: FloatArray, right: BoolArray) -> Certainty:
    """The threshold with the largest mutual information between "sure" and "right"."""
    sure = confidence[:, None] >= _THRESHOLDS
    if_right = (sure[right].sum(axis=0) + 1) / (right.sum() + 2)
    if_wrong = (sure[~right].sum(axis=0) + 1) / ((~right).sum() + 2)
    share = (right.sum() + 1) / (len(right) + 2)
    both = share * if_right + (1 - share) * if_wrong
    information = _entropy(both) - share * _entropy(if_right) - (1 - share) * _entropy(if_wrong)
    best = int(np.argmax(np.where(if_right >= if_wrong, information, -1.0)))
    return Certainty(
        threshold=round(float(_THRESHOLDS[best]), 4),
        sure_if_right=round(float(if_right[best]), 5),
        sure_if_wrong=round(float(if_wrong[best]), 5),
    )


def _entropy(probability: FloatArray) -> FloatArray:
    return np.asarray(-probability * np.log(probability) - (1 - probability) * np.log(1 - probability))
