"""What the cameras say about the known lights at one instant: passed from the pipeline to the tracks."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from autolights.core import CameraModel, Detections, FloatArray, IntArray, Pose, SignalSet, TrafficLightMap
from autolights.core.shots import Shots
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
        positions: (m, 3) metres: detections localised by their size; NaN where a light's place is known, and, unless
            all were asked for, where a detection is no known light, and too doubtful or too small to be a new one.
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


@dataclass(frozen=True, eq=False)
class SetObservation:
    """The images of one set of frames, held against the known lights: rows of all images in common columns.

    Iterated over, it gives a `CameraObservation` for each image.

    Attributes:
        shots: s images by their stamps, of equal ones by the cameras' names.
        detections: m detections that take part, image by image.
        seen_in: (m,) which image each lies in.
        projected: n known lights, image by image; of one image rows of the map come first, then those of
            `TrackManager.unmapped`.
        known_in: (n,) which image each lies in.
        cost: (n, m) pixels of each pair, +inf where it is forbidden.
        association: Pairs of rows of `projected` and `detections`.
        positions: (m, 3) metres: detections localised by their size; NaN where a light's place is known, and, unless
            all were asked for, where a detection is no known light, and too doubtful or too small to be a new one.
        new_lights: Rows of detections that may be lights which nobody knew.
    """

    shots: Shots
    detections: Detections
    seen_in: IntArray
    projected: ProjectedLights
    known_in: IntArray
    cost: FloatArray
    association: Association
    positions: FloatArray
    new_lights: IntArray

    @classmethod
    def of(cls, observations: Sequence[CameraObservation]) -> Self:
        """At least one image, in any order."""
        ordered = sorted(observations, key=lambda observation: (observation.stamp_ns, observation.camera.name))
        projected = [observation.projected for observation in ordered]
        seen_counts = [len(observation.detections) for observation in ordered]
        known_counts = [len(one) for one in projected]
        first_seen, first_known = np.cumsum([0, *seen_counts]), np.cumsum([0, *known_counts])
        cost = np.full((first_known[-1], first_seen[-1]), np.inf)
        matches, unmatched_lights, unmatched_detections, new_lights = [], [], [], []
        for observation, known, seen in zip(ordered, first_known.tolist(), first_seen.tolist(), strict=False):
            found, (n, m) = observation.association, observation.cost.shape
            cost[known : known + n, seen : seen + m] = observation.cost
            matches.append(found.matches + np.array([known, seen]))
            unmatched_lights.append(found.unmatched_lights + known)
            unmatched_detections.append(found.unmatched_detections + seen)
            new_lights.append(observation.new_lights + seen)
        names = ("indices", "types", "boxes_xyxy", "distances_m", "expected")
        columns = {name: np.concatenate([getattr(one, name) for one in projected]) for name in names}
        return cls(
            shots=Shots.of([one.camera for one in ordered], [one.pose for one in ordered]),
            detections=Detections.joined([observation.detections for observation in ordered]),
            seen_in=np.arange(len(ordered)).repeat(seen_counts),
            projected=ProjectedLights(**columns),
            known_in=np.arange(len(ordered)).repeat(known_counts),
            cost=cost,
            association=Association(*map(np.concatenate, (matches, unmatched_lights, unmatched_detections))),
            positions=np.concatenate([observation.positions for observation in ordered]),
            new_lights=np.concatenate(new_lights),
        )

    def __len__(self) -> int:
        return len(self.shots)

    def __iter__(self) -> Iterator[CameraObservation]:
        images = range(len(self) + 1)
        known = np.searchsorted(self.known_in, images).tolist()
        seen = np.searchsorted(self.seen_in, images).tolist()
        for i in range(len(self)):
            yield self._image(i, slice(known[i], known[i + 1]), slice(seen[i], seen[i + 1]))

    def _image(self, image: int, known: slice, seen: slice) -> CameraObservation:
        lights, found = self.projected, self.association
        pairs = found.matches[self.known_in[found.matches[:, 0]] == image]
        return CameraObservation(
            camera=self.shots.optics.cameras[image],
            pose=self.shots.poses[image],
            detections=self.detections[seen],
            projected=ProjectedLights(
                lights.indices[known],
                lights.types[known],
                lights.boxes_xyxy[known],
                lights.distances_m[known],
                lights.expected[known],
            ),
            cost=self.cost[known, seen],
            association=Association(
                pairs - np.array([known.start, seen.start]),
                _within(found.unmatched_lights, known),
                _within(found.unmatched_detections, seen),
            ),
            positions=self.positions[seen],
            new_lights=_within(self.new_lights, seen),
        )


def _within(rows: IntArray, image: slice) -> IntArray:
    """Those rows that belong to an image, counted from its first."""
    return np.asarray(rows[(rows >= image.start) & (rows < image.stop)] - image.start)


def explain_observation(
    observation: CameraObservation, map_lights: TrafficLightMap, unmapped: TrafficLightMap, signals: SignalSet
) -> dict[str, Any]:
    """An observation as JSON-ready values.

    Args:
        observation: One image, held against the known lights.
        map_lights: The map.
        unmapped: The unmapped lights as the image was held against, track ids for names.
        signals: The signal description.
    """
    detections, on_map = observation.detections, len(map_lights)
    return {
        "camera": observation.camera.name,
        "stamp_ns": observation.stamp_ns,
        "known_lights": [
            map_lights.ids[row] if row < on_map else f"track {unmapped.ids[row - on_map]}"
            for row in observation.projected.indices.tolist()
        ],
        "projected_xyxy": np.round(observation.projected.boxes_xyxy, 1).tolist(),
        "detected_xyxy": np.round(detections.boxes_xyxy, 1).tolist(),
        "classes": [signals.classes[i] for i in detections.class_ids],
        "scores": np.round(detections.scores, 3).tolist(),
        "cost_px": [[round(c, 1) if np.isfinite(c) else None for c in row] for row in observation.cost.tolist()],
        "matches": observation.association.matches.tolist(),
        "new_lights": observation.new_lights.tolist(),
    }
