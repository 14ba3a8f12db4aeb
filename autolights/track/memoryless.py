"""Lights without tracks, the lower rungs of the paper's ablation: detections alone, and detections with the map."""

from collections.abc import Iterator

import numpy as np

from autolights.core import (
    CameraModel,
    CameraView,
    Detections,
    FloatArray,
    LightEstimate,
    Pose,
    SignalSet,
    TrafficLightMap,
)
from autolights.track.localization import localize_boxes
from autolights.track.observation import CameraObservation


class MemorylessLights:
    """Makes each detection of each image an estimate of its own, with a track id that never comes again.

    Args:
        lights: The map.
        signals: The signal description.
    """

    def __init__(self, lights: TrafficLightMap, signals: SignalSet) -> None:
        self._lights = lights
        self._signals = signals
        self._sizes_m = signals.sizes_m(signals.type_of[name] for name in signals.classes)
        self._last_id = 0

    def detected(self, camera: CameraModel, pose: Pose, detections: Detections, set_ns: int) -> Iterator[LightEstimate]:
        """Variant ``od``: what the detector says, placed by the size of its type."""
        positions = localize_boxes(detections.boxes_xyxy, self._sizes_m[detections.class_ids], camera, pose)
        for row, position in enumerate(positions):
            yield self._estimate(camera, pose, detections, row, set_ns, map_id=None, position=position)

    def fused(self, observation: CameraObservation, set_ns: int) -> Iterator[LightEstimate]:
        """Variant ``fusion``: map lights take their place from the map, all others theirs from their size."""
        positions = observation.positions.copy()
        map_ids: list[str | None] = [None] * len(positions)
        for light, row in observation.association.matches.tolist():
            known = int(observation.projected.indices[light])
            map_ids[row], positions[row] = self._lights.ids[known], self._lights.positions[known]
        camera, pose, detections = observation.camera, observation.pose, observation.detections
        for row, (map_id, position) in enumerate(zip(map_ids, positions, strict=True)):
            yield self._estimate(camera, pose, detections, row, set_ns, map_id=map_id, position=position)

    def _estimate(
        self,
        camera: CameraModel,
        pose: Pose,
        detections: Detections,
        row: int,
        set_ns: int,
        *,
        map_id: str | None,
        position: FloatArray,
    ) -> LightEstimate:
        class_name = self._signals.classes[int(detections.class_ids[row])]
        left, top, right, bottom = detections.boxes_xyxy[row].tolist()
        self._last_id += 1
        return LightEstimate(
            stamp_ns=set_ns,
            track_id=self._last_id,
            map_id=map_id,
            type=self._signals.type_of[class_name],
            class_name=class_name,
            probability=float(detections.scores[row]),
            flashing=False,
            withheld=False,
            position=position,
            covariance=None,
            distance_m=float(np.linalg.norm(position - pose.position)),
            last_seen_ns=pose.stamp_ns,
            views=(CameraView(camera.name, pose.stamp_ns, (left, top, right, bottom)),),
        )
