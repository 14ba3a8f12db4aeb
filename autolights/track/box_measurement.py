"""What a detected box says of a housing, two directions and an angular height: measured, expected, and how uncertain.

Unknowns are, of a light, three metres and the logarithm of its size; then the three metres by which all poses are off;
and for each camera three angles and the seconds by which its images were exposed after their stamps.
"""

import numpy as np

from autolights.core import FloatArray, IntArray
from autolights.core.shots import Shots
from autolights.track.place_config import PlaceConfig

LIGHT, POSE, CAMERA = 4, 3, 4  # how many unknowns
_NEAREST_M = 0.1
_EDGE_MIDDLES = np.array([[-1.0, 1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0]])  # of a box's left, right, top and bottom


def measured_boxes(boxes: FloatArray, shots: Shots, images: IntArray) -> FloatArray:
    """(m, 3) x and y of each box's centre on the plane z = 1, and its height there; distortion is taken off.

    Args:
        boxes: (4, m) centres, widths and heights, pixels.
        shots: The images.
        images: (m,) which image each box lies in, ascending.
    """
    centres, halves = boxes[:2] - 0.5, boxes[2:] / 2  # points count from the centre of the top-left pixel
    points_px = centres[:, :, None] + halves[:, :, None] * _EDGE_MIDDLES[:, None]
    x, y = shots.back_project(points_px.reshape(2, -1), images.repeat(4)).reshape(2, -1, 4)
    measured = np.empty((boxes.shape[1], 3))
    measured[:, 0] = (x[:, 0] + x[:, 1]) / 2
    measured[:, 1] = (y[:, 2] + y[:, 3]) / 2
    measured[:, 2] = y[:, 3] - y[:, 2]
    return measured


def expected_boxes(
    rays: FloatArray,
    housings: FloatArray,
    rotations: FloatArray,
    velocities: FloatArray,
    turns: FloatArray,
    firsts: IntArray,
    unknowns: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What `measured_boxes` should give of housings whose errors are known.

    Args:
        rays: (m, 3) metres from the lens to the centre, map frame.
        housings: (m, 8, 3) corners from the centre.
        rotations: (m, 3, 3) map frame to camera frame.
        velocities: (m, 3) metres per second of the lens, map frame.
        turns: (m, 3) radians per second of the camera, about its own axes.
        firsts: (m,) column of the first of the camera's unknowns.
        unknowns: How many there are.

    Returns:
        (m, 3) x and y of the centre and the height on the plane z = 1; (m, 3, unknowns) per unit of the unknowns, the
        depth within a housing left aside; (m,) metres along the camera's axis.
    """
    every = np.arange(len(rays))
    depths_m = np.maximum((rays * rotations[:, 2]).sum(axis=1), _NEAREST_M)
    corners = ((rays[:, None] + housings) @ rotations.swapaxes(1, 2)).transpose(2, 1, 0).copy()  # (3, 8, m)
    outline = corners[:2] / np.maximum(corners[2], _NEAREST_M)
    lows, highs = np.minimum.reduce(outline, axis=1), np.maximum.reduce(outline, axis=1)
    (x, y), height = (lows + highs) / 2, highs[1] - lows[1]
    expected = np.array([x, y, height]).T

    jacobian = np.zeros((len(rays), 3, unknowns))
    scaled = rotations / depths_m[:, None, None]
    jacobian[:, :2, :3] = scaled[:, :2]
    jacobian[..., :3] -= expected[..., None] * scaled[:, 2:]
    jacobian[:, 2, 3] = height
    jacobian[..., LIGHT : LIGHT + POSE] = -jacobian[..., :3]
    # About the axes to the right, down and ahead.
    by_angles = np.array([[-x * y, 1 + x * x, -y], [-1 - y * y, x * y, x], [-height * y, height * x, 0 * x]])
    of_camera = np.empty((len(rays), 3, CAMERA))
    of_camera[..., :3] = by_angles.transpose(2, 0, 1)
    # A little later the lens is farther on, and the world is seen turned the other way.
    ahead = (jacobian[..., LIGHT : LIGHT + POSE] @ velocities[:, :, None])[..., 0]
    of_camera[..., 3] = ahead - (of_camera[..., :3] @ turns[:, :, None])[..., 0]
    columns = firsts[:, None] + np.arange(CAMERA)
    jacobian[every[:, None, None], np.arange(3)[:, None], columns[:, None]] = of_camera
    return expected, jacobian, depths_m


def box_variances(
    heights_px: FloatArray, depths_m: FloatArray, shots: Shots, images: IntArray, config: PlaceConfig
) -> FloatArray:
    """(m, 3) of directions and angular heights: edges of boxes, and the vehicle's wandering.

    Args:
        heights_px: (m,) of the boxes.
        depths_m: (m,) of the lights.
        shots: The images.
        images: (m,) which image each box lies in.
        config: Standard deviations.
    """
    focal_px = shots.optics.focal_px.take(images, axis=1)
    edges = config.box_px**2 + (config.box_share * heights_px) ** 2
    of_edges = edges / (focal_px * focal_px)
    wander = np.radians(config.wander_deg) ** 2 + (config.wander_m / depths_m) ** 2
    variances = np.empty((len(edges), 3))
    variances[:, :2] = (of_edges / 2 + wander).T
    variances[:, 2] = 2 * of_edges[1]
    return variances
