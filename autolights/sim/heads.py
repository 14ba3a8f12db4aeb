"""Signal heads in the town, and how they get into the picture."""

from dataclasses import dataclass

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray, LightType, SignalSet
from autolights.sim.disturbances import HeadLook
from autolights.sim.faces import HOUSING_BGR, HousingColor, housing_sections, lamp_color, paint_face
from autolights.sim.lighting import Lighting
from autolights.sim.paste import add_glow, fill_polygon, paste_texture
from autolights.sim.view import View

_SCALES_PX_PER_M = (24, 48, 96, 192, 384)
_LEVELS = 8  # looks are rounded to this many steps, so that painted faces can be used again
_CACHE_BYTES = 64 * 1024 * 1024


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
        color = self._lighting.shade(HOUSING_BGR[head.housing], 0.75)
        outlines: list[FloatArray] = []
        for left, top, right, bottom in housing_sections(light_type):
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
            color = lamp_color(lamp.color, look.washout)
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


def _touches(canvas: ImageArray, points_px: FloatArray) -> bool:
    low, high = points_px.min(axis=0), points_px.max(axis=0)
    return bool((high >= 0).all() and low[0] < canvas.shape[1] and low[1] < canvas.shape[0])
