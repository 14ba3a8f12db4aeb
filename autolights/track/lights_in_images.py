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
    squares, towards = away * away, known.faces[:, None] * away[:2]
    distance2 = squares[0] + squares[1] + squares[2]
    possible = distance2 <= ((RANGE_MARGIN * optics.range_m) ** 2)[:, None]
    possible &= towards[0] + towards[1] < 0
    columns = np.logical_or.reduce(possible, axis=0).nonzero()[0]

    lows, highs = shots.project_outlines(known.corners.take(columns, axis=2), known.origin)
    size_wh = optics.size_wh[:, :, None]
    # NaN compares false: a corner that does not project drops the light.
    overlaps = (highs > 0) & (lows < size_wh)
    rows = (possible.take(columns, axis=1) & overlaps[0] & overlaps[1]).ravel().nonzero()[0]
    images, which = np.divmod(rows, max(len(columns), 1))
    lights = columns.take(which)
    boxes = np.empty((4, len(rows)))
    lows.reshape(2, -1).take(rows, axis=1, out=boxes[:2])
    highs.reshape(2, -1).take(rows, axis=1, out=boxes[2:])
    distances_m = np.sqrt(distance2.ravel().take(images * len(known) + lights))
    contained = (boxes[:2] >= 0) & (boxes[2:] <= optics.size_wh.take(images, axis=1))
    return LightsInImages(
        indices=known.rows.take(lights),
        types=known.types.take(lights),
        boxes_xyxy=boxes.T,
        distances_m=distances_m,
        expected=contained[0] & contained[1] & (distances_m <= optics.range_m.take(images)),
        images=images,
        type_codes=known.type_codes.take(lights),
    )
