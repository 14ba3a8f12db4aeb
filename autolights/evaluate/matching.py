"""Which report speaks of which light: one to one, and never by class, or every error would look like a miss."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from autolights.core import FloatArray, LightEstimate
from autolights.core.boxes import match_boxes
from autolights.data import TruthLight

MIN_IOU = 0.5
MAX_DISTANCE_M = 3.0


def match_seen_boxes(truth_xyxy: FloatArray, reported_xyxy: FloatArray) -> dict[int, int]:
    """Match boxes from an IoU of 0.5, the best overlap first.

    Args:
        truth_xyxy: (n, 4) pixels.
        reported_xyxy: (m, 4) pixels.

    Returns:
        Index of the truth → index of the report.
    """
    truths, reports = match_boxes(truth_xyxy, reported_xyxy, iou_threshold=MIN_IOU)
    return dict(zip(truths.tolist(), reports.tolist(), strict=True))


def match_lights(
    truth: Sequence[TruthLight], estimates: Sequence[LightEstimate], known_map_ids: frozenset[str]
) -> dict[int, int]:
    """Match by map id, and what is left by position within 3 m.

    Positions are matched by the Hungarian method: the most pairs, then the least total distance. Estimates that are
    acted upon go first; withheld ones get what is left. An estimate that claims to be another light of the drive is
    never matched by position.

    Args:
        truth: n lights.
        estimates: m reports.
        known_map_ids: Map ids of all lights that exist in the drive.

    Returns:
        Index of the truth → index of the estimate.
    """
    matches: dict[int, int] = {}
    for withheld in (False, True):
        free = [j for j, estimate in enumerate(estimates) if estimate.withheld == withheld]
        by_map_id = {estimates[j].map_id: j for j in reversed(free) if estimates[j].map_id is not None}
        for i, light in enumerate(truth):
            if i not in matches and light.map_id in by_map_id:
                matches[i] = by_map_id[light.map_id]
        open_truth = [i for i in range(len(truth)) if i not in matches]
        nameless = [j for j in free if j not in matches.values() and estimates[j].map_id not in known_map_ids]
        matches |= _match_positions(truth, estimates, open_truth, nameless)
    return matches


def _match_positions(
    truth: Sequence[TruthLight], estimates: Sequence[LightEstimate], rows: list[int], columns: list[int]
) -> dict[int, int]:
    if not rows or not columns:
        return {}
    distance_m = np.linalg.norm(
        np.array([truth[i].position for i in rows])[:, None] - np.array([estimates[j].position for j in columns]),
        axis=-1,
    )
    # A forbidden pair costs more than all allowed ones together, so that as many as possible are allowed.
    forbidden = MAX_DISTANCE_M * (min(distance_m.shape) + 1)
    cost = np.where(distance_m <= MAX_DISTANCE_M, distance_m, forbidden)
    pairs = zip(*linear_sum_assignment(cost), strict=True)
    return {rows[i]: columns[j] for i, j in pairs if distance_m[i, j] <= MAX_DISTANCE_M}
