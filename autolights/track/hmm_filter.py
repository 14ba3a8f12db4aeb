"""The forward algorithm of one type of light as the paper has it, as pure functions (Wu et al. 2023, Sec. III-D).

Beliefs are arrays of (..., k) whose last axis runs over the type's states and sums to 1; leading axes are tracks.
"""

from functools import lru_cache

import numpy as np
import scipy.linalg

from autolights.core import FloatArray, HmmParameters


def hmm_predict(belief: FloatArray, params: HmmParameters, dt_s: float | None) -> FloatArray:
    """Let time pass: α ← A(Δt)ᵀ α with A(Δt) = expm(Q Δt).

    Args:
        belief: (..., k).
        params: Of the type.
        dt_s: Seconds since `belief`, at least 0; None takes the fixed A of one nominal frame, as the paper does.

    Returns:
        (..., k).

    Raises:
        ValueError: If `dt_s` is negative.
    """
    # Rows of A are "from", columns "to": a row vector goes in from the left.
    return np.asarray(belief @ (params.transition if dt_s is None else transition_over(params, dt_s)))


def transition_over(params: HmmParameters, dt_s: float) -> FloatArray:
    """(k, k) A(Δt) = expm(Q Δt), to the millisecond, so that the few frame times of a drive are computed once.

    Raises:
        ValueError: If `dt_s` is negative.
    """
    if dt_s < 0:
        raise ValueError(f"dt_s must not be negative, got {dt_s}")
    return _transition_over_ms(params, round(dt_s * 1000))


def hmm_update(predicted: FloatArray, class_probs: FloatArray, params: HmmParameters) -> FloatArray:
    """Take in an observation: α ∝ c ⊙ α, c = C x, x the class vector over the type's states, calibrated, sum 1.

    Two cameras at one instant are one prediction and two updates.

    Args:
        predicted: (..., k) belief before the observation.
        class_probs: (..., k) what the detector says of the type's states, not negative; all zero says nothing.
        params: Of the type.

    Returns:
        (..., k). Where the model calls the observation impossible, the observation alone is believed.
    """
    k = len(params.states)
    class_probs = class_probs ** (1 / params.temperature)
    total = class_probs.sum(axis=-1, keepdims=True)
    x = np.divide(class_probs, total, out=np.full_like(class_probs, 1 / k, dtype=np.float64), where=total > 0)
    evidence = np.where(total > 0, x @ params.evidence.T, 1.0)
    posterior = evidence * predicted
    mass = posterior.sum(axis=-1, keepdims=True)
    posterior = np.where(mass > 0, posterior, evidence)
    return np.asarray(posterior / posterior.sum(axis=-1, keepdims=True))


@lru_cache(maxsize=1024)
def _transition_over_ms(params: HmmParameters, dt_ms: int) -> FloatArray:
    # Rounding may leave entries of -1e-19; a probability is not negative.
    transition = scipy.linalg.expm(params.rates * (dt_ms / 1000)).clip(min=0)
    transition /= transition.sum(axis=1, keepdims=True)
    transition.flags.writeable = False
    return np.asarray(transition)
