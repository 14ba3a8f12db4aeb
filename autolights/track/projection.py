"""Where a camera should see the lights that are known: map light + pose → image box (Wu et al. 2023, Sec. III-B)."""

from dataclasses import dataclass, replace
from typing import Self, TypeAlias

import numpy as np
import numpy.typing as npt

from autolights.core import BoolArray, CameraModel, FloatArray, IntArray, Pose, TrafficLightMap
from autolights.core.light_box import project_visible

NameArray: TypeAlias = npt.NDArray[np.str_]

# A light whose type is still being voted on takes a detection of any type.
ANY_TYPE = ""


@dataclass(frozen=True, eq=False)
class ProjectedLights:
    """Known lights in one image, a row for each.

    Attributes:
        indices: (n,) rows of the lights that were projected.
        types: (n,) names of types; `ANY_TYPE` matches all.
        boxes_xyxy: (n, 4) pixels, edge coordinates; they may leave the image.
        distances_m: (n,) from the vehicle.
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

    def shifted(self, shifts_px: FloatArray) -> Self:
        """The same lights (n, 2) pixels farther right and down."""
        return replace(self, boxes_xyxy=self.boxes_xyxy + np.concatenate([shifts_px, shifts_px], axis=1))


def project_lights(lights: TrafficLightMap, camera: CameraModel, pose: Pose) -> ProjectedLights:
    """Project the lights that a camera can have in view (`core.light_box.project_visible`), in the order of their rows.

    Args:
        lights: Known lights.
        camera: The camera.
        pose: The vehicle's at the image's own stamp.
    """
    indices, boxes_xyxy = project_visible(lights, camera, pose)
    contained = np.all((boxes_xyxy[:, :2] >= 0) & (boxes_xyxy[:, 2:] <= camera.size_wh), axis=1)
    distances_m = np.linalg.norm(pose.position - lights.positions[indices], axis=1)
    return ProjectedLights(
        indices=indices,
        types=np.array([lights.types[i] for i in indices], dtype=np.str_),
        boxes_xyxy=boxes_xyxy,
        distances_m=distances_m,
        expected=contained & (distances_m <= camera.max_range_m),
    )


def join_projected(first: ProjectedLights, second: ProjectedLights, *, row_offset: int) -> ProjectedLights:
    """Two groups of lights as one; the rows of the second count from `row_offset`."""
    return ProjectedLights(
        indices=np.concatenate([first.indices, second.indices + row_offset]),
        types=np.concatenate([first.types, second.types]),
        boxes_xyxy=np.concatenate([first.boxes_xyxy, second.boxes_xyxy]),
        distances_m=np.concatenate([first.distances_m, second.distances_m]),
        expected=np.concatenate([first.expected, second.expected]),
    )
