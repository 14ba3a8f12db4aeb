"""The error of a camera that explains most pairs of one image: each pair proposes one, and all others vote on it.

References:
    Hough 1962 and Fischler & Bolles 1981 in spirit: hypotheses from the least possible data, judged by all data.
"""

import numpy as np

from autolights.core import BoolArray, FloatArray

MAX_HEIGHT_RATIO = 1.6  # of a pair's boxes; half-hidden heads are left out of the vote
SEARCH_SIGMAS = 3.5  # of what was expected
_GAIN = 4.5  # a pair within three standard deviations speaks for an error, most if it fits exactly
MATCH_SIGMAS = (2 * _GAIN) ** 0.5
AMBIGUOUS_SIGMAS = 3.0  # errors that move no light farther apart are one and the same
_MAX_PROPOSALS = 48  # those nearest to what was expected
_AMBIGUOUS = 1.0  # two errors whose votes differ by less are both possible


def vote(
    offsets: FloatArray, like: BoolArray, jacobians: FloatArray, sigmas_px: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray, int, bool]:
    """The error that explains most pairs.

    Args:
        offsets: (n, m, 2) pixels from each light to each detection.
        like: (n, m) pairs that may vote.
        jacobians: (n, 2, 4) pixels per unit of the error.
        sigmas_px: (n,) of a pair with the right error.
        prior: (4, 4) covariance of the error, whose mean is 0.

    Returns:
        (4,) error, (4, 4) its covariance, the number of pairs that agree, and whether it is beyond doubt.
    """
    lights, detections = np.nonzero(like)
    if not len(lights):
        return np.zeros(4), prior, 0, False
    # Of all errors that bring a light onto a detection, the most probable one: P Jᵀ (J P Jᵀ)⁻¹ d.
    spread = jacobians @ prior @ jacobians.swapaxes(1, 2)
    gains = prior @ jacobians.swapaxes(1, 2) @ np.linalg.inv(spread)
    proposals = np.einsum("cij,cj->ci", gains[lights], offsets[lights, detections])
    precision = np.linalg.inv(prior)
    surprise = np.einsum("ci,ij,cj->c", proposals, precision, proposals)
    order = np.argsort(surprise)[:_MAX_PROPOSALS]
    order = order[surprise[order] < SEARCH_SIGMAS**2]
    proposals = np.concatenate([np.zeros((1, 4)), proposals[order]])
    penalties = np.concatenate([[0.0], surprise[order]]) / 2

    squares = _squares(offsets, like, jacobians, sigmas_px, proposals)
    agreement = np.maximum(_GAIN - squares / 2, 0.0)
    # One detection cannot speak for two lights, nor one light for two detections.
    votes = np.minimum(agreement.max(axis=2).sum(axis=1), agreement.max(axis=1).sum(axis=1)) - penalties
    best = int(np.argmax(votes))
    if votes[best] <= 0:
        return np.zeros(4), prior, 0, False
    error, covariance, pairs = _fit(squares[best], offsets, jacobians, sigmas_px, precision)
    if pairs < 2:
        # One pair alone may be the neighbour. It sharpens what is known, if it agrees with it.
        error, covariance, pairs = _fit(squares[0], offsets, jacobians, sigmas_px, precision)
        return error, covariance, pairs, pairs > 0
    moved_px = np.abs(jacobians @ (proposals - proposals[best]).T).max(axis=(0, 1))
    others = moved_px > AMBIGUOUS_SIGMAS * sigmas_px.max()
    sure = votes[best] - votes[others].max(initial=-np.inf) > _AMBIGUOUS
    return error, covariance, pairs, bool(sure)


def _squares(
    offsets: FloatArray, like: BoolArray, jacobians: FloatArray, sigmas_px: FloatArray, errors: FloatArray
) -> FloatArray:
    """(c, n, m) squared distances in standard deviations with each of (c, 4) errors; infinite where not alike."""
    moved = (jacobians @ errors.T).transpose(2, 0, 1)
    rest = offsets[None] - moved[:, :, None, :]
    squares = (rest[..., 0] ** 2 + rest[..., 1] ** 2) / (sigmas_px**2)[None, :, None]
    squares[:, ~like] = np.inf
    return np.asarray(squares)


def _fit(
    squares: FloatArray, offsets: FloatArray, jacobians: FloatArray, sigmas_px: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray, int]:
    """Weighted least squares over the pairs that are each other's nearest, with the prior as one more equation."""
    nearest, back = squares.argmin(axis=1), squares.argmin(axis=0)
    rows = np.arange(len(squares))
    lights = rows[(back[nearest] == rows) & (squares[rows, nearest] < 2 * _GAIN)]
    chosen = jacobians[lights].reshape(-1, 4)
    weighted = chosen / np.repeat(sigmas_px[lights] ** 2, 2)[:, None]
    covariance = np.linalg.inv(precision + weighted.T @ chosen)
    error = covariance @ (weighted.T @ offsets[lights, nearest[lights]].reshape(-1))
    return error, covariance, len(lights)
