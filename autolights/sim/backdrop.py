"""What is behind the signals: sky, ground with road and markings, and rows of buildings."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np

from autolights.core import CameraModel, FloatArray, ImageArray, back_project
from autolights.sim.lighting import Bgr, Lighting
from autolights.sim.paste import paste_opaque
from autolights.sim.view import View

_GRID = 4  # rays are computed for every fourth pixel and interpolated between
_GROUND_PX_PER_M = (8, 16)  # along the road and across it
_GROUND_HALF_WIDTH_M = 30.0
_BANDS_M = ((0.0, 1), (16.0, 4), (45.0, 16))  # from this distance on the ground picture is thinned along by this factor
_FARTHEST_M = 400.0
_BAY_M, _FLOOR_M, _BAY_PX = 3.0, 3.2, 56


def paint_sky(canvas: ImageArray, view: View, lighting: Lighting, *, sun_azimuth: float, clouds: int) -> None:
    """Fill the whole canvas with sky: a gradient, clouds and perhaps a low sun.

    Args:
        canvas: Painted on.
        view: Camera and pose.
        lighting: Colours.
        sun_azimuth: Radians from the town's x axis.
        clouds: Which of the cloud pictures.
    """
    rays = _rays(view)[::2, ::2]
    elevation = np.degrees(np.arcsin(np.clip(rays[..., 2], -1, 1)))
    rise = np.clip(elevation / 38, 0, 1)[..., None] ** 0.7
    sky = np.array(lighting.sky_horizon) * (1 - rise) + np.array(lighting.sky_top) * rise
    azimuth = np.arctan2(rays[..., 1], rays[..., 0])
    picture = _clouds(clouds)
    across = (picture.shape[1] / 2 * (1 + azimuth / np.pi)).astype(np.float32)  # its seam lies behind us
    down = np.clip(picture.shape[0] * (1 - elevation / 60), 0, picture.shape[0] - 1).astype(np.float32)
    cover = cv2.remap(picture, across, down, cv2.INTER_LINEAR)[..., None] * np.clip(elevation / 4, 0, 1)[..., None]
    sky = sky + cover * (np.array(lighting.cloud) - sky)
    if lighting.sun_elevation_deg is not None:
        height = np.radians(lighting.sun_elevation_deg)
        sun = np.array([np.cos(height) * np.cos(sun_azimuth), np.cos(height) * np.sin(sun_azimuth), np.sin(height)])
        angle = np.degrees(np.arccos(np.clip(rays @ sun, -1, 1)))[..., None]
        shine = 0.75 * np.exp(-angle / 9) + np.exp(-((angle / 1.6) ** 2))
        sky = sky + np.minimum(shine, 1) * (np.array([215.0, 243.0, 255.0]) - sky)
    height_px, width_px = canvas.shape[:2]
    canvas[:] = cv2.resize(np.clip(sky, 0, 255).astype(np.uint8), (width_px, height_px), interpolation=cv2.INTER_LINEAR)


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
        rays = _rays(view)
        slope = rays[..., 2]
        eye = view.position
        reach = np.where(slope < -1e-4, eye[2] / np.maximum(-slope, 1e-4), _FARTHEST_M)
        reach = np.minimum(reach, _FARTHEST_M)
        along = ((eye[0] + reach * rays[..., 0] - self.start_m) * _GROUND_PX_PER_M[0] - 0.5).astype(np.float32)
        across = ((_GROUND_HALF_WIDTH_M - eye[1] - reach * rays[..., 1]) * _GROUND_PX_PER_M[1] - 0.5).astype(np.float32)
        height, width = canvas.shape[:2]
        along, across = (cv2.resize(m, (width, height), interpolation=cv2.INTER_LINEAR) for m in (along, across))
        below = (cv2.resize(slope.astype(np.float32), (width, height)) < 0).astype(np.uint8)
        distance = along[:, width // 2] / _GROUND_PX_PER_M[0] + self.start_m - eye[0]
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


def draw_ground(markings: Markings, start_m: float, end_m: float, lighting: Lighting) -> Ground:
    """Draw the town from above between two x."""
    along, across = _GROUND_PX_PER_M
    width, height = round((end_m - start_m) * along), round(2 * _GROUND_HALF_WIDTH_M * across)
    picture = np.empty((height, width, 3), np.uint8)
    picture[:] = np.array(lighting.shade(markings.verge)).astype(np.uint8)

    def rectangle(x0: float, x1: float, y0: float, y1: float, color: Bgr) -> None:
        top, bottom = (_GROUND_HALF_WIDTH_M - y1) * across, (_GROUND_HALF_WIDTH_M - y0) * across
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
        rectangle(x0 - 3, x1 + 3, -_GROUND_HALF_WIDTH_M, -half - 3.2, pavement)
        rectangle(x0 - 3, x1 + 3, half + 3.2, _GROUND_HALF_WIDTH_M, pavement)
        rectangle(x0, x1, -_GROUND_HALF_WIDTH_M, _GROUND_HALF_WIDTH_M, markings.asphalt)
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


@dataclass(frozen=True)
class Building:
    """A block along the road.

    Attributes:
        start_m: x of its near end.
        end_m: x of its far end.
        side: 1 left of the road, -1 right.
        setback_m: |y| of its front.
        depth_m: Away from the road.
        height_m: Of the roof.
        style: Which facade.
        tint: BGR factors.
    """

    start_m: float
    end_m: float
    side: int
    setback_m: float
    depth_m: float
    height_m: float
    style: int
    tint: Bgr

    def paint(self, canvas: ImageArray, view: View, lighting: Lighting) -> None:
        """Paint the two walls that can be seen: along the road and towards us."""
        floors = max(1, round(self.height_m / _FLOOR_M))
        near_m = max(self.start_m, float(view.position[0]) + 2.0)
        front_y, back_y = self.side * self.setback_m, self.side * (self.setback_m + self.depth_m)
        if self.start_m > view.position[0] + 2:
            bays = max(1, round(self.depth_m / _BAY_M))
            wall = np.array([[self.start_m, back_y, 0.0], [self.start_m, front_y, 0.0]])
            self._paint_wall(canvas, view, lighting, wall if self.side > 0 else wall[::-1], bays, floors, 0.72)
        length = self.end_m - near_m
        if length > 0.5:
            bays = max(1, round(length / _BAY_M))
            wall = np.array([[near_m, front_y, 0.0], [self.end_m, front_y, 0.0]])
            self._paint_wall(canvas, view, lighting, wall if self.side > 0 else wall[::-1], bays, floors, 0.95)

    def _paint_wall(
        self,
        canvas: ImageArray,
        view: View,
        lighting: Lighting,
        foot: FloatArray,
        bays: int,
        floors: int,
        light: float,
    ) -> None:
        roof = foot + np.array([0.0, 0.0, self.height_m])
        quad = view.project_inside(np.array([roof[0], roof[1], foot[1], foot[0]]))
        if quad is None or np.ptp(quad[:, 0]) < 1:
            return
        tile = _facade(self.style, lighting.lamps_on)
        bay, floor = _BAY_PX, _BAY_PX
        columns = np.arange(bays) % (tile.shape[1] // bay)
        upper = np.concatenate([tile[:floor, c * bay : (c + 1) * bay] for c in columns], axis=1)
        second = np.concatenate([tile[floor : 2 * floor, c * bay : (c + 1) * bay] for c in columns[::-1]], axis=1)
        shop = np.concatenate([tile[2 * floor :, c * bay : (c + 1) * bay] for c in columns], axis=1)
        texture = np.concatenate([(upper, second)[i % 2] for i in range(floors - 1)] + [shop], axis=0)
        ambient = np.ones(3) if lighting.lamps_on else lighting.ambient_array
        blue, green, red = (float(factor) for factor in ambient * np.array(self.tint) * light)
        paste_opaque(canvas, _as_image(cv2.multiply(texture, (blue, green, red, 1.0))), quad)  # type: ignore[call-overload]  # OpenCV takes a scalar


def paint_skyline(canvas: ImageArray, view: View, lighting: Lighting, *, end_m: float, style: int) -> None:
    """Close the road's end with hazy blocks and trees."""
    rng = np.random.default_rng(9_000 + style)
    y = -120.0
    haze = np.array(lighting.sky_horizon)
    while y < 120:
        width, height = float(rng.uniform(8, 26)), float(rng.uniform(5, 22))
        base = np.array([(92, 96, 100), (84, 92, 112), (62, 88, 70)][int(rng.integers(3))])
        color = 0.55 * base * lighting.ambient_array + 0.45 * haze * min(1.0, lighting.ambient[1] + 0.3)
        corners = np.array([[end_m, y, 0.0], [end_m, y + width, 0.0], [end_m, y + width, height], [end_m, y, height]])
        polygon = view.polygon(corners)
        if polygon is not None:
            cv2.fillConvexPoly(canvas, np.round(polygon * 16).astype(np.int32), color.tolist(), cv2.LINE_AA, 4)
        y += width * 0.9


@lru_cache(maxsize=8)
def _camera_rays(camera: CameraModel) -> FloatArray:
    """(h, w, 3) unit rays of every fourth pixel's block, in the camera frame."""
    # Block middles, exact for any size: cv2.resize maps the grid back onto the whole image in the same way.
    columns, rows = ((np.arange(-(-n // _GRID)) + 0.5) * (n / -(-n // _GRID)) - 0.5 for n in camera.size_wh)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays = back_project(pixels, camera)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return rays.reshape(len(rows), len(columns), 3)


def _as_image(matrix: object) -> ImageArray:
    return np.asarray(matrix, dtype=np.uint8)


def _rays(view: View) -> FloatArray:
    return np.asarray(_camera_rays(view.camera) @ view.town_from_cam[:3, :3].T)


@lru_cache(maxsize=8)
def _clouds(style: int) -> FloatArray:
    """(256, 2048) share of cloud, 0 to 1."""
    rng = np.random.default_rng(5_000 + style)
    total = np.zeros((256, 2048), np.float32)
    for size, weight in ((4, 0.5), (8, 0.3), (24, 0.15), (64, 0.08)):
        noise = rng.uniform(0, 1, (size, size * 6)).astype(np.float32)
        total += weight * cv2.resize(noise, (2048, 256), interpolation=cv2.INTER_CUBIC)
    cover: FloatArray = np.clip((total - 0.5) * 2.8, 0, 0.85).astype(np.float32)
    return cover


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


@lru_cache(maxsize=64)
def _facade(style: int, lamps_on: bool) -> ImageArray:
    """(3, 8) bays of a wall: two kinds of upper floor and a ground floor with shops; at dusk already in its light."""
    rng = np.random.default_rng(8_000 + style)
    walls = [(120, 140, 176), (150, 166, 178), (176, 182, 186), (96, 112, 150), (140, 134, 128), (84, 92, 104)]
    wall = np.array(walls[style % len(walls)]) * rng.uniform(0.8, 1.1)
    dim = 0.34 if lamps_on else 1.0
    bay = _BAY_PX
    picture = np.empty((3 * bay, 8 * bay, 3), np.float32)
    picture[:] = wall * dim
    picture *= rng.normal(1, 0.03, picture.shape[:2])[..., None].astype(np.float32)
    glass_width, glass_height = int(rng.integers(22, 44)), int(rng.integers(26, 42))
    frame = wall * dim * rng.choice([0.6, 1.25])
    for row in range(2):
        for column in range(8):
            x, y = column * bay + (bay - glass_width) // 2, row * bay + (bay - glass_height) // 2
            lit = lamps_on and rng.uniform() < 0.35
            glass = (
                np.array([130, 205, 245]) * rng.uniform(0.6, 1)
                if lit
                else np.array([96, 82, 70]) * rng.uniform(0.5, 1.5) * dim
            )
            cv2.rectangle(picture, (x - 2, y - 2), (x + glass_width + 2, y + glass_height + 2), frame.tolist(), -1)
            cv2.rectangle(picture, (x, y), (x + glass_width, y + glass_height), glass.tolist(), -1)
            cv2.line(picture, (x + glass_width // 2, y), (x + glass_width // 2, y + glass_height), frame.tolist(), 2)
        cv2.line(picture, (0, row * bay), (8 * bay, row * bay), (wall * dim * 0.8).tolist(), 2)
    for column in range(0, 8, 2):
        x, y = column * bay, 2 * bay
        sign = np.array(
            [(40, 36, 200), (60, 150, 50), (40, 170, 230), (190, 110, 40), (230, 230, 230)][int(rng.integers(5))]
        )
        sign = sign * (0.9 if lamps_on else rng.uniform(0.7, 1.0))
        window = np.array([120, 190, 225]) * 0.9 if lamps_on else np.array([80, 76, 72])
        cv2.rectangle(picture, (x + 6, y + 8), (x + 2 * bay - 6, y + 17), sign.tolist(), -1)
        for letter in range(x + 14, x + 2 * bay - 16, 9):
            if rng.uniform() < 0.8:
                ink = (235.0, 235.0, 235.0) if sign.mean() < 150 else (40.0, 40.0, 40.0)
                cv2.rectangle(picture, (letter, y + 10), (letter + int(rng.integers(3, 7)), y + 15), ink, -1)
        cv2.rectangle(picture, (x + 6, y + 20), (x + 2 * bay - 28, y + bay - 2), window.tolist(), -1)
        cv2.rectangle(picture, (x + 2 * bay - 22, y + 20), (x + 2 * bay - 8, y + bay - 1), (window * 0.6).tolist(), -1)
    return np.clip(picture, 0, 255).astype(np.uint8)
