"""Where a head is in the image and how much of it is hidden."""

from collections.abc import Sequence

import cv2
import numpy as np

from autolights.core import FloatArray
from autolights.core.light_box import project_corners
from autolights.sim.heads import SignalHead
from autolights.sim.render import Outline
from autolights.sim.view import View

_GRID_WH = (24, 64)  # cells over a box in which hidden ones are counted


def amodal_box(head: SignalHead, view: View) -> FloatArray | None:
    """(4,) pixels, the box of a whole housing, hidden or outside or not; None if it reaches behind the lens."""
    box = project_corners(head.corners()[None], view.camera, view.cam_from_town)[0]
    return box if np.isfinite(box).all() else None


def occlusion(head_id: str, box_xyxy: FloatArray, outlines: Sequence[Outline]) -> float:
    """Share of a head's box that later outlines cover, 0 to 1; what leaves the image is not counted as covered."""
    own = [i for i, outline in enumerate(outlines) if outline.head_id == head_id]
    if not own:
        return 0.0
    size = box_xyxy[2:] - box_xyxy[:2]
    scale = np.array(_GRID_WH) / np.maximum(size, 1e-6)
    hidden = np.zeros((_GRID_WH[1], _GRID_WH[0]), np.uint8)
    for outline in outlines[own[-1] + 1 :]:
        polygon = outline.polygon_px + 0.5
        low, high = polygon.min(axis=0), polygon.max(axis=0)
        if (high <= box_xyxy[:2]).any() or (low >= box_xyxy[2:]).any():
            continue
        cells = np.clip((polygon - box_xyxy[:2]) * scale - 0.5, -4_000, 4_000)
        cv2.fillConvexPoly(hidden, np.round(cells * 16).astype(np.int32), 1, shift=4)
    return float(hidden.mean())


def inside_share(box_xyxy: FloatArray, size_wh: tuple[int, int]) -> float:
    """Share of a box's area that lies inside the image."""
    low, high = np.maximum(box_xyxy[:2], 0), np.minimum(box_xyxy[2:], size_wh)
    sides = np.maximum(high - low, 0)
    return float(sides.prod() / (box_xyxy[2:] - box_xyxy[:2]).prod())
