"""Does a probability of 0.9 mean nine times out of ten? Temperature and certainty, fitted on validation images.

References:
    Guo et al. 2017, On calibration of modern neural networks (temperature scaling, expected calibration error).
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.optimize import minimize_scalar

from autolights.core import BoolArray, Certainty, FloatArray, IntArray
from autolights.core.calibration import Calibration

_TEMPERATURES = (0.2, 5.0)
_PRIOR_SIGMA = 0.5  # of log temperature: a handful of images must not make a detector all-knowing
_BINS = 15
_LEVELS = 3
_THRESHOLDS = 1 / (1 + np.exp(-np.arange(-1.0, 6.01, 0.2)))  # even in log odds
_FLOOR = 1e-6  # of a sigmoid


def fit_calibration(class_probs: FloatArray, truth_ids: IntArray) -> Calibration | None:
    """Fit how to read class vectors.

    The temperature is the one under which the true classes are most probable, with a log-normal prior around 1 that
    weighs as much as one look. The levels of certainty are those that tell most about right and wrong.

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
        certainty=replace(_certainty(after.max(axis=1), right), second_if_wrong=_second(class_probs, truth_ids, right)),
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
    """The thresholds with the largest mutual information between the level of confidence and "right".

    Each level counts one more of each kind, so what was seen little says little; a surer level is worth more.
    """
    best, found = -1.0, Certainty()
    above = confidence[:, None] >= _THRESHOLDS
    right_above, wrong_above = above[right].sum(axis=0), above[~right].sum(axis=0)
    share = (right.sum() + 1) / (len(right) + 2)
    for chosen in combinations(range(len(_THRESHOLDS)), _LEVELS - 1):
        counts = np.array(
            [
                -np.diff(np.concatenate([[total], of_kind[list(chosen)], [0]])) + 1.0
                for total, of_kind in ((right.sum(), right_above), ((~right).sum(), wrong_above))
            ]
        )
        if_right, if_wrong = counts / counts.sum(axis=1, keepdims=True)
        if (np.diff(if_right / if_wrong) < 0).any():
            continue
        both = share * if_right + (1 - share) * if_wrong
        information = _entropy(both) - share * _entropy(if_right) - (1 - share) * _entropy(if_wrong)
        if information > best:
            thresholds = tuple(round(float(_THRESHOLDS[i]), 4) for i in chosen)
            best, found = information, Certainty(thresholds, _rounded(if_right), _rounded(if_wrong))
    return found


def _second(class_probs: FloatArray, truth_ids: IntArray, right: BoolArray) -> float:
    """How often the true class comes second where another one leads, counted with one more of each kind."""
    beaten = class_probs[~right]
    hits = ((beaten > beaten[np.arange(len(beaten)), truth_ids[~right], None]).sum(axis=1) == 1).sum()
    return round(float((hits + 1) / (len(beaten) + 2)), 5)


def _rounded(probs: FloatArray) -> tuple[float, ...]:
    return tuple(round(float(p), 5) for p in probs)


def _entropy(probs: FloatArray) -> float:
    return float(-(probs * np.log(probs)).sum())
