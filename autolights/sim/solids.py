"""Solids made of flat faces: how they are put together and painted."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray
from autolights.sim.lighting import Bgr, Lighting
from autolights.sim.paste import add_glow, fill_polygon
from autolights.sim.view import View

# Share of the light that a face gets by where it looks: front, back, left, right, top.
_FACE_LIGHT = (0.9, 0.95, 0.78, 0.84, 1.1)
# Corners of a box (x forward, y left, z up): bit 0 front, bit 1 left, bit 2 top; each face anticlockwise from outside.
_BOX_FACES = ((1, 3, 7, 5), (0, 4, 6, 2), (2, 6, 7, 3), (0, 1, 5, 4), (4, 5, 7, 6))


@dataclass(frozen=True)
class Face:
    """A convex polygon of a solid: indices into its vertices, anticlockwise from outside, colour without light."""

    corners: tuple[int, ...]
    color: Bgr
    shines: bool = False


@dataclass(frozen=True, eq=False)
class Solid:
    """Faces that are painted in their order; those that look away are left out.

    Attributes:
        vertices: (n, 3) metres.
        faces: Its surface.
        lamps: Halos by night: the vertex where the lamp is, one before it towards which it shines, its colour.
    """

    vertices: FloatArray
    faces: tuple[Face, ...]
    lamps: tuple[tuple[int, int, Bgr], ...] = ()

    def placed(self, position: FloatArray, yaw: float) -> "Solid":
        """The solid turned by `yaw` radians about the vertical and moved by (3,) `position`."""
        cosine, sine = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
        return Solid(self.vertices @ turn.T + position, self.faces, self.lamps)

    def paint(self, canvas: ImageArray, view: View, lighting: Lighting) -> list[FloatArray]:
        """Paint it.

        Returns:
            Its outline: a list of one (n, 2) convex polygon in pixels, or none if it is not in front of the camera.
        """
        pixels = view.project_inside(self.vertices)
        polygons = []
        for face in self.faces:
            index = list(face.corners)
            polygon = pixels[index] if pixels is not None else view.polygon(self.vertices[index])
            if polygon is None or _signed_area(polygon) >= 0:  # y points down, so what faces us runs clockwise
                continue
            fill_polygon(canvas, polygon, face.color if face.shines else lighting.shade(face.color))
            polygons.append(polygon)
        if not polygons:
            return []
        if pixels is not None and lighting.lamps_on:
            for lamp, before, color in self.lamps:
                depth = view.depth_m(self.vertices[lamp])
                if view.depth_m(self.vertices[before]) < depth:
                    sigma = 0.22 * view.camera.intrinsics[0, 0] / max(depth, 1.0)
                    add_glow(canvas, pixels[lamp], sigma, color, 0.7)
        hull = cv2.convexHull(np.concatenate(polygons).astype(np.float32)).reshape(-1, 2)
        return [hull.astype(np.float64)]


def box(
    low: Sequence[float], high: Sequence[float], color: Bgr, *, top: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> tuple[FloatArray, tuple[Face, ...]]:
    """A box whose top may be smaller than its bottom.

    Args:
        low: Least x, y, z.
        high: Largest x, y, z.
        color: BGR.
        top: By how much the top draws in at the back, the front and both sides, metres.

    Returns:
        (8, 3) vertices and five faces; nobody sees the bottom.
    """
    corners = np.array([[(low, high)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)], dtype=np.float64)
    back, front, sides = top
    corners[4:, 0] += np.where(np.arange(4) & 1, -front, back)
    corners[4:, 1] += np.where(np.arange(4) & 2, -sides, sides)
    faces = []
    for indices, light in zip(_BOX_FACES, _FACE_LIGHT, strict=True):
        b, g, r = color
        faces.append(Face(indices, (b * light, g * light, r * light)))
    return corners, tuple(faces)


def panel(
    x: float, y: tuple[float, float], z: tuple[float, float], color: Bgr, *, front: bool, shines: bool = False
) -> tuple[FloatArray, tuple[Face, ...]]:
    """A rectangle across the x axis that looks forwards or backwards."""
    (y0, y1), (z0, z1) = y, z
    corners = np.array([[x, y0, z0], [x, y1, z0], [x, y1, z1], [x, y0, z1]])
    return corners, (Face((0, 1, 2, 3) if front else (3, 2, 1, 0), color, shines),)


def side_panel(
    y: float, x: tuple[float, float], z: tuple[float, float], color: Bgr, *, left: bool
) -> tuple[FloatArray, tuple[Face, ...]]:
    """A rectangle along the x axis that looks to the left or to the right."""
    (x0, x1), (z0, z1) = x, z
    corners = np.array([[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]])
    return corners, (Face((3, 2, 1, 0) if left else (0, 1, 2, 3), color),)


def join(parts: Sequence[tuple[FloatArray, tuple[Face, ...]]], lamps: Sequence[tuple[FloatArray, Bgr]] = ()) -> Solid:
    """One solid of parts that are painted in their order; `lamps` are (3,) points on its ends that shine at dusk."""
    vertices, faces, start = [], [], 0
    for corners, part_faces in parts:
        faces += [Face(tuple(i + start for i in face.corners), face.color, face.shines) for face in part_faces]
        vertices.append(corners)
        start += len(corners)
    indices = tuple((start + 2 * i, start + 2 * i + 1, color) for i, (_, color) in enumerate(lamps))
    vertices += [np.stack([point, point + np.array([0.1 * np.sign(point[0]), 0.0, 0.0])]) for point, _ in lamps]
    return Solid(np.concatenate(vertices), tuple(faces), indices)


def _signed_area(polygon: FloatArray) -> float:
    x, y = polygon[:, 0], polygon[:, 1]
    return float(x[:-1] @ y[1:] - x[1:] @ y[:-1] + x[-1] * y[0] - x[0] * y[-1]) / 2
