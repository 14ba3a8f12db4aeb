"""Which detections that nobody matched may be lights that nobody knew."""

import numpy as np

from autolights.core import BoolArray, FloatArray, IntArray
from autolights.core.shots import Shots

_EDGE_PX = 2.0  # a box that ends this close to the image's edge may be cut by it
_SHRUNK = 1.4  # no lens draws a light so much smaller than a pinhole would


def may_be_near(heights_px: FloatArray, heights_m: FloatArray, seen_in: IntArray, shots: Shots) -> BoolArray:
    """(m,) whether detections are tall enough to be within their cameras' range, before they are localised.

    Args:
        heights_px: (m,) of the boxes.
        heights_m: (m,) of the housings.
        seen_in: (m,) which image each lies in.
        shots: The images.
    """
    reach_px_m = _SHRUNK * shots.optics.range_m / shots.optics.focal_px[1]
    return np.asarray(heights_m <= heights_px * reach_px_m.take(seen_in))


def may_be_new(
    seen: FloatArray,
    positions: FloatArray,
    seen_in: IntArray,
    known: FloatArray,
    known_in: IntArray,
    shots: Shots,
    *,
    misread_distance_heights: float,
) -> BoolArray:
    """Sort out what cannot start a track: a cut box, a light beyond the camera's range, a known light misread.

    A box that the image's edge cuts has lost the height from which its distance would follow.

    Args:
        seen: (4, m) centres, widths and heights of unmatched detections, pixels.
        positions: (m, 3) metres, by their size.
        seen_in: (m,) which image each lies in.
        known: (4, n) centres, widths and heights of the known lights.
        known_in: (n,) which image each lies in.
        shots: The images.
        misread_distance_heights: A detection whose centre is closer than this many box heights to a known light is that
            light, taken for another type; 0 lets it pass.

    Returns:
        (m,) whether it may be new.
    """
    halves, optics = seen[2:] / 2, shots.optics
    whole = (seen[:2] - halves >= _EDGE_PX) & (seen[:2] + halves <= optics.size_wh[:, seen_in] - _EDGE_PX)
    near = np.linalg.norm(positions - shots.vehicle[seen_in], axis=1) <= optics.range_m[seen_in]
    right, down = known[:2, :, None] - seen[:2, None]
    misread = np.sqrt(right * right + down * down) < misread_distance_heights * known[3][:, None]
    misread &= known_in[:, None] == seen_in
    return np.asarray(whole.all(axis=0) & near & ~misread.any(axis=0))
