"""What a light does behind its looks: a Markov chain with dwell times, and flashing apart from steady light.

The classes of a type are too coarse for a Markov chain. Three refinements make hidden states of them:

- A phase with a least duration passes through stages in a row (a phase-type distribution): yellow is not left after
  half a second, which a single state would do one time in eight.
- The on and off states of a flashing pair exist twice: within a flash, where each lasts as long as the law allows, and
  outside of it. A lamp that stays lit beyond a legal on phase is steady, one that stays dark is out of order.
- Whatever the description does not foresee happens at a small rate, so nothing is ever impossible.

References:
    Neuts 1981, Matrix-geometric solutions in stochastic models, ch. 2 (phase-type distributions).
    MUTCD 11th ed. §4G.01: 50 to 60 flashes a minute, lit 1/2 to 2/3 of the cycle.
"""

from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
import scipy.linalg

from autolights.core import BoolArray, FlashingPair, FloatArray, HmmParameters, IntArray, SignalSet

_FLASH_SHARE = 0.1  # how often a lit state that may be steady or flash turns out to be a flash, as long as it is lit
_FLASHES_IN_A_ROW = 15.0  # of a pair that may also be steady; other pairs have it in their successors' weights
_FAULT_S = 20.0  # how long a lamp stays lit or dark against the rules
_MAX_BITS = 24  # of a duration in milliseconds: after 4.6 hours nothing is left to forget
_CACHED = 64


class Phase(NamedTuple):
    """A stretch of time in which a light shows one class.

    Attributes:
        class_index: Among the type's states.
        pair: Flashing pair that it is part of; None outside of a flash.
        min_s: Least duration.
        mean_s: Expected duration.
    """

    class_index: int
    pair: int | None
    min_s: float
    mean_s: float


@dataclass(frozen=True, eq=False)
class HiddenChain:
    """A continuous-time Markov chain over the K hidden states of one type.

    Attributes:
        phases: What hidden states are stages of: each class outside of a flash, then on and off of each pair.
        phase_of: (K,) phase of each hidden state, in order.
        class_of: (K,) its class among the type's states.
        initial: (K,) distribution at first sight.
        rates: (K, K) generator per second.
        stay_rates: (K, K) the part of it that leads on within a phase, with the whole outflow on the diagonal.
    """

    phases: tuple[Phase, ...]
    phase_of: IntArray
    class_of: IntArray
    initial: FloatArray
    rates: FloatArray
    stay_rates: FloatArray
    _powers: list[FloatArray] = field(default_factory=list, repr=False)
    _cache: dict[int, FloatArray] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, type_name: str, signals: SignalSet, params: HmmParameters, *, stages: int, odd_changes_per_hour: float
    ) -> Self:
        """Build the chain.

        Args:
            type_name: Of the light.
            signals: Least durations and flashing pairs.
            params: Rates between classes, and their distribution at first sight.
            stages: In which a least duration is passed; its standard deviation is 1/√stages of it. 1 leaves all
                durations exponential.
            odd_changes_per_hour: How often the description is broken.
        """
        pairs = signals.types[type_name].flashing
        min_s = [signals.state(name).min_s for name in params.states]
        phases = _phases(pairs, params, min_s)
        onward, phase_of, first, last_rate = _stages(phases, stages)
        last = np.append(first[1:], len(phase_of)) - 1
        rates = onward.copy()
        rates[np.ix_(last, first)] += last_rate[:, None] * _routes(pairs, params, phases)
        # Against the description: from anywhere into the beginning of any other phase.
        odd = odd_changes_per_hour / 3600 / max(len(phases) - 1, 1)
        rates[:, first] += np.where(phase_of[:, None] == np.arange(len(phases)), 0.0, odd)
        np.fill_diagonal(rates, 0.0)
        outflow = np.diag(rates.sum(axis=1))
        class_of = np.array([phases[i].class_index for i in phase_of])
        in_flash = np.array([phases[i].pair is not None for i in phase_of])
        may_be_steady = {params.states.index(pair.on) for pair in pairs if pair.steady_on}
        initial = _initial(rates - outflow, class_of, in_flash, may_be_steady, params.initial)
        return cls(phases, phase_of, class_of, initial, rates - outflow, onward - outflow)

    def __len__(self) -> int:
        return len(self.phase_of)

    def over(self, duration_ms: int) -> tuple[FloatArray, FloatArray]:
        """Transitions over a time.

        Args:
            duration_ms: At least 0.

        Returns:
            (K, K) A = expm(Q Δt), `[i, j]` from i to j, and (K, K) the share of it that stays in one phase all along.

        Raises:
            ValueError: If the duration is negative.
        """
        if duration_ms < 0:
            raise ValueError(f"time does not run backwards, got {duration_ms} ms")
        both = self._cache.get(duration_ms)
        if both is None:
            if len(self._cache) >= _CACHED:  # the oldest goes: frame times come from a small set
                del self._cache[next(iter(self._cache))]
            both = self._cache[duration_ms] = self._multiply(min(duration_ms, (1 << _MAX_BITS) - 1))
        return both[0], both[1]

    def _multiply(self, duration_ms: int) -> FloatArray:
        """(2, K, K). The exponential is taken of a millisecond alone; odd frame times cost a few products each."""
        if not self._powers:
            self._powers.append(np.stack([scipy.linalg.expm(q / 1000) for q in (self.rates, self.stay_rates)]))
        while len(self._powers) < duration_ms.bit_length():
            self._powers.append(self._powers[-1] @ self._powers[-1])
        both = np.stack([np.eye(len(self))] * 2)
        for bit in range(duration_ms.bit_length()):
            if duration_ms >> bit & 1:
                both = both @ self._powers[bit]
        both = both.clip(min=0)  # rounding may leave entries of -1e-19
        both[0] /= both[0].sum(axis=1, keepdims=True)
        both.flags.writeable = False
        return np.asarray(both)


def flash_durations_s(pair: FlashingPair) -> tuple[tuple[float, float], tuple[float, float]]:
    """(shortest, mean) duration of a legal on phase, and of a legal off phase."""
    (short_s, long_s), (low, high) = pair.period_s, pair.on_ratio
    mean_s, ratio = (short_s + long_s) / 2, (low + high) / 2
    return (short_s * low, mean_s * ratio), (short_s * (1 - high), mean_s * (1 - ratio))


def _phases(pairs: tuple[FlashingPair, ...], params: HmmParameters, min_s: list[float]) -> tuple[Phase, ...]:
    states = params.states
    with np.errstate(divide="ignore"):
        mean_s = np.abs(1 / np.diag(params.rates)).tolist()  # inf for a class that is never left
    paired = {name for pair in pairs for name in (pair.on, pair.off)}
    steady_s = {pair.on: 1 / (1 / pair.steady_s + 1 / pair.begins_every_s) for pair in pairs if pair.steady_on}
    phases = [
        Phase(i, None, min_s[i], steady_s.get(name, _FAULT_S if name in paired else mean_s[i]))
        for i, name in enumerate(states)
    ]
    for p, pair in enumerate(pairs):
        on, off = states.index(pair.on), states.index(pair.off)
        (on_min_s, on_s), (off_min_s, off_s) = flash_durations_s(pair)
        if not pair.steady_on:
            on_s, off_s = mean_s[on], mean_s[off]
        phases += [Phase(on, p, on_min_s, on_s), Phase(off, p, off_min_s, off_s)]
    return tuple(phases)


def _stages(phases: tuple[Phase, ...], stages: int) -> tuple[FloatArray, IntArray, IntArray, FloatArray]:
    """Rates within the phases, phase of each stage, first stage of each phase, and rate of leaving its last."""
    stage_rates: list[list[float]] = []
    for phase in phases:
        if stages == 1 or phase.min_s == 0:
            stage_rates.append([1 / phase.mean_s])
            continue
        early_s = min(phase.min_s, phase.mean_s)
        rest_s = phase.mean_s - early_s
        # A rest shorter than a stage would be one more stage of its own speed: spread it over the others.
        if rest_s < early_s / stages:
            stage_rates.append([stages / phase.mean_s] * stages)
        else:
            stage_rates.append([stages / early_s] * stages + [1 / rest_s])
    counts = np.array([len(own) for own in stage_rates])
    first = np.cumsum(counts) - counts
    onward = np.zeros((counts.sum(), counts.sum()))
    for start, own in zip(first, stage_rates, strict=True):
        for i, rate in enumerate(own[:-1]):
            onward[start + i, start + i + 1] = rate
    return onward, np.repeat(np.arange(len(phases)), counts), first, np.array([own[-1] for own in stage_rates])


def _routes(pairs: tuple[FlashingPair, ...], params: HmmParameters, phases: tuple[Phase, ...]) -> FloatArray:
    """(phases, phases) where each phase leads to; rows sum to 1, or to 0 where nothing follows."""
    k = len(params.states)
    weights = params.rates.clip(min=0)
    ons = [params.states.index(pair.on) for pair in pairs]
    offs = [params.states.index(pair.off) for pair in pairs]

    def enter(target: int, origin: int) -> FloatArray:
        """(phases,) in which phase a class begins."""
        entered = np.zeros(len(phases))
        flashes = [k + 2 * p for p, on in enumerate(ons) if on == target]
        if flashes:
            steady = any(pair.steady_on and on == target for pair, on in zip(pairs, ons, strict=True))
            entered[flashes] = (_FLASH_SHARE if steady else 1.0) / len(flashes)
            entered[target] = 1 - _FLASH_SHARE if steady else 0.0
            return entered
        dark = [p for p, off in enumerate(offs) if off == target]
        dark = [p for p in dark if ons[p] == origin] or dark
        entered[[k + 2 * p + 1 for p in dark] or target] = 1 / max(len(dark), 1)
        return entered

    def leave(origin: int, *, but: list[int]) -> FloatArray:
        """(phases,) weights of the description, without some classes."""
        left = np.zeros(len(phases))
        for target in range(k):
            if weights[origin, target] and target not in but:
                left += weights[origin, target] * enter(target, origin)
        return left

    routes = np.zeros((len(phases), len(phases)))
    for c in range(k):
        routes[c] = leave(c, but=[])
    for p, pair in enumerate(pairs):
        on, off = ons[p], offs[p]
        lit, dark = k + 2 * p, k + 2 * p + 1
        others = [other for q, other in enumerate(ons) if q != p and offs[q] == off and other != on]
        if pair.steady_on:
            over = leave(on, but=[off])
            over = over / over.sum() if over.any() else over
            routes[on] = over / pair.steady_s
            routes[on, dark] += 1 / pair.begins_every_s
            over[on] += 1.0  # a flash ends in steady light as often as in whatever else may follow
            over /= over.sum() * _FLASHES_IN_A_ROW
            routes[lit], routes[dark] = over, over
            routes[lit, dark] += 1 - 1 / _FLASHES_IN_A_ROW
            routes[dark, lit] += 1 - 1 / _FLASHES_IN_A_ROW
        else:
            routes[lit], routes[dark] = leave(on, but=[off]), leave(off, but=[on, *others])
            routes[lit, dark], routes[dark, lit] = weights[on, off], weights[off, on]
    totals = routes.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(routes, totals, out=np.zeros_like(routes), where=totals > 0))


def _initial(
    rates: FloatArray, class_of: IntArray, in_flash: BoolArray, may_be_steady: set[int], of_classes: FloatArray
) -> FloatArray:
    """Each class as often as asked, its hidden states as often as time finds them."""
    size = len(rates)
    equations = np.vstack([rates.T, np.ones((1, size))])
    found = np.linalg.lstsq(equations, np.append(np.zeros(size), 1.0), rcond=None)[0].clip(min=1e-12)
    initial = np.zeros(size)
    for c, probability in enumerate(of_classes):
        own = class_of == c
        # Which of a light's lit states are a flash depends on the road, not on how long a flash lasts.
        parts = [(own & in_flash, _FLASH_SHARE), (own & ~in_flash, 1 - _FLASH_SHARE)] if c in may_be_steady else []
        for part, share in parts or [(own, 1.0)]:
            initial[part] = probability * share * found[part] / found[part].sum()
    return np.asarray(initial / initial.sum())
