"""Which detection is which known light: the paper's cost, and the cheapest pairing (Wu et al. 2023, Sec. III-B)."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from autolights.core import BoolArray, Detections, FloatArray, IntArray
from autolights.core.boxes import cxcywh_from_xyxy
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
    known, seen = cxcywh_from_xyxy(projected.boxes_xyxy), cxcywh_from_xyxy(detections.boxes_xyxy)
    difference = known[:, None, :] - seen[None, :, :]
    distance_px = np.sqrt(np.einsum("nmk,nmk->nm", difference, difference))
    limit_px = np.full((len(known), 1), max_distance_px)
    if max_distance_heights is not None:
        limit_px = np.minimum(limit_px, max_distance_heights * known[:, 3:])
    if gates_px is not None:
        limit_px = np.minimum(limit_px, gates_px[:, None] + _HIDDEN_HEIGHTS * known[:, 3:])
    return np.where(type_fits(projected, detections, class_types) & (distance_px <= limit_px), distance_px, np.inf)


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
    # Whatever a pair costs beyond the price of leaving it, leaving it is as good: capped, infinity never reaches scipy,
    # and the full assignment of the capped gains is the cheapest partial one.
    gain = np.minimum(cost - unmatched_cost, 0.0)
    rows, columns = linear_sum_assignment(gain)
    worthwhile = gain[rows, columns] < 0
    matches = np.stack([rows[worthwhile], columns[worthwhile]], axis=1).astype(np.int64)
    return Association(
        matches=matches,
        unmatched_lights=_rest(light_count, matches[:, 0]),
        unmatched_detections=_rest(detection_count, matches[:, 1]),
    )


def _rest(count: int, taken: IntArray) -> IntArray:
    free = np.ones(count, dtype=bool)
    free[taken] = False
    return np.flatnonzero(free)
