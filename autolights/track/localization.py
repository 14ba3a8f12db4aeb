"""Where a detected light without a map entry stands: depth from its known size, direction from its box."""

import numpy as np

from autolights.core import CameraModel, FloatArray, Pose, back_project
from autolights.core.transforms import invert_rigid, transform_points


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
    centre_x, centre_y = (boxes_xyxy[:, 0] + boxes_xyxy[:, 2]) / 2, (boxes_xyxy[:, 1] + boxes_xyxy[:, 3]) / 2
    across = np.concatenate([centre_x, centre_x, centre_x])
    down = np.concatenate([centre_y, boxes_xyxy[:, 1], boxes_xyxy[:, 3]])
    # Half a pixel: boxes count from the corner of the top-left pixel, points from its centre.
    centres, tops, bottoms = np.split(back_project(np.stack([across, down], axis=1) - 0.5, camera), 3)

    utm_from_cam = invert_rigid(camera.cam_from_ins @ invert_rigid(pose.utm_from_ins))
    directions = centres @ utm_from_cam[:3, :3].T
    slope = np.abs(directions[:, 2]) / np.hypot(directions[:, 0], directions[:, 1])
    shown_height_m = sizes_m[:, 1] + sizes_m[:, 2] * slope
    depth_m = shown_height_m / (bottoms[:, 1] - tops[:, 1])
    return transform_points(utm_from_cam, centres * depth_m[:, None])


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
    mount = camera.cam_from_ins
    lens = pose.position - pose.utm_from_ins[:3, :3] @ (mount[:3, :3].T @ mount[:3, 3])
    rays = positions - lens
    distances_m = np.sqrt((rays * rays).sum(axis=-1))
    focal_px = float(camera.intrinsics[1, 1])
    along_m = distances_m**2 * np.sqrt(2) * box_sigma_px / (focal_px * heights_m)
    across_m = distances_m * box_sigma_px / (np.sqrt(2) * focal_px)
    # I / across² + (1 / along² − 1 / across²) d dᵀ with the ray's direction d
    scaled = rays / distances_m[..., None] * (1 / along_m**2 - 1 / across_m**2)[..., None]
    outer = scaled[..., :, None] * (rays / distances_m[..., None])[..., None, :]
    return np.asarray(outer + np.eye(3) / np.square(across_m)[..., None, None])
