"""What a detector's class vector says of a light's appearance: of which class it looks, and how surely."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from autolights.core import FloatArray, HmmParameters, IntArray
from autolights.core.errors import UsageError

SHARPNESS = 4.0  # power of a class vector: an appearance is what the detector says most, and a tie is one
_SLIP = 1e-3  # how often one look shows something else than the appearance, within the same instant
_FLOOR = 1e-9  # of what other classes get together
_LEVEL_WIDTH = 0.15  # of log odds, over which a level becomes the next: a look between them is not two looks by turns
_ALONE = 0.02  # how often a camera errs by itself while another one does not
_DISSENT = 0.5  # power of what the confidence of a camera that dissents is worth, as it counts in each set anew


class Reading(NamedTuple):
    """What a detector says of m lights.

    Of several cameras at one instant, `said` of each plus its `alone` is multiplied, and of `reached` the maximum
    counts: they share most errors, but who is sure is seldom wrong.

    Attributes:
        said: (m, k) likelihood of each class being seen.
        reached: (m, L − 1, k) how far each higher level of certainty is reached if that is what the detector sees.
        alone: (m,) the chance that it errs alone.
        own: (m, k) calibrated probabilities of the classes of each light's type.
    """

    said: FloatArray
    reached: FloatArray
    alone: FloatArray
    own: FloatArray


@dataclass(frozen=True, eq=False)
class LookReader:
    """How to read the class vectors of lights of mixed types.

    Attributes:
        columns: (t, k) for each type the columns of a class vector that are its states; C where it has fewer than k.
        scale: (t, k) by which a class's probability is multiplied: what many states are taken for says less.
        temperature: (t,) by which log probabilities are divided, so that they mean what they say.
        thresholds: (t, L − 1) log odds of the calibrated probability from which each level begins.
        dissent: (t, L) chance that a camera of that level of certainty errs alone.
    """

    columns: IntArray
    scale: FloatArray
    temperature: FloatArray
    thresholds: FloatArray
    dissent: FloatArray
    _has_temperature: bool  # of any type it is not 1
    _dissent_steps: FloatArray  # (t, L − 1) from each level to the next

    @classmethod
    def of(cls, params: Sequence[HmmParameters], class_ids: Mapping[str, int]) -> Self:
        """For these types, in this order.

        Raises:
            UsageError: If they do not tell equally many levels of certainty apart.
        """
        k, levels = max(len(own.states) for own in params), {own.certainty.levels for own in params}
        if len(levels) > 1:
            raise UsageError(f"all types must tell equally many levels of certainty apart, got {sorted(levels)}")
        columns, scale = np.full((len(params), k), len(class_ids)), np.zeros((len(params), k))
        for t, own in enumerate(params):
            columns[t, : len(own.states)] = [class_ids[name] for name in own.states]
            total = own.observation.sum(axis=0)
            scale[t, : len(own.states)] = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)
        thresholds = np.array([own.certainty.thresholds for own in params]).reshape(len(params), -1)
        worth = np.array([own.certainty.if_wrong for own in params]) / np.maximum(
            np.array([own.certainty.if_right for own in params]), 1e-6
        )
        temperature = np.array([own.temperature for own in params])
        dissent = _ALONE * np.minimum(worth, 1.0) ** _DISSENT
        return cls(
            columns,
            scale,
            temperature,
            np.log(thresholds / (1 - thresholds)),
            dissent,
            _has_temperature=bool((temperature != 1).any()),
            _dissent_steps=np.diff(dissent, axis=1),
        )

    @property
    def levels(self) -> int:
        """How many levels of certainty are told apart."""
        return int(self.dissent.shape[1])

    def read(self, class_probs: FloatArray, types: IntArray, *, sharpness: float = SHARPNESS) -> Reading:
        """Read what a detector says.

        Args:
            class_probs: (m, C) of all classes; a row that is zero on its type's classes says nothing of the class.
            types: (m,) index of each light's type.
            sharpness: Power of the calibrated class vector.
        """
        m, class_count = class_probs.shape
        calibrated = class_probs
        if self._has_temperature:
            calibrated = class_probs ** (1 / self.temperature.take(types))[:, None]
        padded = np.zeros((m, class_count + 1))
        padded[:, :-1] = calibrated
        own = heard = padded.take(self.columns.take(types, axis=0) + (class_count + 1) * np.arange(m)[:, None])
        best = np.maximum.reduce(own, axis=1, keepdims=True)
        rest = np.add.reduce(calibrated, axis=1, keepdims=True) - best
        silent = best == 0
        speechless = np.count_nonzero(silent)
        if speechless:
            heard, best, rest = np.where(silent, 1.0, own), np.where(silent, 1.0, best), np.where(silent, 1.0, rest)
        below = (self.thresholds.take(types, axis=0) - np.log(best / np.maximum(rest, _FLOOR))) / _LEVEL_WIDTH
        reached = 1 / (1 + np.exp(np.minimum(below, 30)))
        if speechless:
            reached = np.where(silent, np.arange(self.levels - 1, 0, -1) / self.levels, reached)
        alone = self.dissent[:, 0].take(types)
        alone += np.add.reduce(self._dissent_steps.take(types, axis=0) * reached, axis=1)
        said = (heard / best) ** sharpness * self.scale.take(types, axis=0)
        return Reading(said, reached[:, :, None] * (heard == best)[:, None, :], alone, own)


def leading_pairs(class_probs: FloatArray) -> IntArray:
    """(m,) a number for the leading and the second of (m, k) classes."""
    every, lead = np.arange(len(class_probs)), class_probs.argmax(axis=1)
    rest = class_probs.copy()
    rest[every, lead] = -1.0
    return np.asarray(lead * class_probs.shape[1] + rest.argmax(axis=1))


def seen_likelihood(said: FloatArray, reached: FloatArray) -> FloatArray:
    """(m, L k + 1) likelihood of each appearance of lights that were seen, from what all cameras said.

    Args:
        said: (m, k) of each class.
        reached: (m, L − 1, k) how far each level of certainty but the lowest is reached.
    """
    (count, k), levels = said.shape, reached.shape[1] + 1
    likelihood = np.empty((count, levels * k + 1))
    likelihood[:, -1] = _SLIP
    shares = likelihood[:, :-1].reshape(count, levels, k)  # a view: how far each level is the one
    shares[:, 0], shares[:, 1:] = 1.0, reached
    shares[:, :-1] -= reached
    shares *= said[:, None]
    return likelihood


def miss_likelihood(state_count: int, levels: int) -> FloatArray:
    """(L k + 1,) likelihood of each appearance for a light that was looked for in vain."""
    likelihood = np.full(levels * state_count + 1, _SLIP)
    likelihood[-1] = 1.0
    return likelihood
