"""Where a detected light without a map entry stands: depth from its known size, direction from its box."""

import numpy as np

from autolights.core import CameraModel, FloatArray, IntArray, Pose
from autolights.core.boxes import cxcywh_columns
from autolights.core.shots import Shots

_CENTRE_TOP_BOTTOM = np.array([0.0, -0.5, 0.5])  # in heights of a box from its centre
_IDENTITY = np.eye(3)
_SQRT_2 = 2**0.5


def localize(box_xyxy: FloatArray, light_size_m: FloatArray, camera: CameraModel, pose: Pose) -> FloatArray:
    """Position of one light; see `localize_boxes`.

    Args:
        box_xyxy: (4,) pixels, edge coordinates.
        light_size_m: (3,) width, height, depth.
        camera: The camera.
        pose: The vehicle's at the image's stamp.

    Returns:
        (3,) metres, map frame.
    """
    return np.asarray(localize_boxes(np.reshape(box_xyxy, (1, 4)), np.reshape(light_size_m, (1, 3)), camera, pose)[0])


def localize_boxes(boxes_xyxy: FloatArray, sizes_m: FloatArray, camera: CameraModel, pose: Pose) -> FloatArray:
    """Positions of detected lights from their physical height (Wu et al. 2023, Sec. III-B).

    The depth along the camera's axis is f·H / h, with h measured between undistorted points; the centre's ray gives
    the direction. A head is seen from below, so its depth D adds D·|tan(elevation)| to the height H that the box shows
    (5 % of a three-lamp head at 10°).

    Args:
        boxes_xyxy: (n, 4) pixels, edge coordinates, with a height above 0. A box that the image's edge cuts has lost
            its height, and the light will seem too far away.
        sizes_m: (n, 3) width, height, depth of the housings.
        camera: The camera.
        pose: The vehicle's at the image's stamp.

    Returns:
        (n, 3) metres, map frame.
    """
    images = np.zeros(len(boxes_xyxy), dtype=np.int64)
    return localize_in_images(cxcywh_columns(boxes_xyxy), sizes_m, Shots.of([camera], [pose]), images)


def localize_in_images(boxes: FloatArray, sizes_m: FloatArray, shots: Shots, images: IntArray) -> FloatArray:
    """`localize_boxes` for boxes of several images.

    Args:
        boxes: (4, n) centre x, centre y, width, height; pixels.
        sizes_m: (n, 3) width, height, depth of the housings.
        shots: The images.
        images: (n,) which image each box lies in, ascending.

    Returns:
        (n, 3) metres, map frame.
    """
    x, y, _, height_px = boxes
    # Centre, top and bottom. Half a pixel: boxes count from the corner of the top-left pixel, points from its centre.
    points_px = np.empty((2, len(x), 3))
    points_px[0] = x[:, None]
    points_px[1] = y[:, None] + height_px[:, None] * _CENTRE_TOP_BOTTOM
    points_px -= 0.5
    rays = shots.back_project(points_px.reshape(2, -1), images.repeat(3)).reshape(2, -1, 3)
    centres = np.ones((len(x), 1, 3))
    centres[:, 0, :2] = rays[:, :, 0].T
    directions = (centres @ shots.cam_from_utm.take(images, axis=0))[:, 0]  # a rotation's inverse is its transpose
    east, north, up = directions.T
    shown_height_m = sizes_m[:, 1] + sizes_m[:, 2] * (np.abs(up) / np.hypot(east, north))
    depth_m = shown_height_m / (rays[1, :, 2] - rays[1, :, 1])
    return np.asarray(shots.lens.take(images, axis=0) + directions * depth_m[:, None])


def localization_information(
    positions: FloatArray, heights_m: FloatArray | float, camera: CameraModel, pose: Pose, *, box_sigma_px: float
) -> FloatArray:
    """How much localisations say: the inverses of their covariances.

    With edges off by σ px, the height is off by √2 σ and the centre by σ / √2. Depth = f·H / h, so its error grows
    with the square of the distance: z² √2 σ / (f H); across the ray it is z σ / (√2 f).

    Args:
        positions: (..., 3) metres, map frame, as `localize` gave them.
        heights_m: (...) of the housings.
        camera: The camera.
        pose: The vehicle's at the image's stamp.
        box_sigma_px: Standard deviation of a box's edges.

    Returns:
        (..., 3, 3) 1/m², symmetric, positive definite.
    """
    focal_px = float(camera.intrinsics[1, 1])
    rays = positions - Shots.of([camera], [pose]).lens[0]
    return information_along(rays, heights_m, focal_px, box_sigma_px=box_sigma_px)


def information_along(
    rays: FloatArray, heights_m: FloatArray | float, focal_px: FloatArray | float, *, box_sigma_px: float
) -> FloatArray:
    """`localization_information` from (..., 3) metres from the lens, heights in metres and focal lengths in pixels."""
    squares = rays * rays
    distances_m = np.sqrt(squares[..., 0] + squares[..., 1] + squares[..., 2])
    across_m = distances_m * box_sigma_px / (_SQRT_2 * focal_px)
    along_m = distances_m * across_m * 2 / heights_m
    # I / across² + (1 / along² − 1 / across²) d dᵀ with the ray's direction d
    across = 1 / (across_m * across_m)
    directions = rays / distances_m[..., None]
    scaled = directions * (1 / (along_m * along_m) - across)[..., None]
    return np.asarray(scaled[..., :, None] * directions[..., None, :] + _IDENTITY * across[..., None, None])
