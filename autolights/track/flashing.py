"""Does it flash? The duty cycle of the raw observations, next to what the hidden states say.

References:
    Wu et al. 2023, Sec. III-D; MUTCD 11th ed. §4G.01: 50 to 60 flashes a minute, lit 1/2 to 2/3 of the cycle. The
    paper wants the on ratio and the off ratio both in (1/2, 2/3); they sum to 1, so the on ratio is meant.
"""

from typing import Literal, TypeAlias

import numpy as np

from autolights.core import BoolArray, FlashingPair, FloatArray

FlashVerdict: TypeAlias = Literal["flashing", "steady", "unknown"]

MIN_RATE_HZ = 8.0  # below it a phase of 0.33 s is two samples or fewer, and the rule has nothing to go by
MAX_TOLERANCE = 0.1
_ROUNDING = 1e-6  # of stamps turned into seconds
_STEADY_CYCLES = 2


def flash_verdict(stamps_s: FloatArray, lit: BoolArray, pair: FlashingPair) -> FlashVerdict:
    """Judge by the unfiltered observations whether an indication flashes.

    It flashes if the latest whole cycles, rising edge to rising edge and at least two, have a legal period and are lit
    for a legal share of it, both with a tolerance of Δt / period, at most 0.1. It is steady if, without a gap, nothing
    changed for as long as two of the longest legal cycles. Everything else, and fewer than 8 frames a second, is
    unknown: the hidden states decide.

    Args:
        stamps_s: (n,) ascending, one for each set of frames in which the pair's on or off state was seen.
        lit: (n,) whether it was the on state.
        pair: Legal period and on ratio.
    """
    if len(stamps_s) < 3:
        return "unknown"
    steps_s = np.diff(stamps_s)
    step_s = float(np.median(steps_s))
    if step_s > 1 / MIN_RATE_HZ:
        return "unknown"
    if _changes_no_more(stamps_s, lit, pair, step_s):
        return "steady"
    rising = np.flatnonzero(lit[1:] & ~lit[:-1]) + 1
    if len(rising) < 3 or stamps_s[-1] - stamps_s[rising[-1]] > pair.period_s[1] + step_s:
        return "unknown"
    # Back from the latest edge, as many legal cycles as there are in a row.
    held_s = np.append(steps_s, 0.0)  # an observation holds until the next one
    start = len(rising) - 1
    while start > 0 and _is_legal(stamps_s[rising[start]] - stamps_s[rising[start - 1]], pair.period_s, step_s):
        start -= 1
    cycles = len(rising) - 1 - start
    if cycles < 2:
        return "unknown"
    window = slice(rising[start], rising[-1])
    duration_s = float(stamps_s[rising[-1]] - stamps_s[rising[start]])
    on_ratio = float(held_s[window][lit[window]].sum()) / duration_s
    tolerance = _tolerance(duration_s / cycles, step_s)
    legal = pair.on_ratio[0] - tolerance <= on_ratio <= pair.on_ratio[1] + tolerance
    return "flashing" if legal else "unknown"


def _changes_no_more(stamps_s: FloatArray, lit: BoolArray, pair: FlashingPair, step_s: float) -> bool:
    changed = np.flatnonzero(lit[1:] != lit[:-1])
    since = int(changed[-1]) + 1 if len(changed) else 0
    stamps = stamps_s[since:]
    if stamps[-1] - stamps[0] < _STEADY_CYCLES * pair.period_s[1]:
        return False
    # A gap as long as a dark phase may have hidden one.
    return float(np.diff(stamps).max()) < max((1 - pair.on_ratio[1]) * pair.period_s[0], 1.5 * step_s)


def _is_legal(period_s: float, limits_s: tuple[float, float], step_s: float) -> bool:
    tolerance = _tolerance(period_s, step_s)
    return limits_s[0] * (1 - tolerance) <= period_s <= limits_s[1] * (1 + tolerance)


def _tolerance(period_s: float, step_s: float) -> float:
    return min(step_s / period_s, MAX_TOLERANCE) + _ROUNDING
