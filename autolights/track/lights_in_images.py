"""Where the images of one set should show the known lights: `project_lights` for all images at once."""

from dataclasses import dataclass

import numpy as np

from autolights.core import IntArray
from autolights.core.light_box import RANGE_MARGIN
from autolights.core.shots import Shots
from autolights.track.known_lights import KnownLights
from autolights.track.projection import ProjectedLights


@dataclass(frozen=True, eq=False)
class LightsInImages(ProjectedLights):
    """Known lights in several images, a row for each light in each image, image by image.

    Attributes:
        images: (n,) which image, ascending.
        type_codes: (n,) of their types (`KnownLights`).
    """

    images: IntArray
    type_codes: IntArray


def project_known(known: KnownLights, shots: Shots) -> LightsInImages:
    """Project the lights that each camera can have in view (`core.light_box.project_visible`).

    Args:
        known: Lights around the vehicle.
        shots: The images.

    Returns:
        Rows by image, within it as `known` has them.
    """
    optics = shots.optics
    away = known.positions[:, None] - (shots.vehicle - known.origin).T[:, :, None]  # (3, images, lights)
    distance2 = away[0] * away[0] + away[1] * away[1] + away[2] * away[2]
    near = distance2 <= ((RANGE_MARGIN * optics.range_m) ** 2)[:, None]
    faces_us = known.faces[0] * away[0] + known.faces[1] * away[1] < 0
    possible = near & faces_us
    columns = np.flatnonzero(possible.any(axis=0))

    lows, highs = shots.project_outlines(known.corners.take(columns, axis=2), known.origin)
    size_wh = optics.size_wh.T[:, :, None]
    # NaN compares false: a corner that does not project drops the light.
    shown = possible[:, columns] & ((highs > 0) & (lows < size_wh)).all(axis=1)
    images, which = np.nonzero(shown)
    lows, highs = lows[images, :, which], highs[images, :, which]
    lights = columns[which]
    distances_m = np.sqrt(distance2[images, lights])
    contained = ((lows >= 0) & (highs <= optics.size_wh.T[images])).all(axis=1)
    return LightsInImages(
        indices=known.rows[lights],
        types=known.types[lights],
        boxes_xyxy=np.concatenate([lows, highs], axis=1),
        distances_m=distances_m,
        expected=contained & (distances_m <= optics.range_m[images]),
        images=images,
        type_codes=known.type_codes[lights],
    )
