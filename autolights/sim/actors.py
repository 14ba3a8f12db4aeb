"""Who moves in the town: cars, vans, lorries and pedestrians, as solids around their origin on the road."""

from typing import Literal

import numpy as np

from autolights.core import FloatArray
from autolights.sim.lighting import Bgr
from autolights.sim.solids import Face, Solid, box, join, panel, side_panel

VehicleKind = Literal["car", "van", "lorry"]


def _wheel(x: float, y: float, radius: float, *, left: bool) -> tuple[FloatArray, tuple[Face, ...]]:
    """A disc with twelve corners, seen from one side."""
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    corners = np.stack([x + radius * np.cos(turn), np.full(12, y), radius + radius * np.sin(turn)], axis=1)
    order = tuple(range(12))
    return corners, (Face(order[::-1] if left else order, (26.0, 26.0, 26.0)),)


def _tyre(x: float, y: float, radius: float) -> tuple[FloatArray, tuple[Face, ...]]:
    """What is seen of a wheel below the body, from the front and from behind."""
    return box((x - 0.8 * radius, y - 0.12, 0.0), (x + 0.8 * radius, y + 0.12, 1.6 * radius), (30.0, 30.0, 30.0))


def _shadow(half_length: float, half_width: float) -> tuple[FloatArray, tuple[Face, ...]]:
    """The dark patch on the road that ties a vehicle to it."""
    x, y = half_length + 0.1, half_width + 0.15
    corners = np.array([[-x, -y, 0.01], [x, -y, 0.01], [x, y, 0.01], [-x, y, 0.01]])
    return corners, (Face((0, 1, 2, 3), (44.0, 44.0, 44.0)),)


def car(color: Bgr, *, braking: bool) -> Solid:
    """A saloon 4.5 m long; its origin is on the road below its middle."""
    glass = (62.0, 54.0, 48.0)
    rear = (40.0, 36.0, 255.0) if braking else (36.0, 32.0, 140.0)
    axles = [(x, y) for x in (-1.4, 1.4) for y in (-0.75, 0.75)]
    parts = [
        _shadow(2.2, 0.85),
        *(_tyre(x, y, 0.33) for x, y in axles),
        box((-2.1, -0.82, 0.18), (2.1, 0.82, 0.4), (34.0, 34.0, 34.0)),
        box((-2.2, -0.9, 0.3), (2.25, 0.9, 0.95), color, top=(0.06, 0.2, 0.06)),
        box((-1.75, -0.8, 0.94), (1.2, 0.8, 1.45), glass, top=(0.45, 0.7, 0.16)),
        box((-1.25, -0.62, 1.43), (0.45, 0.62, 1.48), color),
        *(_wheel(x, y * 1.21, 0.33, left=y > 0) for x, y in axles),
    ]
    for y0, y1 in ((-0.86, -0.5), (0.5, 0.86)):
        parts.append(panel(-2.21, (y0, y1), (0.66, 0.86), rear, front=False, shines=braking))
        parts.append(panel(2.26, (y0, y1), (0.58, 0.75), (225.0, 235.0, 238.0), front=True))
    parts.append(panel(-2.21, (-0.26, 0.26), (0.52, 0.64), (225.0, 225.0, 225.0), front=False))
    if braking:
        parts.append(panel(-1.62, (-0.25, 0.25), (1.36, 1.41), rear, front=False, shines=True))
    lamps = [(np.array([2.3, y, 0.67]), (220.0, 240.0, 255.0)) for y in (-0.68, 0.68)]
    if braking:
        lamps += [(np.array([-2.3, y, 0.76]), rear) for y in (-0.68, 0.68)]
    return join(parts, lamps)


def lorry(color: Bgr, *, length_m: float, height_m: float, braking: bool) -> Solid:
    """A lorry with a box body, or a van if it is short; its origin is on the road below its middle."""
    half, cab = length_m / 2, min(2.2, 0.35 * length_m)
    glass = (70.0, 60.0, 52.0)
    width = 1.25 if height_m > 3 else 1.0
    rear = (40.0, 36.0, 255.0) if braking else (36.0, 32.0, 140.0)
    cab_color = (color[0] * 0.7, color[1] * 0.75, color[2] * 0.8)
    cab_height = min(0.78 * height_m, 2.9)
    body = box((-half, -width, 0.55), (half - cab, width, height_m), color)
    stripe = (60.0, 70.0, 170.0)
    trim = [
        side_panel(
            s * (width + 0.01), (-half + 0.4, half - cab - 0.4), (0.45 * height_m, 0.6 * height_m), stripe, left=s > 0
        )
        for s in (-1, 1)
    ]
    axles = [(x, y) for x in (-half + 1.1, half - 1.0) for y in (0.25 - width, width - 0.25)]
    cab_corners, cab_faces = box(
        (half - cab, -width * 0.96, 0.45), (half, width * 0.96, cab_height), cab_color, top=(0.0, 0.25, 0.05)
    )
    parts = [
        _shadow(half, width),
        *(_tyre(x, y, 0.48) for x, y in axles),
        box((-half + 0.1, -width + 0.2, 0.35), (half - 0.3, width - 0.2, 0.6), (34.0, 34.0, 34.0)),
        body,
        *trim,
        (cab_corners, cab_faces[:1] + cab_faces[2:]),  # its back stands against the body
        panel(half - 0.1, (-width * 0.8, width * 0.8), (0.55 * cab_height, 0.85 * cab_height), glass, front=True),
        *(_wheel(x, y + 0.3 * np.sign(y), 0.48, left=y > 0) for x, y in axles),
        panel(-half - 0.01, (-0.03, 0.03), (0.7, height_m - 0.1), (60.0, 60.0, 60.0), front=False),
    ]
    for y0, y1 in ((-width + 0.05, -width + 0.4), (width - 0.4, width - 0.05)):
        parts.append(panel(-half - 0.02, (y0, y1), (0.75, 0.95), rear, front=False, shines=braking))
    lamps = [(np.array([half + 0.05, y, 0.8]), (220.0, 240.0, 255.0)) for y in (-0.8, 0.8)]
    return join(parts, lamps)


def vehicle(kind: VehicleKind, color: Bgr, *, braking: bool) -> Solid:
    """A vehicle of ordinary size."""
    if kind == "car":
        return car(color, braking=braking)
    if kind == "van":
        return lorry(color, length_m=5.8, height_m=2.7, braking=braking)
    return lorry(color, length_m=10.5, height_m=4.0, braking=braking)


def pedestrian(coat: Bgr, *, umbrella: Bgr | None) -> Solid:
    """A standing person 1.75 m tall, perhaps under an umbrella; walks along its own x axis."""
    skin, dark = (130.0, 160.0, 205.0), (50.0, 45.0, 45.0)
    parts = [
        box((-0.22, -0.13, 0.0), (-0.02, 0.0, 0.85), dark, top=(0.12, -0.12, 0.0)),
        box((0.04, 0.0, 0.0), (0.24, 0.13, 0.85), dark, top=(-0.12, 0.12, 0.0)),
        box((-0.15, -0.24, 0.8), (0.15, 0.24, 1.5), coat, top=(0.03, 0.03, 0.05)),
        box((-0.11, -0.1, 1.5), (0.11, 0.1, 1.77), skin),
    ]
    if umbrella is not None:
        parts.append(box((-0.02, -0.02, 1.2), (0.02, 0.02, 2.1), dark))
        parts.append(box((-0.62, -0.62, 1.92), (0.62, 0.62, 2.32), umbrella, top=(0.5, 0.5, 0.5)))
    return join(parts)
