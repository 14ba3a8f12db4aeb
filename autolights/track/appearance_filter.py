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

Beliefs are arrays (m, l, c, K): m lights in the order of their types; l beliefs about each, from its own looks and from
those of its group; c = L k + 1 appearances (each class seen with the least certainty, ..., with the most, missed); K
hidden states. c and K are those of the type that has most; where another has fewer, they are 0.

References:
    Wu et al. 2023, Sec. III-D; for emissions that depend on the last one: Murphy 2012, ch. 17.6 (autoregressive HMMs).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Self

import numpy as np

from autolights.core import FloatArray, HmmParameters, IntArray
from autolights.track.hidden_chain import HiddenChain
from autolights.track.look_reader import SHARPNESS
from autolights.track.signal_groups import Partners

_CACHED = 64  # frame times
_NEVER = 1e-30  # of a state, and of what is seen in it
_LOST = 1e-4  # of the sum of a belief, beyond which the model calls what was seen impossible
_SECOND_MOST = 0.95  # of P(the truth comes second | wrong): the road is no validation set


@dataclass(frozen=True, eq=False)
class LightsByType:
    """m lights in the order of their types, and what an `AppearanceFilter` has of the type of each.

    Attributes:
        types: (m,) ascending.
        slices: Each type that there is, and where its lights are.
        initial: (m, K) belief in each hidden state before any look.
        first: (m, c, K) belief at first sight.
        found: (m, 1, L + 1, K) P(level | hidden state), "missed" last.
        shares: (m, 1, c, K) P(appearance | its level, hidden state).
    """

    types: IntArray
    slices: tuple[tuple[int, slice], ...]
    initial: FloatArray
    first: FloatArray
    found: FloatArray
    shares: FloatArray


@dataclass(frozen=True, eq=False)
class AppearanceFilter:
    """The filters of t types.

    Attributes:
        chains: t, of the hidden states.
        error_duration_s: How long an appearance lasts; 0 draws it anew for each look.
        looks: (t, c, K) P(appearance | hidden state).
        first: (t, c, K) belief at first sight.
        second_if_wrong: (t,) P(the true class comes second | another one leads); 0 lets it say nothing.
        confusable: (t, k, k) what comes second, where the detector is right: `[i, j]` as often as i is taken for j.
    """

    chains: tuple[HiddenChain, ...]
    error_duration_s: float
    looks: FloatArray
    first: FloatArray
    second_if_wrong: FloatArray
    confusable: FloatArray
    _initial: FloatArray  # (t, K)
    _class_counts: FloatArray  # (t,)
    _if_not_second: FloatArray  # (2, t) P(the truth | neither first nor second), and by how much more if second
    _class_of: IntArray  # (t, K) class of each hidden state
    _every: FloatArray  # (c,) ones
    _ones: FloatArray  # (L + 1, c) which appearances are of a level, "missed" last
    _level_of: IntArray  # (c,) the same as numbers
    _levels_of_layers: IntArray  # (2 L,) where a class of the first level of the first layer comes again
    _found: FloatArray  # (t, L + 1, K)
    _shares: FloatArray  # (t, c, K)
    _steps: dict[int, tuple[float, FloatArray, FloatArray]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        chains: Sequence[HiddenChain],
        params: Sequence[HmmParameters],
        *,
        error_duration_s: float,
        dtype: type[np.floating[Any]] = np.float64,
    ) -> Self:
        """Build the filters.

        Args:
            chains: Hidden states of each type.
            params: B, P(missed | state), and how often the detector is sure; as many levels of certainty for each.
            error_duration_s: Of an appearance.
            dtype: Of beliefs; half as many bytes are moved in less time, and six digits are more than any model has.
        """
        t, levels = len(chains), params[0].certainty.levels
        k, states = max(len(own.states) for own in params), max(map(len, chains))
        c = levels * k + 1
        looks, initial = np.zeros((t, levels, k, states)), np.zeros((t, states))
        missed, confusable = np.zeros((t, states)), np.zeros((t, k, k))
        class_of = np.zeros((t, states), dtype=np.int64)
        for i, (chain, own) in enumerate(zip(chains, params, strict=True)):
            count, right = len(own.states), np.eye(len(own.states), dtype=bool)
            seen = own.observation.T * (1 - own.miss_probs)  # (k seen, k states)
            for level, (if_right, if_wrong) in enumerate(
                zip(own.certainty.if_right, own.certainty.if_wrong, strict=True)
            ):
                of_level = seen * np.where(right, if_right, if_wrong)
                looks[i, level, :count, : len(chain)] = of_level[:, chain.class_of]
            missed[i, : len(chain)] = own.miss_probs[chain.class_of]
            initial[i, : len(chain)], class_of[i, : len(chain)] = chain.initial, chain.class_of
            errors = own.observation * ~right
            total = errors.sum(axis=1, keepdims=True)
            confusable[i, :count, :count] = np.divide(
                errors, total, out=np.full_like(errors, 1 / max(count - 1, 1)), where=total > 0
            )
        counts = np.array([float(len(own.states)) for own in params])
        second = np.array([min(own.certainty.second_if_wrong, _SECOND_MOST) for own in params])
        of_rest = (1 - second) / np.maximum(counts - 2, 1)
        found = looks.sum(axis=2, keepdims=True)
        if_level = np.divide(looks, found, out=np.zeros_like(looks), where=found > 0)
        all_looks = np.concatenate([looks.reshape(t, c - 1, states), missed[:, None]], axis=1)
        # Rows of ones sum over appearances faster than a reduction along the middle axis.
        ones = np.zeros((levels + 1, c))
        ones[:-1, :-1], ones[-1, -1] = np.kron(np.eye(levels), np.ones(k)), 1.0
        return cls(
            chains=tuple(chains),
            error_duration_s=error_duration_s,
            looks=all_looks.astype(dtype),
            first=(all_looks * initial[:, None]).astype(dtype),
            second_if_wrong=second,
            confusable=confusable,
            _initial=initial.astype(dtype),
            _class_counts=counts,
            _if_not_second=np.array([of_rest, second - of_rest]),
            _class_of=class_of,
            _every=np.ones(c, dtype),
            _ones=ones.astype(dtype),
            _level_of=ones.argmax(axis=0),
            _levels_of_layers=(c * np.arange(2)[:, None] + k * np.arange(levels)).ravel(),
            _found=(ones @ all_looks).astype(dtype),
            _shares=np.concatenate([if_level.reshape(t, c - 1, states), np.ones((t, 1, states))], axis=1).astype(dtype),
        )

    def lights(self, types: IntArray) -> LightsByType:
        """Lights of these (m,) types, ascending."""
        bounds = np.searchsorted(types, np.arange(len(self.chains) + 1)).tolist()
        return LightsByType(
            types,
            tuple((t, slice(*bound)) for t, bound in enumerate(pairwise(bounds)) if bound[0] < bound[1]),
            self._initial.take(types, axis=0),
            self.first.take(types, axis=0),
            self._found.take(types, axis=0)[:, None],
            self._shares.take(types, axis=0)[:, None],
        )

    def predict(self, beliefs: FloatArray, lights: LightsByType, duration_ms: int) -> tuple[FloatArray, FloatArray]:
        """Let time pass.

        Args:
            beliefs: (m, l, c, K).
            lights: Whose they are.
            duration_ms: Since they were made.

        Returns:
            (m, l, c, K) beliefs, and (m, l, K) their `states`, what can look like nothing included.
        """
        step = self._steps.get(duration_ms)
        if step is None:
            if len(self._steps) >= _CACHED:
                del self._steps[next(iter(self._steps))]
            step = self._steps[duration_ms] = self._step(duration_ms)
        rho, both, stay = step
        m, layers, _, k = beliefs.shape
        sums = self._ones @ beliefs
        moved, by_level = np.empty_like(beliefs), np.empty((m, layers, len(self._ones), 2 * k), beliefs.dtype)
        # One product for all lights and appearances costs less than one for each light; that of "missed" is not used.
        for t, here in lights.slices:
            np.matmul(beliefs[here].reshape(-1, k), stay[t], out=moved[here].reshape(-1, k))
            np.matmul(sums[here].reshape(-1, k), both[t], out=by_level[here].reshape(-1, 2 * k))
        after = by_level[..., :k]  # by level, "missed" last: A, then ρ (A − S)
        states = np.add.reduce(after, axis=2)
        drawn = ((1 - rho) * states)[:, :, None] * lights.found
        drawn[:, :, :-1] += by_level[:, :, :-1, k:]
        looks = drawn.take(self._level_of, axis=2)
        looks *= lights.shares
        moved += looks
        moved[:, :, -1] = rho * after[:, :, -1] + drawn[:, :, -1]
        return moved, states

    def _step(self, duration_ms: int) -> tuple[float, FloatArray, FloatArray]:
        """ρ, and of each type A and ρ (A − S) side by side, and ρ S."""
        rho = float(np.exp(-duration_ms / 1000 / self.error_duration_s)) if self.error_duration_s else 0.0
        k, dtype = self.first.shape[2], self.first.dtype
        both, stays = np.zeros((len(self.chains), k, 2 * k), dtype), np.zeros((len(self.chains), k, k), dtype)
        for t, chain in enumerate(self.chains):
            own = slice(len(chain))
            change, stay = chain.over(duration_ms)
            both[t, own, own] = change
            both[t, own, k : k + len(chain)] = rho * (change - stay).clip(min=0)
            stays[t, own, own] = rho * stay
        return rho, both, stays

    def seconds(self, class_probs: FloatArray, types: IntArray) -> tuple[IntArray, FloatArray]:
        """What the class says that comes second: after an error it is mostly the truth.

        Args:
            class_probs: (j, k) of the classes of each light's type; 0 where it has fewer.
            types: (j,) of the lights.

        Returns:
            (j,) the leading classes, and (j, K) factors of the likelihood of their appearances.
        """
        j, k = class_probs.shape
        every, lead = np.arange(j), class_probs.argmax(axis=1)
        shares = class_probs**SHARPNESS
        shares[every, lead] = 0.0
        total = np.add.reduce(shares, axis=1, keepdims=True)
        if np.count_nonzero(total) < j:  # nothing comes second: all others alike
            shares = np.where(total > 0, shares, 1.0)
            total = np.where(total > 0, total, np.maximum(self._class_counts.take(types) - 1, 1)[:, None])
        shares /= total
        # P(c is the truth | another leads): by its share it comes second, else it is one of the rest.
        of_rest, more_if_second = self._if_not_second.take(types, axis=1)[:, :, None]
        by_class = of_rest + shares * more_if_second
        by_class[every, lead] = np.add.reduce(shares * self.confusable[types, lead], axis=1)
        return lead, by_class.take(self._class_of.take(types, axis=0) + k * every[:, None])

    def update(
        self,
        beliefs: FloatArray,
        states: FloatArray,
        lights: LightsByType,
        likelihood: FloatArray,
        partners: Partners | None = None,
        seconds: tuple[IntArray, IntArray, FloatArray] | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Take in what cameras saw at one instant.

        The first belief about a light is from its own looks. In the second one, what is seen of a light is evidence for
        all of its group, which show the same state; appearances are each light's own and, given the state, taken as
        independent.

        Args:
            beliefs: (m, 1 or 2, c, K); of the second, the sums over appearances are equal within a group.
            states: (m, 1 or 2, K) of them.
            lights: Whose they are.
            likelihood: (m, c) of each appearance, the product over cameras; ones say nothing.
            partners: Which lights form a group; needed for second beliefs.
            seconds: Rows of lights whose second class says something new, and what: the two (j, ...) of `seconds`.

        Returns:
            (m, 1 or 2, c, K) beliefs and (m, 1 or 2, K) their `states`. Where the model calls a look impossible, it is
            believed as at first sight.
        """
        posterior = beliefs * likelihood.astype(beliefs.dtype, copy=False)[:, None, :, None]
        if seconds is not None:
            self._weigh(posterior, *seconds)
        after = self.states(posterior)
        self._settle(posterior[:, 0], after[:, 0], lights, likelihood)
        if partners is not None and beliefs.shape[1] > 1:
            self._settle_together(states[:, 1], posterior[:, 1], after[:, 1], lights, partners)
        return posterior, after

    def states(self, beliefs: FloatArray) -> FloatArray:
        """(..., K) belief in each hidden state, whatever it looks like, of (..., c, K)."""
        return np.asarray(self._every @ beliefs)

    def _weigh(self, posterior: FloatArray, rows: IntArray, lead: IntArray, factors: FloatArray) -> None:
        """Multiply what each row's leading class looks like, on all levels and layers, by (j, K) factors in place."""
        _, layers, c, k = posterior.shape
        per_light = layers * (len(self._ones) - 1)
        appearances = ((rows * layers * c + lead)[:, None] + self._levels_of_layers[:per_light]).ravel()
        flat = posterior.reshape(-1, k)
        flat[appearances] = flat.take(appearances, axis=0) * factors.repeat(per_light, axis=0)

    def _settle(self, posterior: FloatArray, states: FloatArray, lights: LightsByType, likelihood: FloatArray) -> None:
        """Make (m, c, K) beliefs and (m, K) states sum to 1; where nothing is left, start as at first sight."""
        mass = np.add.reduce(states, axis=1)
        lost = ~(mass > _NEVER)
        if np.count_nonzero(lost):
            posterior[lost] = lights.first[lost] * likelihood[lost][:, :, None]
            lost = ~(posterior.sum(axis=(1, 2)) > _NEVER)
            posterior[lost] = lights.first[lost]
            states[:] = self.states(posterior)
            mass = states.sum(axis=1)
        scale = 1 / mass
        posterior *= scale[:, None, None]
        states *= scale[:, None]

    def _settle_together(
        self,
        before: FloatArray,
        posterior: FloatArray,
        states: FloatArray,
        lights: LightsByType,
        partners: Partners,
    ) -> None:
        """The same for lights that share evidence, from (m, K) states before they were seen."""
        evidence = partners.total(np.log(np.maximum(states / np.maximum(before, _NEVER), _NEVER)))
        state = before * np.exp(evidence - np.maximum.reduce(evidence, axis=1, keepdims=True))
        state /= np.maximum(np.add.reduce(state, axis=1, keepdims=True), _NEVER)
        factor = state / np.maximum(states, _NEVER)
        posterior *= factor[:, None, :]
        states *= factor
        lost = ~(np.abs(np.add.reduce(states, axis=1) - 1) < _LOST)
        if np.count_nonzero(lost):
            lost = partners.total(lost[:, None].astype(np.float64))[:, 0] > 0
            posterior[lost] = lights.first[lost]
            states[lost] = self.states(lights.first[lost])
