"""What one camera says about the known lights at one instant: passed from the pipeline to the tracks."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from autolights.core import CameraModel, Detections, FloatArray, IntArray, Pose, SignalSet
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
        cost: (n, m) pixels of each pair, +inf where it is forbidden.
        association: Pairs of rows of `projected` and `detections`.
        positions: (m, 3) metres: each detection localised by its size; NaN for those that are a map light.
        new_lights: Rows of detections that may be lights which nobody knew.
    """

    camera: CameraModel
    pose: Pose
    detections: Detections
    projected: ProjectedLights
    cost: FloatArray
    association: Association
    positions: FloatArray
    new_lights: IntArray

    @property
    def stamp_ns(self) -> int:
        """Of the image."""
        return self.pose.stamp_ns


def explain_observation(
    observation: CameraObservation, light_names: Sequence[str], signals: SignalSet
) -> dict[str, Any]:
    """An observation as JSON-ready values.

    Args:
        observation: One image, held against the known lights.
        light_names: Of all known lights, mapped and unmapped ones.
        signals: The signal description.
    """
    detections = observation.detections
    return {
        "camera": observation.camera.name,
        "stamp_ns": observation.stamp_ns,
        "known_lights": [light_names[row] for row in observation.projected.indices],
        "projected_xyxy": np.round(observation.projected.boxes_xyxy, 1).tolist(),
        "detected_xyxy": np.round(detections.boxes_xyxy, 1).tolist(),
        "classes": [signals.classes[i] for i in detections.class_ids],
        "scores": np.round(detections.scores, 3).tolist(),
        "cost_px": [[round(c, 1) if np.isfinite(c) else None for c in row] for row in observation.cost.tolist()],
        "matches": observation.association.matches.tolist(),
        "new_lights": observation.new_lights.tolist(),
    }
