"""Signal heads: the painted face of each type and state, and how it gets into the picture."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray, Lamp, LightType, SignalSet
from autolights.sim.disturbances import HeadLook
from autolights.sim.lighting import Bgr, Lighting
from autolights.sim.paste import add_glow, fill_polygon, paste_texture
from autolights.sim.view import View

HousingColor = Literal["black", "yellow"]

_HOUSING: dict[HousingColor, Bgr] = {"black": (38.0, 36.0, 34.0), "yellow": (28.0, 158.0, 214.0)}
# BGR of a lamp: unlit lens, lit, over-exposed by half, fully. Red goes over amber towards white, green turns white.
_UNLIT: dict[str, Bgr] = {"red": (30.0, 28.0, 92.0), "yellow": (22.0, 74.0, 104.0), "green": (58.0, 74.0, 26.0)}
_LIT: dict[str, Bgr] = {"red": (62.0, 48.0, 255.0), "yellow": (50.0, 196.0, 255.0), "green": (176.0, 240.0, 64.0)}
_WARM: dict[str, Bgr] = {"red": (78.0, 140.0, 255.0), "yellow": (110.0, 218.0, 255.0), "green": (212.0, 250.0, 160.0)}
_HOT: dict[str, Bgr] = {"red": (172.0, 222.0, 255.0), "yellow": (188.0, 240.0, 255.0), "green": (244.0, 255.0, 236.0)}
_SCALES_PX_PER_M = (24, 48, 96, 192, 384)
_LEVELS = 8  # looks are rounded to this many steps, so that painted faces can be used again
_CACHE_BYTES = 64 * 1024 * 1024
# An arrow in a lens of radius 1 that points left: shaft and head.
_ARROW = np.array(
    [[-0.78, 0], [-0.12, -0.66], [-0.12, -0.24], [0.72, -0.24], [0.72, 0.24], [-0.12, 0.24], [-0.12, 0.66]]
)
_ARROW_TURNS = {"left": 0, "straight": 1, "right": 2}


@dataclass(frozen=True, eq=False)
class SignalHead:
    """One head in the town.

    Attributes:
        id: Unique in the town.
        type: Of the signal description.
        position: (3,) centre of the housing, metres.
        yaw: The way the face looks, radians from the town's x axis to its y axis.
        intersection: Name.
        group: Approach that it speaks to.
        housing: Its paint.
        size_m: Width, height, depth.
    """

    id: str
    type: str
    position: FloatArray
    yaw: float
    intersection: str
    group: str
    housing: HousingColor
    size_m: tuple[float, float, float]

    @property
    def normal(self) -> FloatArray:
        """(3,) unit vector out of the face."""
        return np.array([np.cos(self.yaw), np.sin(self.yaw), 0.0])

    @property
    def right(self) -> FloatArray:
        """(3,) unit vector to the right of somebody who looks at the face."""
        return np.array([-np.sin(self.yaw), np.cos(self.yaw), 0.0])

    def on_face(self, across: FloatArray, down: FloatArray, forward: float = 0.5) -> FloatArray:
        """(n, 3) points at (n,) fractions of the face, and `forward` times the depth before the centre."""
        width, height, depth = self.size_m
        up = np.array([0.0, 0.0, 1.0])
        return np.asarray(
            self.position
            + np.outer((np.asarray(across) - 0.5) * width, self.right)
            + np.outer((0.5 - np.asarray(down)) * height, up)
            + self.normal * depth * forward
        )

    def corners(self) -> FloatArray:
        """(8, 3) corners of the housing: four of the face, four of the back."""
        across, down = np.array([0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0])
        return np.concatenate([self.on_face(across, down, 0.5), self.on_face(across, down, -0.5)])

    def facing_deg(self, viewpoint: FloatArray) -> float:
        """Horizontal angle between the face's normal and the direction to a (3,) viewpoint."""
        towards = (viewpoint - self.position)[:2]
        cosine = float(self.normal[:2] @ towards / max(float(np.linalg.norm(towards)), 1e-9))
        return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


class HeadPainter:
    """Paints heads in one light and keeps the faces that it has painted.

    Args:
        signals: What the types look like.
        lighting: The light of the scene.
    """

    def __init__(self, signals: SignalSet, lighting: Lighting) -> None:
        self._signals = signals
        self._lighting = lighting
        self._faces: dict[tuple[object, ...], ImageArray] = {}
        self._bytes = 0

    def paint(
        self, canvas: ImageArray, view: View, head: SignalHead, lit_class: str, look: HeadLook
    ) -> list[FloatArray]:
        """Paint one head.

        Returns:
            Its outlines: (n, 2) convex polygons in pixels; none if it is not in front of the camera.
        """
        light_type = self._signals.types[head.type]
        corners_px = view.project_inside(head.corners())
        if corners_px is None or not _touches(canvas, corners_px):
            return []
        outlines = self._paint_body(canvas, view, head, light_type)
        if head.facing_deg(view.position) < 88:
            face_px = corners_px[:4]
            height_px = float(np.linalg.norm(face_px[3] - face_px[0]))
            wanted = 1.5 * height_px / head.size_m[1]
            scale = next((s for s in _SCALES_PX_PER_M if s >= wanted), _SCALES_PX_PER_M[-1])
            paste_texture(canvas, self._face(head, light_type, lit_class, look, scale), face_px)
            self._paint_glow(canvas, view, head, light_type, lit_class, look, height_px / head.size_m[1])
        if look.veil > 0:
            center, reach = corners_px.mean(axis=0), 1.1 * float(np.ptp(corners_px, axis=0).max())
            add_glow(canvas, center, reach, self._lighting.shade((215, 235, 250)), 0.9 * look.veil)
        return outlines

    def _paint_body(self, canvas: ImageArray, view: View, head: SignalHead, light_type: LightType) -> list[FloatArray]:
        color = self._lighting.shade(_HOUSING[head.housing], 0.75)
        outlines: list[FloatArray] = []
        for left, top, right, bottom in _sections(light_type):
            across, down = np.array([left, right, right, left]), np.array([top, top, bottom, bottom])
            points = view.project(np.concatenate([head.on_face(across, down, 0.5), head.on_face(across, down, -0.5)]))
            outline = cv2.convexHull(points.astype(np.float32)).reshape(-1, 2).astype(np.float64)
            fill_polygon(canvas, outline, color)
            outlines.append(outline)
        return outlines

    def _paint_glow(
        self,
        canvas: ImageArray,
        view: View,
        head: SignalHead,
        light_type: LightType,
        lit_class: str,
        look: HeadLook,
        px_per_m: float,
    ) -> None:
        strength = look.brightness * (self._lighting.glow + 0.75 * max(0.0, look.washout - 0.35))
        if strength < 0.03:
            return
        for name in light_type.states[lit_class].lit:
            lamp = light_type.lamps[name]
            center = view.project(head.on_face(np.array([lamp.center[0]]), np.array([lamp.center[1]])))[0]
            sigma = light_type.lamp_diameter_m / 2 * px_per_m * (1.0 + 1.3 * look.washout)
            color = _lamp_color(lamp.color, look.washout)
            add_glow(canvas, center, max(sigma, 0.8), color, min(strength, 0.9))

    def _face(self, head: SignalHead, light_type: LightType, lit_class: str, look: HeadLook, scale: int) -> ImageArray:
        steps = tuple(round(value * _LEVELS) for value in (look.washout, look.brightness, look.sunlit))
        key = (head.type, lit_class, head.housing, steps, scale)
        if key not in self._faces:
            rounded = HeadLook(*(step / _LEVELS for step in steps))
            face = paint_face(light_type, lit_class, head.housing, rounded, self._lighting, scale)
            if self._bytes + face.nbytes > _CACHE_BYTES:
                self._faces.clear()
                self._bytes = 0
            self._faces[key] = face
            self._bytes += face.nbytes
        return self._faces[key]


def paint_face(
    light_type: LightType, lit_class: str, housing: HousingColor, look: HeadLook, lighting: Lighting, scale: int
) -> ImageArray:
    """Paint the front of a head.

    Args:
        light_type: Size and lamps.
        lit_class: Which of them are lit.
        housing: Paint.
        look: Exposure and sun.
        lighting: The light of the scene.
        scale: Pixels per metre.

    Returns:
        (h, w, 4) BGR multiplied by alpha, and alpha.
    """
    width, height = round(light_type.width_m * scale), round(light_type.height_m * scale)
    color = np.array(lighting.shade(_HOUSING[housing]))
    face = np.empty((height, width, 3), np.float32)
    face[:] = color * np.linspace(1.12, 0.88, height)[:, None, None]
    alpha = np.zeros((height, width), np.float32)
    for left, top, right, bottom in _sections(light_type):
        rows = slice(round(top * height), round(bottom * height))
        columns = slice(round(left * width), round(right * width))
        alpha[rows, columns] = 1
        face[rows.start : rows.start + max(1, scale // 96), columns] *= 0.6  # the joint between two sections
    radius = light_type.lamp_diameter_m / 2 * scale
    lit = light_type.states[lit_class].lit
    for name, lamp in light_type.lamps.items():
        center = np.array([lamp.center[0] * width - 0.5, lamp.center[1] * height - 0.5])
        _paint_lamp(face, center, radius, lamp, look, lighting, lit=name in lit)
    alpha = np.maximum(alpha, 0)[..., None]
    return np.concatenate([np.clip(face, 0, 255) * alpha, 255 * alpha], axis=2).round().astype(np.uint8)


def _paint_lamp(
    face: FloatArray, center: FloatArray, radius: float, lamp: Lamp, look: HeadLook, lighting: Lighting, *, lit: bool
) -> None:
    shape = (face.shape[0], face.shape[1])
    ambient = lighting.ambient_array
    # The visor's tunnel: black around the lens, thicker above, where it throws its shadow.
    visor = _disc(shape, center - np.array([0.0, 0.06 * radius]), 1.12 * radius)
    lens = _disc(shape, center, 0.95 * radius)
    _blend(face, np.array([16.0, 15.0, 14.0]) * ambient, visor)
    unlit = np.array(_UNLIT[lamp.color])
    if lamp.shape == "ball":
        figure = lens
        sunlit = unlit * 1.2 + 0.45 * np.array(_LIT[lamp.color]) + 18
        _blend(face, (unlit + look.sunlit * (sunlit - unlit)) * ambient, lens)
        shadow = lens * (1 - _disc(shape, center + np.array([0.0, 0.45 * radius]), 1.0 * radius))
        _blend(face, unlit * 0.35 * ambient, shadow * (0.8 - 0.6 * look.sunlit))
    else:
        figure = _arrow(shape, center, radius, lamp.shape)
        dark = np.array([20.0, 20.0, 20.0])
        sunlit = 0.5 * unlit + 70
        _blend(face, (dark + look.sunlit * (sunlit - dark)) * ambient, lens)
        _blend(face, (0.55 * unlit + look.sunlit * (unlit + 40 - 0.55 * unlit)) * ambient, figure)
    if not lit:
        return
    hot = look.washout
    color = np.array(_lamp_color(lamp.color, hot))
    if hot > 0.3:  # over-exposed light spills over the figure's edge, until an arrow looks like a ball
        spill = cv2.GaussianBlur(figure, (0, 0), max(0.3, 0.34 * radius * (hot - 0.3) / 0.7))
        gain = 1 + 1.8 * (hot - 0.3) / 0.7
        figure = np.maximum(figure, np.minimum(1.0, gain * spill))
    elif lamp.shape == "ball":
        color = color * 0.97
    _blend(face, color, figure * look.brightness)
    if lamp.shape == "ball":
        core = cv2.GaussianBlur(_disc(shape, center, 0.5 * radius), (0, 0), max(0.3, 0.3 * radius))
        _blend(face, np.array(_lamp_color(lamp.color, min(1.0, hot + 0.3))), core * look.brightness)
    if hot > 0.45:
        halo = cv2.GaussianBlur(figure, (0, 0), max(0.5, 1.1 * radius * hot))
        strength = np.minimum(1.0, 1.6 * (hot - 0.45) * halo)[..., None]
        face += strength * (color * 0.9 - face * 0.7)


def _sections(light_type: LightType) -> list[tuple[float, float, float, float]]:
    """Left, top, right, bottom (fractions) of the housing's parts: one for each row of lamps, as wide as the row."""
    rows: dict[float, list[float]] = {}
    for lamp in light_type.lamps.values():
        rows.setdefault(lamp.center[1], []).append(lamp.center[0])
    heights = sorted(rows)
    edges = [0.0, *((a + b) / 2 for a, b in pairwise(heights)), 1.0]
    margin = 0.6 * light_type.lamp_diameter_m / light_type.width_m
    sections = []
    for row, top, bottom in zip(heights, edges[:-1], edges[1:], strict=True):
        left, right = min(rows[row]) - margin, max(rows[row]) + margin
        sections.append((max(0.0, left) if left > 0.1 else 0.0, top, right if right < 0.9 else 1.0, bottom))
    return sections


def _disc(shape: tuple[int, int], center: FloatArray, radius: float) -> FloatArray:
    """Coverage of a disc, 0 to 1, smooth over one pixel."""
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    distance = np.hypot(columns - center[0], rows - center[1])
    coverage: FloatArray = np.clip(radius - distance + 0.5, 0, 1).astype(np.float32)
    return coverage


def _arrow(shape: tuple[int, int], center: FloatArray, radius: float, direction: str) -> FloatArray:
    points = _ARROW
    for _ in range(_ARROW_TURNS[direction]):
        points = np.stack([-points[:, 1], points[:, 0]], axis=1)
    mask = np.zeros(shape, np.uint8)
    corners = np.round((points * 0.95 * radius + center) * 16).astype(np.int32)
    cv2.fillPoly(mask, [corners], 255, lineType=cv2.LINE_AA, shift=4)
    return mask.astype(np.float32) / 255


def _blend(face: FloatArray, color: FloatArray, coverage: FloatArray) -> None:
    face += coverage[..., None] * (color.astype(np.float32) - face)


def _lamp_color(color: str, washout: float) -> Bgr:
    if washout < 0.5:
        return _mix(_LIT[color], _WARM[color], 2 * washout)
    return _mix(_WARM[color], _HOT[color], 2 * washout - 1)


def _mix(a: Bgr, b: Bgr, share: float) -> Bgr:
    x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
    return (x, y, z)


def _touches(canvas: ImageArray, points_px: FloatArray) -> bool:
    low, high = points_px.min(axis=0), points_px.max(axis=0)
    return bool((high >= 0).all() and low[0] < canvas.shape[1] and low[1] < canvas.shape[0])
