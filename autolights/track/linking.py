"""Two cameras, one unknown light: which localisations of the same instant belong together."""

import numpy as np

from autolights.core import FloatArray
from autolights.track.association import associate

# Two cameras mean the same light if their localisations are this close: across the ray less than half of the usual
# spacing between heads, along the ray as close as depth from height can tell.
_ACROSS_M = 0.6
_ALONG_SHARE = 0.2


def link_across_cameras(known: FloatArray, positions: FloatArray, vehicle: FloatArray) -> dict[int, int]:
    """Pair the localisations of one camera with those of the cameras before.

    The cameras of a vehicle look from nearly the same place, so both err along the same ray.

    Args:
        known: (n, 3) metres: lights that other cameras have just localised.
        positions: (m, 3) metres: what this camera localised.
        vehicle: (3,) metres: where the vehicle is.

    Returns:
        Row of `positions` → row of `known`, for those that are the same light; one to one.
    """
    difference = positions[:, None, :] - known[None, :, :]
    ray = known - vehicle
    range_m = np.linalg.norm(ray, axis=-1)
    along = np.einsum("mnk,nk->mn", difference, ray) / range_m
    across_m = np.linalg.norm(difference - along[..., None] * (ray / range_m[:, None]), axis=-1)
    cost = np.hypot(across_m / _ACROSS_M, along / (_ALONG_SHARE * range_m))
    return dict(associate(cost, unmatched_cost=1.0).matches.tolist())
