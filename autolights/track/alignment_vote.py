"""The error of a camera that explains most pairs of one image: each pair proposes one, and all others vote on it.

References:
    Hough 1962 and Fischler & Bolles 1981 in spirit: hypotheses from the least possible data, judged by all data.
"""

import numpy as np

from autolights.core import FloatArray, IntArray

MAX_HEIGHT_RATIO = 1.6  # of a pair's boxes; half-hidden heads are left out of the vote
SEARCH_SIGMAS = 3.5  # of what was expected
_GAIN = 4.5  # a pair within three standard deviations speaks for an error, most if it fits exactly
MATCH_SIGMAS = (2 * _GAIN) ** 0.5
_AMBIGUOUS_SIGMAS = 3.0  # errors that move no light farther apart are one and the same
_MAX_PROPOSALS = 48  # those nearest to what was expected
_AMBIGUOUS = 1.0  # two errors whose votes differ by less are both possible


def vote(
    offsets_px: FloatArray,
    lights: IntArray,
    detections: IntArray,
    jacobians: FloatArray,
    sigmas_px: FloatArray,
    prior: FloatArray,
) -> tuple[FloatArray, FloatArray, int, bool]:
    """The error that explains most of k pairs.

    Args:
        offsets_px: (2, k) from each pair's light to its detection.
        lights: (k,) rows of the n lights, ascending.
        detections: (k,) numbers from 0; each pair comes once.
        jacobians: (n, 2, 4) pixels per unit of the error.
        sigmas_px: (n,) of a pair with the right error.
        prior: (4, 4) covariance of the error, whose mean is 0.

    Returns:
        (4,) error, (4, 4) its covariance, the number of pairs that agree, and whether it is beyond doubt.
    """
    if not len(lights):
        return np.zeros(4), prior, 0, False
    precision = np.linalg.inv(prior)
    proposals, penalties = _proposals(offsets_px, lights, jacobians, prior, precision)
    moved_px = jacobians.reshape(-1, 4) @ proposals.T  # (2 n, proposals)
    squares = _squares(offsets_px, lights, moved_px, sigmas_px)
    agreement = np.maximum(_GAIN - squares / 2, 0.0)
    # One detection cannot speak for two lights, nor one light for two detections.
    votes = np.minimum(_best_of_each(agreement, lights), _best_of_each(agreement, detections)) - penalties
    best = int(np.argmax(votes))
    if votes[best] <= 0:
        return np.zeros(4), prior, 0, False
    pairs = (offsets_px, lights, detections)
    error, covariance, count = _fit(squares[:, best], pairs, jacobians, sigmas_px, precision)
    if count < 2:
        # One pair alone may be the neighbour. It sharpens what is known, if it agrees with it.
        error, covariance, count = _fit(squares[:, 0], pairs, jacobians, sigmas_px, precision)
        return error, covariance, count, count > 0
    apart_px = np.abs(moved_px - moved_px[:, best, None]).max(axis=0)
    # Nor is an error another answer if the same pairs agree on it.
    other_pairs = ((agreement > 0) != (agreement[:, best, None] > 0)).any(axis=0)
    others = other_pairs & (apart_px > _AMBIGUOUS_SIGMAS * sigmas_px.max())
    sure = votes[best] - votes[others].max(initial=-np.inf) > _AMBIGUOUS
    return error, covariance, count, bool(sure)


def _proposals(
    offsets_px: FloatArray, lights: IntArray, jacobians: FloatArray, prior: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(c, 4) errors to vote on, no error at all first, and (c,) how much speaks against each beforehand."""
    # Of all errors that bring a light onto a detection, the most probable one: P Jᵀ (J P Jᵀ)⁻¹ o.
    turned = jacobians.swapaxes(1, 2)
    gains = prior @ turned @ np.linalg.inv(jacobians @ prior @ turned)
    every = (gains.take(lights, axis=0) @ offsets_px.T[:, :, None])[..., 0]
    surprise = ((every @ precision) * every).sum(axis=1)
    order = np.argsort(surprise)[:_MAX_PROPOSALS]
    order = order[surprise[order] < SEARCH_SIGMAS**2]
    proposals = np.concatenate([np.zeros((1, 4)), every[order]])
    return proposals, np.concatenate([[0.0], surprise[order]]) / 2


def _squares(offsets_px: FloatArray, lights: IntArray, moved_px: FloatArray, sigmas_px: FloatArray) -> FloatArray:
    """(k, c) squared distances of pairs in standard deviations under c errors, which move lights by (2 n, c) pixels."""
    right = offsets_px[0][:, None] - moved_px.take(2 * lights, axis=0)
    down = offsets_px[1][:, None] - moved_px.take(2 * lights + 1, axis=0)
    return np.asarray((right * right + down * down) / np.square(sigmas_px).take(lights)[:, None])


def _best_of_each(agreement: FloatArray, members: IntArray) -> FloatArray:
    """(c,) sums, over lights or detections, of the best agreement of each; (k, c) by pairs, and whose each pair is."""
    order = np.argsort(members, kind="stable")
    ordered = members[order]
    starts = np.concatenate([[0], (ordered[1:] != ordered[:-1]).nonzero()[0] + 1])
    return np.asarray(np.maximum.reduceat(agreement.take(order, axis=0), starts, axis=0).sum(axis=0))


def _fit(
    squares: FloatArray,
    pairs: tuple[FloatArray, IntArray, IntArray],
    jacobians: FloatArray,
    sigmas_px: FloatArray,
    precision: FloatArray,
) -> tuple[FloatArray, FloatArray, int]:
    """Weighted least squares over the pairs that are each other's nearest, with the prior as one more equation."""
    offsets_px, lights, detections = pairs
    table = np.full((len(jacobians), int(detections.max()) + 1), np.inf)
    table[lights, detections] = squares
    nearest, back = table.argmin(axis=1).take(lights), table.argmin(axis=0).take(detections)
    chosen = ((nearest == detections) & (back == lights) & (squares < 2 * _GAIN)).nonzero()[0]
    used = lights.take(chosen)
    lines = jacobians.take(used, axis=0).reshape(-1, 4)
    weighted = lines / np.square(sigmas_px).take(used).repeat(2)[:, None]
    covariance = np.linalg.inv(precision + weighted.T @ lines)
    return covariance @ (weighted.T @ offsets_px.take(chosen, axis=1).T.ravel()), covariance, len(used)
