"""A scene into a picture: far things first, near things over them, and a note of every outline for the truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from autolights.core import FloatArray, ImageArray
from autolights.sim.disturbances import HeadLook
from autolights.sim.furniture import Beam, Sign, Tree
from autolights.sim.ground import Ground
from autolights.sim.heads import HeadPainter, SignalHead
from autolights.sim.lighting import Lighting
from autolights.sim.paste import add_glow
from autolights.sim.sky import paint_sky, paint_skyline
from autolights.sim.solids import Solid
from autolights.sim.town import Town
from autolights.sim.view import View

_SKYLINE_M = 190.0


@dataclass(frozen=True, eq=False)
class Outline:
    """A convex polygon that hides what was painted before it.

    Attributes:
        polygon_px: (n, 2) pixels; may leave the image.
        head_id: The signal head that it belongs to; None for all else.
    """

    polygon_px: FloatArray
    head_id: str | None


@dataclass(frozen=True, eq=False)
class Painting:
    """A painted scene before it meets the sensor.

    Attributes:
        image_bgr: (H, W, 3).
        outlines: In the order of painting.
    """

    image_bgr: ImageArray
    outlines: tuple[Outline, ...]


@dataclass(frozen=True)
class Shown:
    """What a head shows and how it looks."""

    lit_class: str
    look: HeadLook


@dataclass(frozen=True, eq=False)
class Scene:
    """All that one camera can see at one instant.

    Attributes:
        town: What stands still.
        ground: Its picture from above.
        lighting: Light.
        solids: Vehicles and people, placed in the town.
        shown: By head id.
    """

    town: Town
    ground: Ground
    lighting: Lighting
    solids: Sequence[Solid]
    shown: Mapping[str, Shown]


def render(scene: Scene, view: View, painter: HeadPainter) -> Painting:
    """Paint a scene as a camera sees it."""
    width, height = view.camera.size_wh
    canvas: ImageArray = np.empty((height, width, 3), np.uint8)
    town, lighting = scene.town, scene.lighting
    paint_sky(canvas, view, lighting, sun_azimuth=town.sun_azimuth, clouds=town.clouds)
    scene.ground.paint(canvas, view, lighting)
    paint_skyline(canvas, view, lighting, end_m=_SKYLINE_M, style=town.skyline)
    eye = view.position
    for building in sorted(town.buildings, key=lambda block: -block.end_m):
        if building.end_m > eye[0] + 2:
            building.paint(canvas, view, lighting)
    outlines: list[Outline] = []
    for item in _far_to_near(scene, view):
        if isinstance(item, SignalHead):
            shown = scene.shown[item.id]
            polygons = painter.paint(canvas, view, item, shown.lit_class, shown.look)
            outlines += [Outline(polygon, item.id) for polygon in polygons]
        else:
            outlines += [Outline(polygon, None) for polygon in item.paint(canvas, view, lighting)]
    _paint_stray_light(canvas, scene, view)
    return Painting(canvas, tuple(outlines))


def _far_to_near(scene: Scene, view: View) -> list[Solid | Beam | Sign | Tree | SignalHead]:
    town = scene.town
    placed: list[tuple[float, Solid | Beam | Sign | Tree | SignalHead]] = []
    placed += [(view.depth_m(solid.vertices.mean(axis=0)), solid) for solid in scene.solids]
    # By its far end: heads hang before their arm, wherever on it they are.
    placed += [(max(view.depth_m(beam.points[0]), view.depth_m(beam.points[-1])), beam) for beam in town.beams]
    placed += [(view.depth_m(sign.center), sign) for sign in town.signs]
    placed += [(view.depth_m(tree.position), tree) for tree in town.trees]
    placed += [(view.depth_m(head.position), head) for head in town.heads]
    # What is behind us may still reach into the picture (a lorry beside us), what is long behind cannot.
    return [item for depth, item in sorted(placed, key=lambda pair: -pair[0]) if depth > -8]


def _paint_stray_light(canvas: ImageArray, scene: Scene, view: View) -> None:
    """Reflections between lens and sensor: a low sun's veil and ghosts on the line through the image's middle."""
    elevation = scene.lighting.sun_elevation_deg
    if elevation is None:
        return
    azimuth, height = scene.town.sun_azimuth, np.radians(elevation)
    towards = np.array([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)])
    sun_px = view.project((view.position + 1000 * towards)[None])[0]
    if not np.isfinite(sun_px).all():
        return
    middle = np.array(view.camera.size_wh) / 2
    add_glow(canvas, sun_px, 170.0, (190.0, 225.0, 255.0), 0.45)
    for reach, sigma, color in ((-0.45, 16.0, (90.0, 200.0, 120.0)), (-0.8, 28.0, (110.0, 120.0, 230.0))):
        add_glow(canvas, middle + reach * (sun_px - middle), sigma, color, 0.22)
