"""The ground: a picture of road, markings and pavements from above, laid out in perspective."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np

from autolights.core import ImageArray
from autolights.sim.lighting import Bgr, Lighting
from autolights.sim.view import View

_PX_PER_M = (8, 16)  # along the road and across it
_HALF_WIDTH_M = 30.0
_BANDS_M = ((0.0, 1), (16.0, 4), (45.0, 16))  # from this distance on the picture is thinned along by this factor
_FARTHEST_M = 400.0


@dataclass(frozen=True)
class Markings:
    """The road as seen from above.

    Attributes:
        half_width_m: Of the road.
        lane_lines_m: y of the lines between lanes of one direction.
        stop_lines_m: x of the lines across our lanes.
        crossings_m: x of the middle of each zebra crossing.
        cross_streets_m: x of the start and the end of each crossing road.
        verge: BGR beside the pavement.
        asphalt: BGR.
        texture: Which pattern of stains and repairs.
    """

    half_width_m: float
    lane_lines_m: tuple[float, ...]
    stop_lines_m: tuple[float, ...]
    crossings_m: tuple[float, ...]
    cross_streets_m: tuple[tuple[float, float], ...]
    verge: Bgr
    asphalt: Bgr
    texture: int


@dataclass(frozen=True, eq=False)
class Ground:
    """A picture of the town from above, and what it is worth along the road.

    Attributes:
        start_m: x of its first column.
        levels: The picture at full length and thinned along the road, for greater distances.
    """

    start_m: float
    levels: tuple[ImageArray, ...]

    def paint(self, canvas: ImageArray, view: View, lighting: Lighting) -> None:
        """Cover everything below the horizon."""
        rays = view.rays()
        slope = rays[..., 2]
        eye = view.position
        reach = np.where(slope < -1e-4, eye[2] / np.maximum(-slope, 1e-4), _FARTHEST_M)
        reach = np.minimum(reach, _FARTHEST_M)
        along = ((eye[0] + reach * rays[..., 0] - self.start_m) * _PX_PER_M[0] - 0.5).astype(np.float32)
        across = ((_HALF_WIDTH_M - eye[1] - reach * rays[..., 1]) * _PX_PER_M[1] - 0.5).astype(np.float32)
        height, width = canvas.shape[:2]
        along, across = (cv2.resize(m, (width, height), interpolation=cv2.INTER_LINEAR) for m in (along, across))
        below = (cv2.resize(slope.astype(np.float32), (width, height)) < 0).astype(np.uint8)
        distance = along[:, width // 2] / _PX_PER_M[0] + self.start_m - eye[0]
        rows = np.flatnonzero(below.any(axis=1))
        haze = np.array(lighting.sky_horizon) * 0.8
        for level, (nearest, thinning) in enumerate(_BANDS_M):
            farthest = _BANDS_M[level + 1][0] if level + 1 < len(_BANDS_M) else np.inf
            band = rows[(distance[rows] >= nearest) & (distance[rows] < farthest)]
            if level == 0:
                band = rows[distance[rows] < farthest]
            if not len(band):
                continue
            part = slice(int(band[0]), int(band[-1]) + 1)
            x = (along[part] + 0.5) / thinning - 0.5
            picture = cv2.remap(self.levels[level], x, across[part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            if level == len(_BANDS_M) - 1:
                share = np.clip((distance[part] - 60) / 200, 0, 0.6)[:, None, None]
                picture = (picture + share * (haze - picture)).astype(np.uint8)
            cv2.copyTo(picture, below[part], canvas[part])


def draw_ground(markings: Markings, start_m: float, end_m: float, lighting: Lighting) -> Ground:
    """Draw the town from above between two x."""
    along, across = _PX_PER_M
    width, height = round((end_m - start_m) * along), round(2 * _HALF_WIDTH_M * across)
    picture = np.empty((height, width, 3), np.uint8)
    picture[:] = np.array(lighting.shade(markings.verge)).astype(np.uint8)

    def rectangle(x0: float, x1: float, y0: float, y1: float, color: Bgr) -> None:
        top, bottom = (_HALF_WIDTH_M - y1) * across, (_HALF_WIDTH_M - y0) * across
        first = (round((x0 - start_m) * along), round(top))
        last = (round((x1 - start_m) * along) - 1, round(bottom) - 1)
        if last[0] >= 0 and first[0] < width:
            cv2.rectangle(picture, first, last, lighting.shade(color), -1)

    half = markings.half_width_m
    white, yellow, kerb, pavement = (
        (205.0, 208.0, 208.0),
        (60.0, 165.0, 205.0),
        (158.0, 160.0, 162.0),
        (136.0, 140.0, 145.0),
    )
    rectangle(start_m, end_m, -half - 3.2, half + 3.2, pavement)
    rectangle(start_m, end_m, -half - 0.2, half + 0.2, kerb)
    rectangle(start_m, end_m, -half, half, markings.asphalt)
    for x0, x1 in markings.cross_streets_m:
        rectangle(x0 - 3, x1 + 3, -_HALF_WIDTH_M, -half - 3.2, pavement)
        rectangle(x0 - 3, x1 + 3, half + 3.2, _HALF_WIDTH_M, pavement)
        rectangle(x0, x1, -_HALF_WIDTH_M, _HALF_WIDTH_M, markings.asphalt)
    edges = [start_m, *(x for pair in markings.cross_streets_m for x in (pair[0] - 6, pair[1] + 6)), end_m]
    for x0, x1 in zip(edges[::2], edges[1::2], strict=True):
        rectangle(x0, x1, 0.1, 0.22, yellow)
        rectangle(x0, x1, -0.22, -0.1, yellow)
        for y in markings.lane_lines_m:
            for x in np.arange(x0, x1 - 3, 9.0):
                rectangle(x, x + 3, y - 0.07, y + 0.07, white)
    for x in markings.stop_lines_m:
        rectangle(x - 0.25, x + 0.25, -half + 0.2, -0.3, white)
    for x in markings.crossings_m:
        for y in np.arange(-half + 0.4, half - 0.6, 1.2):
            rectangle(x - 1.3, x + 1.3, y, y + 0.6, white)
    levels = [_as_image(cv2.multiply(picture, _stained(markings.texture, width, height), scale=1 / 128))]
    for (_, before), (_, thinning) in pairwise(_BANDS_M):
        last = levels[-1]
        size = (max(1, last.shape[1] * before // thinning), last.shape[0])
        levels.append(_as_image(cv2.resize(last, size, interpolation=cv2.INTER_AREA)))
    return Ground(start_m, tuple(levels))


def _as_image(matrix: object) -> ImageArray:
    return np.asarray(matrix, dtype=np.uint8)


@lru_cache(maxsize=8)
def _stains(style: int) -> ImageArray:
    """(512, 512) brightness factor times 128: grain, stains and darker repairs."""
    rng = np.random.default_rng(6_000 + style)
    stains = 128 + rng.normal(0, 5, (512, 512)).astype(np.float32)
    for size, depth in ((8, 10), (32, 6)):
        stains += depth * cv2.resize(rng.normal(0, 1, (size, size)).astype(np.float32), (512, 512))
    for _ in range(4):
        x, y, w, h = rng.integers(0, 440), rng.integers(0, 440), rng.integers(15, 70), rng.integers(15, 60)
        stains[y : y + h, x : x + w] -= 14
    return np.clip(stains, 0, 255).astype(np.uint8)


@lru_cache(maxsize=8)
def _stained(style: int, width: int, height: int) -> ImageArray:
    """(height, width, 3) of repeated `_stains`."""
    stains = _stains(style)
    repeats = (height // stains.shape[0] + 1, width // stains.shape[1] + 1)
    return np.repeat(np.tile(stains, repeats)[:height, :width, None], 3, axis=2)
