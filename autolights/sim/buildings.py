"""Buildings along the road, with windows, shops and their signs."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray
from autolights.sim.lighting import Bgr, Lighting
from autolights.sim.paste import paste_opaque
from autolights.sim.view import View

_BAY_M, _FLOOR_M, _BAY_PX = 3.0, 3.2, 56


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
        shaded = cv2.multiply(texture, (blue, green, red, 1.0))  # type: ignore[call-overload]  # OpenCV takes a scalar
        paste_opaque(canvas, np.asarray(shaded, dtype=np.uint8), quad)


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
