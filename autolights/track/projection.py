"""Where a camera should see the lights that are known: map light + pose → image box (Wu et al. 2023, Sec. III-B)."""

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from autolights.core import BoolArray, CameraModel, FloatArray, IntArray, Pose, TrafficLightMap
from autolights.core.light_box import light_corners, project_corners
from autolights.core.transforms import invert_rigid

NameArray: TypeAlias = npt.NDArray[np.str_]

# A light whose type is still being voted on takes a detection of any type.
ANY_TYPE = ""

# Detectors do see beyond a camera's nominal range. A light out there may be seen, but is not expected.
_RANGE_MARGIN = 2.0


@dataclass(frozen=True, eq=False)
class ProjectedLights:
    """Known lights in one image, a row for each.

    Attributes:
        indices: (n,) rows of the lights that were projected.
        types: (n,) names of types; `ANY_TYPE` matches all.
        boxes_xyxy: (n, 4) pixels, edge coordinates; they may leave the image.
        distances_m: (n,) from the vehicle to the light.
        expected: (n,) whether the whole box lies in the image and the light in the camera's range: only then it counts
            as missed when it is not detected.
    """

    indices: IntArray
    types: NameArray
    boxes_xyxy: FloatArray
    distances_m: FloatArray
    expected: BoolArray

    def __len__(self) -> int:
        return len(self.indices)


def project_lights(
    lights: TrafficLightMap, camera: CameraModel, pose: Pose, *, max_facing_deg: float = 90.0
) -> ProjectedLights:
    """Project the lights that a camera can have in view.

    A light is left out if it is farther away than twice the camera's range, turns its face away, has a corner that
    does not project (behind the camera, outside the lens' valid angle), or if its whole box lies outside the image.

    Args:
        lights: Known lights.
        camera: The camera.
        pose: The vehicle's at the image's own stamp.
        max_facing_deg: Largest angle, seen from above, between the way the face looks and the way to the vehicle.

    Returns:
        The projected lights in ascending order of their rows.
    """
    near = lights.within(pose.position, _RANGE_MARGIN * camera.max_range_m)
    to_vehicle = pose.position - lights.positions[near]
    corners, faces = _housings(lights)
    towards = (faces[near] * to_vehicle[:, :2]).sum(axis=1)
    facing = towards >= np.cos(np.radians(max_facing_deg)) * np.hypot(to_vehicle[:, 0], to_vehicle[:, 1])
    near, to_vehicle = near[facing], to_vehicle[facing]

    # T_cam_utm(t) = T_cam_ins · T_utm_ins(t)⁻¹
    cam_from_utm = camera.cam_from_ins @ invert_rigid(pose.utm_from_ins)
    boxes_xyxy = project_corners(corners[near], camera, cam_from_utm)

    lows, highs = boxes_xyxy[:, :2], boxes_xyxy[:, 2:]
    overlaps = np.all((highs > 0) & (lows < camera.size_wh), axis=1)  # NaN compares false: a bad corner drops the light
    contained = np.all((lows >= 0) & (highs <= camera.size_wh), axis=1)[overlaps]
    indices, distances_m = near[overlaps], np.linalg.norm(to_vehicle[overlaps], axis=1)
    return ProjectedLights(
        indices=indices,
        types=np.array([lights.types[i] for i in indices], dtype=np.str_),
        boxes_xyxy=boxes_xyxy[overlaps],
        distances_m=distances_m,
        expected=contained & (distances_m <= camera.max_range_m),
    )


@lru_cache(maxsize=8)
def _housings(lights: TrafficLightMap) -> tuple[FloatArray, FloatArray]:
    """Corners (n, 8, 3) and faces (n, 2), east and north, of a whole map: lights stand still, so once is enough."""
    heading = np.radians(lights.headings_deg)
    corners = light_corners(lights.positions, lights.headings_deg, lights.sizes_m)
    return corners, np.stack([np.sin(heading), np.cos(heading)], axis=1)


def join_projected(first: ProjectedLights, second: ProjectedLights, *, row_offset: int) -> ProjectedLights:
    """Two groups of lights as one; the rows of the second count from `row_offset`."""
    return ProjectedLights(
        indices=np.concatenate([first.indices, second.indices + row_offset]),
        types=np.concatenate([first.types, second.types]),
        boxes_xyxy=np.concatenate([first.boxes_xyxy, second.boxes_xyxy]),
        distances_m=np.concatenate([first.distances_m, second.distances_m]),
        expected=np.concatenate([first.expected, second.expected]),
    )
