"""Where a detected light without a map entry stands: depth from its known size, direction from its box."""

import numpy as np

from autolights.core import CameraModel, FloatArray, Pose, back_project
from autolights.core.transforms import invert_rigid, matrix_from_quaternion, transform_points


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
    position: FloatArray, height_m: float, camera: CameraModel, pose: Pose, *, box_sigma_px: float
) -> FloatArray:
    """How much one localisation says: the inverse of its covariance.

    With edges off by σ px, the height is off by √2 σ and the centre by σ / √2. Depth = f·H / h, so its error grows
    with the square of the distance: z² √2 σ / (f H); across the ray it is z σ / (√2 f).

    Args:
        position: (3,) metres, map frame, as `localize` gave it.
        height_m: Of the housing.
        camera: The camera.
        pose: The vehicle's at the image's stamp.
        box_sigma_px: Standard deviation of a box's edges.

    Returns:
        (3, 3) 1/m², symmetric, positive definite.
    """
    mount = camera.cam_from_ins
    lens = pose.position - matrix_from_quaternion(pose.quaternion_xyzw) @ (mount[:3, :3].T @ mount[:3, 3])
    ray = position - lens
    distance_m = float(np.linalg.norm(ray))
    direction = ray / distance_m
    focal_px = float(camera.intrinsics[1, 1])
    along_m = distance_m**2 * np.sqrt(2) * box_sigma_px / (focal_px * height_m)
    across_m = distance_m * box_sigma_px / (np.sqrt(2) * focal_px)
    outer = np.outer(direction, direction)
    return np.asarray(outer / along_m**2 + (np.eye(3) - outer) / across_m**2)
