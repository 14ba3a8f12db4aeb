"""The box that a light's housing fills in space, and its outline in an image."""

import numpy as np

from autolights.core.arrays import FloatArray
from autolights.core.camera import CameraModel, project_points
from autolights.core.transforms import transform_points

# Signs of (across, along the way the face looks, up) of the eight corners.
_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


def light_corners(positions: FloatArray, headings_deg: FloatArray, sizes_m: FloatArray) -> FloatArray:
    """Corners of upright housings.

    Args:
        positions: (n, 3) centres: east, north, up in metres.
        headings_deg: (n,) the way the face looks, clockwise from north.
        sizes_m: (n, 3) width, height, depth.

    Returns:
        (n, 8, 3) metres, in the frame of `positions`.
    """
    heading = np.radians(headings_deg)
    sine, cosine, zero = np.sin(heading), np.cos(heading), np.zeros_like(heading)
    face = np.stack([sine, cosine, zero], axis=-1)
    across = np.stack([cosine, -sine, zero], axis=-1)
    up = np.broadcast_to([0.0, 0.0, 1.0], face.shape)
    width, height, depth = (sizes_m[:, i, None] / 2 for i in range(3))
    half_axes = np.stack([across * width, face * depth, up * height], axis=1)  # (n, 3 axes, 3)
    return np.asarray(positions[:, None, :] + np.einsum("ca,nad->ncd", _SIGNS, half_axes))


def project_corners(corners: FloatArray, camera: CameraModel, cam_from_utm: FloatArray) -> FloatArray:
    """Image boxes around projected corners.

    Args:
        corners: (n, 8, 3) metres in the map frame.
        camera: The camera.
        cam_from_utm: (4, 4) map frame to camera frame at the image's stamp.

    Returns:
        (n, 4) xyxy pixels, edge coordinates; NaN where a corner does not project (behind the camera, beyond the
        lens). Boxes may leave the image.
    """
    # Half a pixel: points count from the centre of the top-left pixel, boxes from its corner.
    pixels = project_points(transform_points(cam_from_utm, corners), camera) + 0.5
    return np.concatenate([pixels.min(axis=1, initial=np.inf), pixels.max(axis=1, initial=-np.inf)], axis=-1)
