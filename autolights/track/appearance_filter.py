"""The forward algorithm on time, where the detector's errors last: hidden state and appearance, estimated together.

A detector that takes a washed-out red for yellow does so for some tenths of a second, frame after frame. Counting each
frame as an opinion of its own would let such an error win. So a light has an *appearance* a: the class that the
detector sees in it, and how sure it is (one of L levels); or nothing at all, it is missed. An appearance stays as it is
for `error_duration_s` on average and is then drawn anew from row q of B. When the state q changes, so does the class
that is seen, but what blurs or hides a light goes on to do so:

    P(q', a' | q, a) = ρ S(q, q') [a' = a] + ρ (A − S)(q, q') B(q', a' | level of a) + (1 − ρ) A(q, q') B(q', a')   seen
    P(q', a' | q, a) = ρ A(q, q') [a' = a] + (1 − ρ) A(q, q') B(q', a')                                           missed

with ρ = exp(−Δt / error_duration_s), A(Δt) = expm(Q Δt) and S the share of it that stays in one phase (`HiddenChain`).
A new look says as much as an independent one; its repetition says little. A light that was seen clearly and is now
another class, in doubt, has hardly changed: the view of it has. As ρ → 0, with one level and class vectors taken as
they are, this is the paper's filter with C from B under a uniform prior.

Beliefs are arrays (..., c, K): c = L k + 1 appearances (each class seen with the least certainty, ..., with the most,
missed) and K hidden states.

References:
    Wu et al. 2023, Sec. III-D; for emissions that depend on the last one: Murphy 2012, ch. 17.6 (autoregressive HMMs).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from autolights.core import FloatArray, HmmParameters, IntArray
from autolights.core.errors import UsageError
from autolights.track.hidden_chain import HiddenChain
from autolights.track.signal_groups import Partners

_SLIP = 1e-3  # how often one look shows something else than the appearance, within the same instant
_SHARPNESS = 4.0  # power of a class vector: an appearance is what the detector says most, and a tie is one
_CACHED = 64  # frame times
_NEVER = 1e-300  # of a state, and of what is seen in it
_LOST = 1e-6  # of the sum of a belief, beyond which the model calls what was seen impossible
_FLOOR = 1e-9  # of what other classes get together
_LEVEL_WIDTH = 0.15  # of log odds, over which a level becomes the next: a look between them is not two looks by turns
_ALONE = 0.02  # how often a camera errs by itself while another one does not
_SECOND_MOST = 0.95  # of P(the truth comes second | wrong): the road is no validation set
_DISSENT = 0.5  # power of what the confidence of a camera that dissents is worth, as it counts in each set anew


@dataclass(frozen=True, eq=False)
class AppearanceFilter:
    """The filter of one type.

    Attributes:
        chain: K hidden states.
        looks: (c, K) P(appearance | hidden state).
        error_duration_s: How long an appearance lasts; 0 draws it anew for each look.
        first: (c, K) belief at first sight.
        confusable: (k, k) what comes second, where the detector is right: `[i, j]` as often as i is taken for j.
        second_if_wrong: P(the true class comes second | another one leads); 0 lets it say nothing.
    """

    chain: HiddenChain
    looks: FloatArray
    error_duration_s: float
    first: FloatArray
    confusable: FloatArray
    second_if_wrong: float
    _every: FloatArray  # (c,) ones
    _ones: FloatArray  # (L + 1, c) which appearances are of a level, "missed" last
    _level_of: IntArray  # (c,) the same as numbers
    _found: FloatArray  # (L + 1, K) P(level | hidden state)
    _shares: FloatArray  # (c, K) P(appearance | its level, hidden state)
    _steps: dict[int, tuple[float, FloatArray, FloatArray]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, chain: HiddenChain, params: HmmParameters, *, error_duration_s: float) -> Self:
        """Build the filter.

        Args:
            chain: Hidden states.
            params: B, P(missed | state), and how often the detector is sure.
            error_duration_s: Of an appearance.
        """
        seen = params.observation.T * (1 - params.miss_probs)  # (k seen, k states)
        certainty, right = params.certainty, np.eye(len(seen), dtype=bool)
        levels = zip(certainty.if_right, certainty.if_wrong, strict=True)
        of_levels = [seen * np.where(right, if_right, if_wrong) for if_right, if_wrong in levels]
        looks = np.concatenate([*of_levels, params.miss_probs[None]])[:, chain.class_of]
        k = len(params.states)
        by_level = looks[:-1].reshape(certainty.levels, k, len(chain))
        found = by_level.sum(axis=1, keepdims=True)
        if_level = np.divide(by_level, found, out=np.zeros_like(by_level), where=found > 0)
        # Rows of ones sum over appearances faster than a reduction along the middle axis.
        ones = np.zeros((certainty.levels + 1, len(looks)))
        ones[:-1, :-1], ones[-1, -1] = np.kron(np.eye(certainty.levels), np.ones(k)), 1.0
        errors = params.observation * ~right
        total = errors.sum(axis=1, keepdims=True)
        confusable = np.divide(errors, total, out=np.full_like(errors, 1 / max(k - 1, 1)), where=total > 0)
        second = min(certainty.second_if_wrong, _SECOND_MOST)
        first, every = looks * chain.initial, np.ones(len(looks))
        shares = np.concatenate([if_level.reshape(-1, len(chain)), np.ones((1, len(chain)))])
        return cls(
            chain,
            looks,
            error_duration_s,
            first,
            confusable,
            second,
            _every=every,
            _ones=ones,
            _level_of=ones.argmax(axis=0),
            _found=ones @ looks,
            _shares=shares,
        )

    def predict(self, beliefs: FloatArray, duration_ms: int) -> FloatArray:
        """Let time pass.

        Args:
            beliefs: (n, c, K).
            duration_ms: Since they were made.
        """
        step = self._steps.get(duration_ms)
        if step is None:
            if len(self._steps) >= _CACHED:
                del self._steps[next(iter(self._steps))]
            step = self._steps[duration_ms] = self._step(duration_ms)
        rho, both, stay = step
        n, c, k = beliefs.shape
        # One product for all lights and appearances costs less than one for each light; that of "missed" is not used.
        moved = (beliefs.reshape(n * c, k) @ stay).reshape(n, c, k)
        # By level, "missed" last: A, then ρ (A − S).
        by_level = ((self._ones @ beliefs).reshape(-1, k) @ both).reshape(n, -1, 2 * k)
        after = by_level[:, :, :k]
        fresh = (1 - rho) * np.add.reduce(after, axis=1)
        drawn = fresh[:, None] * self._found
        drawn[:, :-1] += by_level[:, :-1, k:]
        looks = drawn.take(self._level_of, axis=1)
        looks *= self._shares
        moved += looks
        moved[:, -1] = rho * after[:, -1] + drawn[:, -1]
        return moved

    def _step(self, duration_ms: int) -> tuple[float, FloatArray, FloatArray]:
        """ρ, A and ρ (A − S) side by side, and ρ S."""
        change, stay = self.chain.over(duration_ms)
        rho = float(np.exp(-duration_ms / 1000 / self.error_duration_s)) if self.error_duration_s else 0.0
        return rho, np.concatenate([change, rho * (change - stay).clip(min=0)], axis=1), rho * stay

    def seconds(self, class_probs: FloatArray) -> FloatArray:
        """What the class says that comes second: after an error it is mostly the truth.

        Args:
            class_probs: (m, k) of the type's classes.

        Returns:
            (m, c, K) factors of the likelihood, one for all appearances but those of the leading class.
        """
        m, k = class_probs.shape
        every, lead = np.arange(m), class_probs.argmax(axis=1)
        shares = class_probs**_SHARPNESS
        shares[every, lead] = 0.0
        total = shares.sum(axis=1, keepdims=True)
        shares = np.divide(shares, total, out=np.full_like(shares, 1 / max(k - 1, 1)), where=total > 0)
        by_class = self.second_if_wrong * shares + (1 - self.second_if_wrong) * (1 - shares) / max(k - 2, 1)
        by_class[every, lead] = (shares * self.confusable[lead]).sum(axis=1)
        factors = np.ones((m, *self.first.shape))
        for level in range(len(self._ones) - 1):
            factors[every, level * k + lead] = by_class.take(self.chain.class_of, axis=1)
        return factors

    def update(
        self, beliefs: FloatArray, likelihood: FloatArray, factors: tuple[IntArray, FloatArray] | None = None
    ) -> FloatArray:
        """Take in what cameras saw at one instant.

        Args:
            beliefs: (n, c, K).
            likelihood: (n, c) of each appearance, the product over cameras; ones say nothing.
            factors: Lights whose second class says something new, and (…, c, K) what (`seconds`).

        Returns:
            (n, c, K). Where the model calls a look impossible, it is believed as at first sight.
        """
        posterior = self.weigh(beliefs, likelihood, factors)
        self.settle(posterior, likelihood)
        return posterior

    def weigh(
        self, beliefs: FloatArray, likelihood: FloatArray, factors: tuple[IntArray, FloatArray] | None
    ) -> FloatArray:
        """(..., n, c, K) beliefs times what cameras saw, as in `update`; they do not sum to 1 yet."""
        posterior = beliefs * likelihood[:, :, None]
        if factors is not None:
            posterior[..., factors[0], :, :] *= factors[1]
        return posterior

    def settle(self, posterior: FloatArray, likelihood: FloatArray) -> None:
        """Make (n, c, K) products of `weigh` sum to 1 in place; where nothing is left, start as at first sight."""
        mass = np.add.reduce(posterior.reshape(len(posterior), -1), axis=1)
        if np.count_nonzero(mass) < len(mass):
            lost = mass == 0
            posterior[lost] = self.first * likelihood[lost][:, :, None]
            mass = posterior.sum(axis=(1, 2))
            posterior[mass == 0] = self.first
            mass = posterior.sum(axis=(1, 2))
        posterior /= mass[:, None, None]

    def states(self, beliefs: FloatArray) -> FloatArray:
        """(n, K) belief in each hidden state, whatever it looks like."""
        return np.asarray(self._every @ beliefs)

    def update_together(
        self,
        beliefs: FloatArray,
        likelihood: FloatArray,
        partners: Partners,
        factors: tuple[IntArray, FloatArray] | None = None,
    ) -> FloatArray:
        """`update` for lights of which some show the same state: what is seen of one is evidence for all of its group.

        Appearances are each light's own and, given the state, taken as independent.

        Args:
            beliefs: (n, c, K); within a group the sums over appearances are equal.
            likelihood: (n, c).
            partners: Which lights form a group.
            factors: As in `update`.
        """
        posterior = self.weigh(beliefs, likelihood, factors)
        self.settle_together(beliefs, posterior, partners)
        return posterior

    def settle_together(self, beliefs: FloatArray, posterior: FloatArray, partners: Partners) -> None:
        """`settle` for lights that share evidence: (n, c, K) `posterior` is what `weigh` made of `beliefs`."""
        before, after = self.states(beliefs), self.states(posterior)
        evidence = partners.total(np.log(np.maximum(after / np.maximum(before, _NEVER), _NEVER)))
        state = before * np.exp(evidence - np.maximum.reduce(evidence, axis=1, keepdims=True))
        state /= np.add.reduce(state, axis=1, keepdims=True)
        factor = state / np.maximum(after, _NEVER)
        posterior *= factor[:, None, :]
        lost = np.abs(np.add.reduce(after * factor, axis=1) - 1) > _LOST
        if np.count_nonzero(lost):
            posterior[partners.total(lost[:, None].astype(np.float64))[:, 0] > 0] = self.first


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
        return cls(
            columns,
            scale,
            np.array([own.temperature for own in params]),
            np.log(thresholds / (1 - thresholds)),
            _ALONE * np.minimum(worth, 1.0) ** _DISSENT,
        )

    @property
    def levels(self) -> int:
        """How many levels of certainty are told apart."""
        return int(self.dissent.shape[1])

    def read(
        self, class_probs: FloatArray, types: IntArray, *, sharpness: float = _SHARPNESS
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Read what one camera's detector says.

        Args:
            class_probs: (m, C) of all classes; a row that is zero on its type's classes says nothing of the class.
            types: (m,) index of each light's type.
            sharpness: Power of the calibrated class vector.

        Returns:
            (m, k) likelihood of each class being seen, (m, L − 1, k) how far each higher level of certainty is reached
            if that is what the detector sees, and (m,) the chance that it errs alone. Of several cameras at one
            instant, the product of the first, each plus its third, and the maximum of the second: they share most
            errors, but who is sure is seldom wrong.
        """
        m, class_count = class_probs.shape
        calibrated = class_probs
        if np.count_nonzero(self.temperature != 1):
            calibrated = class_probs ** (1 / self.temperature[types])[:, None]
        padded = np.zeros((m, class_count + 1))
        padded[:, :-1] = calibrated
        own = padded.take(self.columns.take(types, axis=0) + (class_count + 1) * np.arange(m)[:, None])
        best = np.maximum.reduce(own, axis=1, keepdims=True)
        rest = np.add.reduce(calibrated, axis=1, keepdims=True) - best
        silent = best == 0
        speechless = np.count_nonzero(silent)
        if speechless:
            own, best, rest = np.where(silent, 1.0, own), np.where(silent, 1.0, best), np.where(silent, 1.0, rest)
        below = (self.thresholds.take(types, axis=0) - np.log(best / np.maximum(rest, _FLOOR))) / _LEVEL_WIDTH
        reached = 1 / (1 + np.exp(np.minimum(np.maximum(below, -30), 30)))
        if speechless:
            reached = np.where(silent, np.arange(self.levels - 1, 0, -1) / self.levels, reached)
        alone = (self.dissent.take(types, axis=0) * _levels(reached)).sum(axis=1)
        said = np.asarray((own / best) ** sharpness * self.scale.take(types, axis=0))
        return said, reached[:, :, None] * (own == best)[:, None, :], alone


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
    levels = _levels(reached)
    slip = np.full((len(said), 1), _SLIP)
    count, k = said.shape
    return np.concatenate([(levels * said[:, None, :]).reshape(count, levels.shape[1] * k), slip], axis=1)


def _levels(reached: FloatArray) -> FloatArray:
    """(m, L, ...) how far each level of certainty is the one, from how far each but the lowest is reached."""
    shares = np.empty((len(reached), reached.shape[1] + 1, *reached.shape[2:]))
    shares[:, 0], shares[:, 1:] = 1.0, reached
    shares[:, :-1] -= reached
    return shares


def miss_likelihood(state_count: int, levels: int) -> FloatArray:
    """(L k + 1,) likelihood of each appearance for a light that was looked for in vain."""
    likelihood = np.full(levels * state_count + 1, _SLIP)
    likelihood[-1] = 1.0
    return likelihood
