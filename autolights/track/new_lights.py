"""Which detections that nobody matched may be lights that nobody knew."""

import numpy as np

from autolights.core import BoolArray, CameraModel, FloatArray, Pose
from autolights.core.boxes import cxcywh_from_xyxy
from autolights.track.projection import ProjectedLights

_EDGE_PX = 2.0  # a box that ends this close to the image's edge may be cut by it


def may_be_new(
    boxes_xyxy: FloatArray,
    positions: FloatArray,
    projected: ProjectedLights,
    camera: CameraModel,
    pose: Pose,
    *,
    misread_distance_heights: float,
) -> BoolArray:
    """Sort out what cannot start a track: a cut box, a light beyond the camera's range, a known light misread.

    A box that the image's edge cuts has lost the height from which its distance would follow.

    Args:
        boxes_xyxy: (n, 4) pixels of unmatched detections.
        positions: (n, 3) metres, by their size.
        projected: Known lights in the image.
        camera: The camera.
        pose: The vehicle's at the image's stamp.
        misread_distance_heights: A detection whose centre is closer than this many box heights to a known light is that
            light, taken for another type; 0 lets it pass.

    Returns:
        (n,) whether it may be new.
    """
    lows, highs = boxes_xyxy[:, :2], boxes_xyxy[:, 2:]
    whole = np.all((lows >= _EDGE_PX) & (highs <= np.array(camera.size_wh) - _EDGE_PX), axis=1)
    near = np.linalg.norm(positions - pose.position, axis=1) <= camera.max_range_m
    known = cxcywh_from_xyxy(projected.boxes_xyxy)
    apart_px = np.linalg.norm(known[:, None, :2] - ((lows + highs) / 2)[None, :, :], axis=-1)
    misread = np.any(apart_px < misread_distance_heights * known[:, 3:], axis=0)
    return np.asarray(whole & near & ~misread)
