"""The painted face of a signal head: housing, lenses, visors, and what over-exposure does to lit lamps."""

from itertools import pairwise
from typing import Literal

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray, Lamp, LightType
from autolights.sim.disturbances import HeadLook
from autolights.sim.lighting import Bgr, Lighting

HousingColor = Literal["black", "yellow"]

HOUSING_BGR: dict[HousingColor, Bgr] = {"black": (38.0, 36.0, 34.0), "yellow": (28.0, 158.0, 214.0)}
# BGR of a lamp: unlit lens, lit, over-exposed by half, fully. Red goes over amber towards white, green turns white.
_UNLIT: dict[str, Bgr] = {"red": (30.0, 28.0, 92.0), "yellow": (22.0, 74.0, 104.0), "green": (58.0, 74.0, 26.0)}
_LIT: dict[str, Bgr] = {"red": (62.0, 48.0, 255.0), "yellow": (50.0, 196.0, 255.0), "green": (176.0, 240.0, 64.0)}
_WARM: dict[str, Bgr] = {"red": (78.0, 140.0, 255.0), "yellow": (110.0, 218.0, 255.0), "green": (212.0, 250.0, 160.0)}
_HOT: dict[str, Bgr] = {"red": (172.0, 222.0, 255.0), "yellow": (188.0, 240.0, 255.0), "green": (244.0, 255.0, 236.0)}
# An arrow in a lens of radius 1 that points left: shaft and head.
_ARROW = np.array(
    [[-0.78, 0], [-0.12, -0.66], [-0.12, -0.24], [0.72, -0.24], [0.72, 0.24], [-0.12, 0.24], [-0.12, 0.66]]
)
_ARROW_TURNS = {"left": 0, "straight": 1, "right": 2}


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
    color = np.array(lighting.shade(HOUSING_BGR[housing]))
    face = np.empty((height, width, 3), np.float32)
    face[:] = color * np.linspace(1.12, 0.88, height)[:, None, None]
    alpha = np.zeros((height, width), np.float32)
    for left, top, right, bottom in housing_sections(light_type):
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
    color = np.array(lamp_color(lamp.color, hot))
    if hot > 0.3:  # over-exposed light spills over the figure's edge, until an arrow looks like a ball
        spill = cv2.GaussianBlur(figure, (0, 0), max(0.3, 0.34 * radius * (hot - 0.3) / 0.7))
        gain = 1 + 1.8 * (hot - 0.3) / 0.7
        figure = np.maximum(figure, np.minimum(1.0, gain * spill))
    elif lamp.shape == "ball":
        color = color * 0.97
    _blend(face, color, figure * look.brightness)
    if lamp.shape == "ball":
        core = cv2.GaussianBlur(_disc(shape, center, 0.5 * radius), (0, 0), max(0.3, 0.3 * radius))
        _blend(face, np.array(lamp_color(lamp.color, min(1.0, hot + 0.3))), core * look.brightness)
    if hot > 0.45:
        halo = cv2.GaussianBlur(figure, (0, 0), max(0.5, 1.1 * radius * hot))
        strength = np.minimum(1.0, 1.6 * (hot - 0.45) * halo)[..., None]
        face += strength * (color * 0.9 - face * 0.7)


def housing_sections(light_type: LightType) -> list[tuple[float, float, float, float]]:
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


def lamp_color(color: str, washout: float) -> Bgr:
    """BGR of a lit lamp; `washout` from 0 (its own colour) to 1 (white)."""
    if washout < 0.5:
        return _mix(_LIT[color], _WARM[color], 2 * washout)
    return _mix(_WARM[color], _HOT[color], 2 * washout - 1)


def _mix(a: Bgr, b: Bgr, share: float) -> Bgr:
    x, y, z = (p + share * (q - p) for p, q in zip(a, b, strict=True))
    return (x, y, z)
