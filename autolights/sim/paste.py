"""Paint onto the picture: polygons with smooth edges, textures in perspective, halos of light."""

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray

_SHIFT = 4  # fractional bits of polygon corners
_SUPERSAMPLING = 3

Color = tuple[float, float, float]


def fill_polygon(canvas: ImageArray, polygon_px: FloatArray, color: Color) -> None:
    """Fill a convex (n, 2) polygon with a BGR colour, edges smooth to a sixteenth of a pixel."""
    corners = np.round(polygon_px * (1 << _SHIFT)).astype(np.int32)
    cv2.fillConvexPoly(canvas, corners, color, lineType=cv2.LINE_AA, shift=_SHIFT)


def paste_texture(canvas: ImageArray, texture: ImageArray, quad_px: FloatArray) -> None:
    """Warp a texture into a quadrilateral, every pixel the average of what it covers.

    The texture should be one to two times as large as its picture; choose its resolution accordingly.

    Args:
        canvas: (H, W, 3) BGR, painted on.
        texture: (h, w, 4) BGR multiplied by alpha, and alpha.
        quad_px: (4, 2) where its corners go: top left, top right, bottom right, bottom left.
    """
    window = _window(canvas, quad_px)
    if window is None:
        return
    x0, y0, x1, y1 = window
    n = _SUPERSAMPLING
    target = ((quad_px - (x0, y0) + 0.5) * n - 0.5).astype(np.float32)
    size = ((x1 - x0) * n, (y1 - y0) * n)
    warp = cv2.getPerspectiveTransform(_corners(texture), target)
    patch = cv2.warpPerspective(texture, warp, size, flags=cv2.INTER_LINEAR)
    patch = cv2.resize(patch, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA).astype(np.float32)
    region = canvas[y0:y1, x0:x1]
    region[:] = np.minimum(region * (1 - patch[..., 3:] / 255) + patch[..., :3], 255)


def paste_opaque(canvas: ImageArray, texture: ImageArray, quad_px: FloatArray) -> None:
    """Warp a (h, w, 3) texture without holes into a quadrilateral; fast, for large surfaces."""
    window = _window(canvas, quad_px)
    if window is None:
        return
    x0, y0, x1, y1 = window
    span = np.ptp(quad_px, axis=0)
    while texture.shape[1] > 2 * span[0] + 4 or texture.shape[0] > 2 * span[1] + 4:
        height, width = texture.shape[:2]
        shrunk = (
            max(2, width // 2) if width > 2 * span[0] + 4 else width,
            max(2, height // 2) if height > 2 * span[1] + 4 else height,
        )
        if shrunk == (width, height):
            break
        texture = np.asarray(cv2.resize(texture, shrunk, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    warp = cv2.getPerspectiveTransform(_corners(texture), (quad_px - (x0, y0)).astype(np.float32))
    patch = cv2.warpPerspective(
        texture, warp, (x1 - x0, y1 - y0), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    mask = np.zeros(patch.shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, np.round((quad_px - (x0, y0)) * (1 << _SHIFT)).astype(np.int32), 255, shift=_SHIFT)
    cv2.copyTo(patch, mask, canvas[y0:y1, x0:x1])


def add_glow(canvas: ImageArray, center_px: FloatArray, sigma_px: float, color: Color, strength: float) -> None:
    """Add a round halo of light: at its centre `strength` times the colour."""
    reach = np.ceil(3 * sigma_px)
    window = _window(canvas, np.array([center_px - reach, center_px + reach]))
    if window is None:
        return
    x0, y0, x1, y1 = window
    across = np.exp(-0.5 * ((np.arange(x0, x1) - center_px[0]) / sigma_px) ** 2)
    down = np.exp(-0.5 * ((np.arange(y0, y1) - center_px[1]) / sigma_px) ** 2)
    halo = (strength * np.outer(down, across)).astype(np.float32)
    region = canvas[y0:y1, x0:x1]
    # Screen blending: light adds up towards white and never beyond.
    light = halo[..., None] * np.asarray(color, np.float32)
    region[:] = np.clip(region + light * (1 - region / 510), 0, 255)


def _corners(texture: ImageArray) -> FloatArray:
    right, bottom = texture.shape[1] - 0.5, texture.shape[0] - 0.5
    return np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]], dtype=np.float32)


def _window(canvas: ImageArray, points_px: FloatArray) -> tuple[int, int, int, int] | None:
    """Left, top, right, bottom of the pixels that the points span, cut to the canvas; None if empty."""
    height, width = canvas.shape[:2]
    low, high = np.floor(points_px.min(axis=0)), np.ceil(points_px.max(axis=0)) + 1
    x0, y0 = max(0, int(low[0])), max(0, int(low[1]))
    x1, y1 = min(width, int(high[0])), min(height, int(high[1]))
    return (x0, y0, x1, y1) if x1 > x0 and y1 > y0 else None
