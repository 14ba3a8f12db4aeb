"""Which detection is which known light: the paper's cost, and the cheapest pairing (Wu et al. 2023, Sec. III-B)."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from autolights.core import BoolArray, Detections, FloatArray, IntArray
from autolights.core.boxes import cxcywh_columns
from autolights.track.projection import ANY_TYPE, NameArray, ProjectedLights

# A detector boxes what it sees: with its lower half hidden, a head is half as high, and its centre a quarter higher.
_HIDDEN_HEIGHTS = 0.5


@dataclass(frozen=True, eq=False)
class Association:
    """A partial one-to-one pairing.

    Attributes:
        matches: (k, 2) rows of the light and of the detection, ascending by light.
        unmatched_lights: Ascending rows of the lights that are left.
        unmatched_detections: Ascending rows of the detections that are left.
    """

    matches: IntArray
    unmatched_lights: IntArray
    unmatched_detections: IntArray


def association_cost(
    projected: ProjectedLights,
    detections: Detections,
    class_types: NameArray,
    *,
    max_distance_px: float,
    max_distance_heights: float | None = None,
    gates_px: FloatArray | None = None,
) -> FloatArray:
    """Cost of calling detection j light i: c(i, j) = ‖(cx, cy, h, w)_i − (cx, cy, h, w)_j‖₂.

    Args:
        projected: n known lights in the image.
        detections: m detections in the same image.
        class_types: (C,) type of each class.
        max_distance_px: A pair that is farther apart is forbidden.
        max_distance_heights: So is one farther apart than this many heights of the projected box. The neighbouring
            head is as many heights away at any range, but not as many pixels. None leaves the limit out (the paper).
        gates_px: (n,) how far from each light its detection can be at all by the errors of map, pose, calibration and
            box. What one of them hides of the box may add `_HIDDEN_HEIGHTS`. None leaves the limit out (the paper).

    Returns:
        (n, m) pixels; +inf forbids a pair: too far apart, or of different types.
    """
    known, seen = cxcywh_columns(projected.boxes_xyxy), cxcywh_columns(detections.boxes_xyxy)
    lights, columns = type_fits(projected, detections, class_types).nonzero()
    cost = np.full((known.shape[1], seen.shape[1]), np.inf)
    cost[lights, columns] = pair_costs(
        known,
        seen,
        (lights, columns),
        max_distance_px=max_distance_px,
        max_distance_heights=max_distance_heights,
        gates_px=gates_px,
    )
    return cost


def pair_costs(
    known: FloatArray,
    seen: FloatArray,
    pairs: tuple[IntArray, IntArray],
    *,
    max_distance_px: float,
    max_distance_heights: float | None = None,
    gates_px: FloatArray | None = None,
) -> FloatArray:
    """(k,) `association_cost` of (k,) lights and (k,) detections, given (4, n) and (4, m) centres, widths, heights."""
    lights, detections = pairs
    difference = known.take(lights, axis=1) - seen.take(detections, axis=1)
    squares = difference * difference
    distance_px = np.sqrt(squares[0] + squares[1] + squares[2] + squares[3])
    heights_px = known[3]
    limit_px = np.full(len(heights_px), max_distance_px)
    if max_distance_heights is not None:
        limit_px = np.minimum(limit_px, max_distance_heights * heights_px)
    if gates_px is not None:
        limit_px = np.minimum(limit_px, gates_px + _HIDDEN_HEIGHTS * heights_px)
    return np.where(distance_px <= limit_px.take(lights), distance_px, np.inf)


def type_fits(projected: ProjectedLights, detections: Detections, class_types: NameArray) -> BoolArray:
    """(n, m) whether light and detection can be the same by their types; `class_types` (C,) of each class."""
    types = projected.types[:, None]
    return np.asarray((types == class_types[detections.class_ids][None, :]) | (types == ANY_TYPE))


def associate(cost: FloatArray, *, unmatched_cost: float) -> Association:
    """Find the cheapest partial pairing.

    Leaving a light and a detection unmatched together costs `unmatched_cost`; a pair of infinite cost is never made.
    So the total that is minimised is the sum over pairs of (cost − unmatched_cost), and a pair is worth making only if
    it is cheaper than leaving both. Under a price of 100, [[1, 9], [8, ∞]] gives the two pairs of cost 9 and 8 (17
    instead of 101), and [[1, 99], [98, ∞]] gives the one pair of cost 1 (101 instead of 197).

    Args:
        cost: (n, m), +inf forbids. Either side may be empty.
        unmatched_cost: Price of leaving one light and one detection unmatched together: `max_distance_px`.

    References:
        Wu et al. 2023, Sec. III-B: "infinite costs are considered invalid assignments and are ignored".
    """
    light_count, detection_count = cost.shape
    lights, detections = (cost < unmatched_cost).nonzero()
    return associate_pairs(
        (lights, detections),
        cost[lights, detections],
        (light_count, detection_count),
        unmatched_cost=unmatched_cost,
    )


def associate_pairs(
    pairs: tuple[IntArray, IntArray], costs: FloatArray, shape: tuple[int, int], *, unmatched_cost: float
) -> Association:
    """`associate` for (k,) lights, ascending, and (k,) detections with (k,) costs; all other pairs are forbidden.

    Args:
        pairs: Lights and detections.
        costs: Of these pairs.
        shape: Numbers of lights and of detections.
        unmatched_cost: Price of leaving one light and one detection unmatched together.
    """
    worthwhile = (costs < unmatched_cost).nonzero()[0]
    rows, columns = pairs[0].take(worthwhile), pairs[1].take(worthwhile)
    contested = (np.bincount(rows).take(rows) > 1) | (np.bincount(columns).take(columns) > 1)
    if np.count_nonzero(contested):
        # A pair that nobody else wants is made; only the rest is searched.
        alone = ~contested
        found = _assigned(rows[contested], columns[contested], costs[worthwhile[contested]] - unmatched_cost)
        rows, columns = np.concatenate([rows[alone], found[0]]), np.concatenate([columns[alone], found[1]])
        order = np.argsort(rows)
        rows, columns = rows[order], columns[order]
    matches = np.empty((2, len(rows)), dtype=np.int64)
    matches[0], matches[1] = rows, columns
    return Association(matches.T, _rest(shape[0], rows), _rest(shape[1], columns))


def _assigned(rows: IntArray, columns: IntArray, gains: FloatArray) -> tuple[IntArray, IntArray]:
    """The pairs of the cheapest assignment; gains are negative, and leaving a pair gains nothing."""
    # Whatever a pair costs beyond the price of leaving it, leaving it is as good: capped, infinity never reaches scipy,
    # and the full assignment of the capped gains is the cheapest partial one.
    rivals, of_rival = np.unique(rows, return_inverse=True)
    wanted, of_wanted = np.unique(columns, return_inverse=True)
    gain = np.zeros((len(rivals), len(wanted)))
    gain[of_rival, of_wanted] = gains
    taken_rows, taken_columns = linear_sum_assignment(gain)
    made = gain[taken_rows, taken_columns] < 0
    return rivals[taken_rows[made]], wanted[taken_columns[made]]


def _rest(count: int, taken: IntArray) -> IntArray:
    free = np.ones(count, dtype=bool)
    free[taken] = False
    return free.nonzero()[0]
