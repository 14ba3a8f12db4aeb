"""The sky above the town and the skyline that closes its road."""

from functools import lru_cache

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray
from autolights.sim.lighting import Lighting
from autolights.sim.view import View


def paint_sky(canvas: ImageArray, view: View, lighting: Lighting, *, sun_azimuth: float, clouds: int) -> None:
    """Fill the whole canvas with sky: a gradient, clouds and perhaps a low sun.

    Args:
        canvas: Painted on.
        view: Camera and pose.
        lighting: Colours.
        sun_azimuth: Radians from the town's x axis.
        clouds: Which of the cloud pictures.
    """
    rays = view.rays()[::2, ::2]
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
def _clouds(style: int) -> FloatArray:
    """(256, 2048) share of cloud, 0 to 1."""
    rng = np.random.default_rng(5_000 + style)
    total = np.zeros((256, 2048), np.float32)
    for size, weight in ((4, 0.5), (8, 0.3), (24, 0.15), (64, 0.08)):
        noise = rng.uniform(0, 1, (size, size * 6)).astype(np.float32)
        total += weight * cv2.resize(noise, (2048, 256), interpolation=cv2.INTER_CUBIC)
    cover: FloatArray = np.clip((total - 0.5) * 2.8, 0, 0.85).astype(np.float32)
    return cover
