"""What one camera says about the known lights at one instant: passed from the pipeline to the tracks."""

from dataclasses import dataclass
from typing import NamedTuple

from autolights.core import CameraModel, Detections, FloatArray, IntArray, Pose
from autolights.track.association import Association
from autolights.track.projection import ProjectedLights


@dataclass(frozen=True, eq=False)
class CameraObservation:
    """One image, held against the known lights.

    Attributes:
        camera: The camera.
        pose: The vehicle's at the image's stamp.
        detections: m detections that take part.
        projected: n known lights; rows of the map come first, then those of `TrackManager.unmapped`.
        association: Pairs of rows of `projected` and `detections`.
        positions: (m, 3) metres: each detection localised by its size; NaN for those that are a map light.
        new_lights: Rows of detections that may be lights which nobody knew.
        cost: (n, m) pixels behind the pairs, +inf where a pair is forbidden.
    """

    camera: CameraModel
    pose: Pose
    detections: Detections
    projected: ProjectedLights
    association: Association
    positions: FloatArray
    new_lights: IntArray
    cost: FloatArray

    @property
    def stamp_ns(self) -> int:
        """Of the image."""
        return self.pose.stamp_ns


class Sighting(NamedTuple):
    """One detection in a track's memory, unfiltered (the paper's O_f).

    Attributes:
        set_ns: Stamp of the set of frames.
        class_id: Most probable class.
        height_px: Of the box.
    """

    set_ns: int
    class_id: int
    height_px: float
