"""Street furniture: masts with arms, trees and signs."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray
from autolights.sim.lighting import Bgr, Lighting
from autolights.sim.paste import add_glow, fill_polygon, paste_texture
from autolights.sim.view import View


@dataclass(frozen=True, eq=False)
class Beam:
    """A round bar: a mast, an arm, a wire.

    Attributes:
        points: (n, 3) its axis.
        diameters_m: At its start and its end.
        color: BGR.
    """

    points: FloatArray
    diameters_m: tuple[float, float]
    color: Bgr

    def paint(self, canvas: ImageArray, view: View, lighting: Lighting) -> list[FloatArray]:
        """Paint it, light on one side; returns its outlines in pixels."""
        pixels = view.project_inside(self.points)
        if pixels is None:
            return []
        depths = [max(view.depth_m(point), 0.4) for point in self.points]
        diameters = np.linspace(*self.diameters_m, len(self.points))
        widths = np.maximum(diameters * view.camera.intrinsics[0, 0] / np.array(depths), 0.7)
        outlines = []
        for i in range(len(pixels) - 1):
            along = pixels[i + 1] - pixels[i]
            length = float(np.linalg.norm(along))
            if length < 1e-6:
                continue
            across = np.array([-along[1], along[0]]) / length
            a, b = across * widths[i] / 2, across * widths[i + 1] / 2
            outline = np.array([pixels[i] - a, pixels[i + 1] - b, pixels[i + 1] + b, pixels[i] + a])
            fill_polygon(canvas, outline, lighting.shade(self.color, 0.75))
            if widths[i] > 3:
                lit = np.array([pixels[i] - 0.55 * a, pixels[i + 1] - 0.55 * b, pixels[i + 1], pixels[i]])
                fill_polygon(canvas, lit, lighting.shade(self.color, 1.05))
            outlines.append(outline)
        return outlines


# Of a painted tree, in multiples of its height: the middle of the crown below the top, and its half axes.
_CROWN_CENTER = (0.0, 0.34)
_CROWN_RADII = (0.29, 0.31)


@dataclass(frozen=True, eq=False)
class Tree:
    """A tree as a flat picture that always faces the camera.

    Attributes:
        position: (3,) where the trunk meets the ground.
        height_m: Overall.
        style: Which of the painted trees.
    """

    position: FloatArray
    height_m: float
    style: int

    def paint(self, canvas: ImageArray, view: View, lighting: Lighting) -> list[FloatArray]:
        """Paint it; returns the outline of its crown in pixels."""
        ends = view.project_inside(np.array([self.position, self.position + np.array([0.0, 0.0, self.height_m])]))
        if ends is None:
            return []
        (foot, top) = ends
        height = float(foot[1] - top[1])
        if height < 3 or height > 1500:
            return []
        half = 0.36 * height
        x0, y0, x1, y1 = (round(v) for v in (foot[0] - half, top[1], foot[0] + half, foot[1]))
        left, upper, right, lower = max(0, x0), max(0, y0), min(canvas.shape[1], x1), min(canvas.shape[0], y1)
        if right <= left or lower <= upper:
            return []
        picture = _painted_tree(self.style, lighting.ambient)
        scale = np.array([picture.shape[1] / (x1 - x0), picture.shape[0] / (y1 - y0)])
        warp = np.array(
            [[scale[0], 0, (left - x0 + 0.5) * scale[0] - 0.5], [0, scale[1], (upper - y0 + 0.5) * scale[1] - 0.5]]
        )
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        patch = cv2.warpAffine(picture, warp, (right - left, lower - upper), flags=flags)
        mask = np.where(patch[..., 3] > 127, 255, 0).astype(np.uint8)
        cv2.copyTo(np.ascontiguousarray(patch[..., :3]), mask, canvas[upper:lower, left:right])
        turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        crown = (
            top
            + height * np.array(_CROWN_CENTER)
            + height * np.array(_CROWN_RADII) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        )
        return [crown]


@dataclass(frozen=True, eq=False)
class Sign:
    """A flat picture on a mast or a wall, some of them look-alikes of a signal.

    Attributes:
        center: (3,) metres.
        yaw: The way it looks, radians.
        size_m: Width and height.
        kind: Which picture, one of `SIGN_KINDS`.
    """

    center: FloatArray
    yaw: float
    size_m: tuple[float, float]
    kind: str

    def paint(self, canvas: ImageArray, view: View, lighting: Lighting) -> list[FloatArray]:
        """Paint it; returns its outline in pixels."""
        normal = np.array([np.cos(self.yaw), np.sin(self.yaw), 0.0])
        if float(normal @ (view.position - self.center)) <= 0.2:
            return []
        right = np.array([-np.sin(self.yaw), np.cos(self.yaw), 0.0]) * self.size_m[0] / 2
        up = np.array([0.0, 0.0, self.size_m[1] / 2])
        corners = self.center + np.array([-right + up, right + up, right - up, -right - up])
        quad = view.project_inside(corners)
        if quad is None:
            return []
        picture = _painted_sign(self.kind, lighting.ambient)
        height = float(np.linalg.norm(quad[3] - quad[0]))
        while picture.shape[0] > 4 * height and picture.shape[0] > 8:
            half = (picture.shape[1] // 2, picture.shape[0] // 2)
            picture = np.asarray(cv2.resize(picture, half, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        paste_texture(canvas, picture, quad)
        if self.kind in _SHINING and lighting.lamps_on:
            add_glow(canvas, quad.mean(axis=0), max(0.4 * height, 0.8), _SHINING[self.kind], 0.45)
        return [quad]


SIGN_KINDS = (
    "stop",
    "no_entry",
    "speed",
    "warning",
    "walk",
    "wait",
    "cross",
    "disc_red",
    "disc_amber",
    "neon",
    "trio",
    "street_lamp",
)
_SHINING: dict[str, Bgr] = {
    "street_lamp": (150.0, 215.0, 255.0),
    "walk": (235.0, 240.0, 235.0),
    "wait": (60.0, 130.0, 255.0),
    "cross": (110.0, 230.0, 60.0),
    "disc_red": (60.0, 50.0, 255.0),
    "disc_amber": (60.0, 190.0, 255.0),
    "neon": (220.0, 90.0, 255.0),
}


@lru_cache(maxsize=64)
def _painted_sign(kind: str, ambient: Bgr) -> ImageArray:
    """(64, 64, 4) BGR multiplied by alpha, and alpha."""
    picture, alpha = np.zeros((64, 64, 3), np.uint8), np.zeros((64, 64), np.uint8)
    red, white, amber, green = (40, 32, 200), (238, 238, 238), (30, 170, 235), (90, 175, 40)
    middle, aa = (32, 32), cv2.LINE_AA

    def disc(color: tuple[int, int, int], radius: int) -> None:
        cv2.circle(picture, middle, radius, color, -1, aa)
        cv2.circle(alpha, middle, radius, 255, -1, aa)

    if kind == "stop":
        turn = np.linspace(0, 2 * np.pi, 8, endpoint=False) + np.pi / 8
        octagon = np.round(32 + 30 * np.stack([np.cos(turn), np.sin(turn)], axis=1)).astype(np.int32)
        cv2.fillPoly(picture, [octagon], red, aa)
        cv2.fillPoly(alpha, [octagon], 255, aa)
        cv2.rectangle(picture, (14, 26), (50, 38), white, -1)
    elif kind == "no_entry":
        disc(red, 30)
        cv2.rectangle(picture, (12, 27), (52, 37), white, -1)
    elif kind == "speed":
        disc(red, 30)
        cv2.circle(picture, middle, 23, white, -1, aa)
        cv2.putText(picture, "50", (15, 41), cv2.FONT_HERSHEY_SIMPLEX, 0.85, (20, 20, 20), 3, aa)
    elif kind == "warning":
        diamond = np.array([[32, 2], [62, 32], [32, 62], [2, 32]], np.int32)
        cv2.fillPoly(picture, [diamond], amber, aa)
        cv2.fillPoly(alpha, [diamond], 255, aa)
        cv2.line(picture, (32, 18), (32, 46), (20, 20, 20), 6, aa)
    elif kind in ("walk", "wait"):
        picture[:], alpha[:] = (30, 28, 26), 255
        if kind == "walk":
            cv2.line(picture, (32, 20), (32, 42), (235, 240, 235), 9, aa)
            cv2.line(picture, (22, 56), (32, 40), (235, 240, 235), 6, aa)
            cv2.line(picture, (42, 56), (32, 40), (235, 240, 235), 6, aa)
            cv2.circle(picture, (32, 12), 6, (235, 240, 235), -1, aa)
        else:
            cv2.rectangle(picture, (20, 24), (44, 54), (50, 120, 255), -1)
            cv2.line(picture, (24, 10), (24, 30), (50, 120, 255), 5)
            cv2.line(picture, (34, 8), (34, 30), (50, 120, 255), 5)
    elif kind == "cross":
        picture[:], alpha[:] = (60, 60, 60), 255
        cv2.rectangle(picture, (24, 6), (40, 58), green, -1)
        cv2.rectangle(picture, (6, 24), (58, 40), green, -1)
    elif kind == "disc_red":
        disc((60, 50, 250), 30)
    elif kind == "disc_amber":
        disc((50, 185, 250), 30)
    elif kind == "street_lamp":
        picture[:], alpha[:] = (190, 230, 250), 255
    elif kind == "neon":
        picture[:], alpha[:] = (40, 30, 44), 255
        cv2.putText(picture, "BAR", (6, 42), cv2.FONT_HERSHEY_SIMPLEX, 0.85, (210, 90, 255), 4, aa)
    else:  # three coloured discs in a row, as shops and banks have them
        picture[:], alpha[:] = (225, 225, 225), 255
        for x, color in ((12, red), (32, amber), (52, green)):
            cv2.circle(picture, (x, 32), 9, color, -1, aa)
    shaded = picture if kind in _SHINING else picture * np.array(ambient)
    return np.dstack([shaded * (alpha[..., None] / 255.0), alpha]).round().astype(np.uint8)


@lru_cache(maxsize=32)
def _painted_tree(style: int, ambient: Bgr) -> ImageArray:
    """(320, 230, 4) BGR and alpha of a crown of leaves on a trunk."""
    rng = np.random.default_rng(7_000 + style)
    picture, alpha = np.zeros((320, 230, 3), np.uint8), np.zeros((320, 230), np.uint8)
    trunk = np.array([[110, 319], [120, 319], [118, 150], [112, 150]], np.int32)
    cv2.fillPoly(picture, [trunk], (48, 62, 78))
    cv2.fillPoly(alpha, [trunk], 255)
    leaf = np.array([(46, 92, 62), (40, 78, 70), (56, 104, 96)][style % 3], dtype=np.float64)
    for layer in np.linspace(0.55, 1.25, 9):
        for _ in range(38):
            turn, reach = rng.uniform(0, 2 * np.pi), np.sqrt(rng.uniform(0, 1))
            x = 115 + 92 * reach * np.cos(turn) * (1.1 - 0.3 * layer)
            y = 110 + 100 * reach * np.sin(turn) - 26 * (layer - 0.9)
            color = leaf * layer * rng.uniform(0.85, 1.15)
            center, radius = (round(x), round(y)), int(rng.integers(5, 15))
            cv2.circle(picture, center, radius, color.tolist(), -1)
            cv2.circle(alpha, center, radius, 255, -1)
    return np.dstack([picture * np.array(ambient), alpha]).round().astype(np.uint8)
