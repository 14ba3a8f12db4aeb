"""Does it flash? The duty cycle of the raw observations, next to what the hidden states say.

References:
    Wu et al. 2023, Sec. III-D; MUTCD 11th ed. §4G.01: 50 to 60 flashes a minute, lit 1/2 to 2/3 of the cycle. The
    paper wants the on ratio and the off ratio both in (1/2, 2/3); they sum to 1, so the on ratio is meant.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, TypeAlias

from autolights.core import FlashingPair

FlashVerdict: TypeAlias = Literal["flashing", "steady", "unknown"]

MIN_RATE_HZ = 8.0  # below it a phase of 0.33 s is two samples or fewer, and the rule has nothing to go by
MAX_TOLERANCE = 0.1
_STEADY_CYCLES = 2
_ROUNDING = 1e-6  # of stamps turned into seconds


def flash_verdict(stamps_s: Sequence[float], lit: Sequence[bool], pair: FlashingPair) -> FlashVerdict:
    """Judge by the unfiltered observations whether an indication flashes.

    It flashes if the latest whole cycles, rising edge to rising edge and at least two, have a legal period and are lit
    for a legal share of it, both with a tolerance of Δt / period, at most 0.1. It is steady if, without a gap, nothing
    changed for as long as two of the longest legal cycles. Everything else, and fewer than 8 frames a second, is
    unknown: the hidden states decide.

    Args:
        stamps_s: n ascending seconds, one for each set of frames in which the pair's on or off state was seen.
        lit: Whether it was the on state, n values.
        pair: Legal period and on ratio.
    """
    if len(stamps_s) < 3:
        return "unknown"
    steps_s = [after - before for before, after in pairwise(stamps_s)]
    step_s = sorted(steps_s)[len(steps_s) // 2]
    if step_s > 1 / MIN_RATE_HZ:
        return "unknown"
    if _is_steady(stamps_s, lit, pair, step_s):
        return "steady"
    rising = [i for i in range(1, len(lit)) if lit[i] and not lit[i - 1]]
    if len(rising) < 3 or stamps_s[-1] - stamps_s[rising[-1]] > pair.period_s[1] + step_s:
        return "unknown"
    # Back from the latest edge, as many legal cycles as there are in a row.
    first = len(rising) - 1
    while first > 0 and _is_legal(stamps_s[rising[first]] - stamps_s[rising[first - 1]], pair.period_s, step_s):
        first -= 1
    cycles = len(rising) - 1 - first
    if cycles < 2:
        return "unknown"
    duration_s = stamps_s[rising[-1]] - stamps_s[rising[first]]
    # An observation holds until the next one.
    lit_s = sum(steps_s[i] for i in range(rising[first], rising[-1]) if lit[i])
    tolerance = _tolerance(duration_s / cycles, step_s)
    legal = pair.on_ratio[0] - tolerance <= lit_s / duration_s <= pair.on_ratio[1] + tolerance
    return "flashing" if legal else "unknown"


def _is_steady(stamps_s: Sequence[float], lit: Sequence[bool], pair: FlashingPair, step_s: float) -> bool:
    # A gap as long as a dark phase may have hidden one.
    longest_gap_s = max((1 - pair.on_ratio[1]) * pair.period_s[0], 1.5 * step_s)
    i = len(lit) - 1
    while i > 0 and lit[i - 1] == lit[-1] and stamps_s[i] - stamps_s[i - 1] < longest_gap_s:
        i -= 1
    return stamps_s[-1] - stamps_s[i] >= _STEADY_CYCLES * pair.period_s[1]


def _is_legal(period_s: float, limits_s: tuple[float, float], step_s: float) -> bool:
    low_s, high_s = limits_s
    return low_s * (1 - _tolerance(low_s, step_s)) <= period_s <= high_s * (1 + _tolerance(high_s, step_s))


def _tolerance(period_s: float, step_s: float) -> float:
    return min(step_s / period_s, MAX_TOLERANCE) + _ROUNDING
