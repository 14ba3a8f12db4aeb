"""What the images of a drive say of each light of the map, and of lights that the map does not hold."""

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from scipy.optimize import linear_sum_assignment

from autolights.core import BoolArray, CameraModel, FloatArray, LightEstimate, Pose, SignalSet
from autolights.core.boxes import cxcywh_from_xyxy
from autolights.core.errors import PoseError
from autolights.core.light_box import light_corners, project_corners
from autolights.core.transforms import invert_rigid
from autolights.data import DetectedFrame, Drive, EstimateSet
from autolights.map_audit.config import MapAuditConfig
from autolights.track.misses import in_plain_view
from autolights.track.projection import ProjectedLights, project_lights

_SAME_BOX_PX = 0.02  # estimates.jsonl and detections.jsonl round alike, but for ties
_SHIFT_PAIRS = 3  # an image with fewer known lights borrows its shift from the images before
_SHIFT_MEMORY = 60

Box: TypeAlias = tuple[float, float, float, float]
Image: TypeAlias = tuple[str, int]  # camera, stamp_ns


@dataclass(frozen=True)
class Sighting:
    """One image in which a light was seen, or should have been.

    Attributes:
        drive: Name.
        camera: Name.
        stamp_ns: Of the image.
        box_xyxy: Pixels: the detection's, or where the light should have been.
        distance_m: From the vehicle.
        vehicle: East and north, metres.
        expected: Whether it should be seen there: tall enough, in the camera's range, facing it, within the image.
    """

    drive: str
    camera: str
    stamp_ns: int
    box_xyxy: Box
    distance_m: float
    vehicle: tuple[float, float]
    expected: bool


@dataclass(eq=False)
class Evidence:
    """All that is known of one light.

    Attributes:
        seen: Images in which it was detected, as its own type or as another one.
        missed: Images in which it hung in plain view, tall enough, and was not detected.
        types: How often it was detected as each type.
        residuals_px: Right and down, from where it should be to where it was detected, what all lights of an image
            have in common taken off; of map lights only.
        places: For each drive (3,) metres and (3, 3) m², as the images have refined them.
    """

    seen: list[Sighting] = field(default_factory=list)
    missed: list[Sighting] = field(default_factory=list)
    types: Counter[str] = field(default_factory=Counter)
    residuals_px: list[tuple[float, float]] = field(default_factory=list)
    places: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)

    @property
    def images(self) -> frozenset[tuple[str, str, int]]:
        """Drive, camera and stamp of each image in which it was detected."""
        return frozenset((sighting.drive, sighting.camera, sighting.stamp_ns) for sighting in self.seen)

    @property
    def seen_share(self) -> float:
        """Of the images that say something of it, the share in which it was detected; 0 if there is none."""
        return _share(len(self.seen), len(self.missed))

    @property
    def expected_share(self) -> float:
        """The same of the images in which it should be seen: from farther away it is only seen or not mentioned."""
        return _share(sum(sighting.expected for sighting in self.seen), len(self.missed))

    @property
    def drives(self) -> tuple[str, ...]:
        """Names of the drives that passed it."""
        return tuple(dict.fromkeys(sighting.drive for sighting in (*self.seen, *self.missed)))

    @property
    def way_m(self) -> float:
        """How far apart the places are from which it was looked at."""
        places = np.array([sighting.vehicle for sighting in (*self.seen, *self.missed)]).reshape(-1, 2)
        return float(np.linalg.norm(np.ptp(places, axis=0))) if len(places) else 0.0

    def add(self, other: "Evidence") -> None:
        """Take in what is known of the same light from elsewhere."""
        self.seen += other.seen
        self.missed += other.missed
        self.types += other.types
        self.residuals_px += other.residuals_px
        self.places += other.places


@dataclass(frozen=True, eq=False)
class DriveEvidence:
    """What one drive says.

    Attributes:
        lights: By id of the map.
        tracks: By track id: lights that the map does not hold.
    """

    lights: dict[str, Evidence]
    tracks: dict[int, Evidence]


def gather_evidence(
    drive: Drive,
    sets: Sequence[EstimateSet],
    frames: Sequence[DetectedFrame],
    signals: SignalSet,
    config: MapAuditConfig,
) -> DriveEvidence:
    """Hold each image of a drive against the map, whatever types the lights there have.

    Args:
        drive: With the map that is audited.
        sets: Estimates of variant ``full``.
        frames: Detections of each image.
        signals: The signal description.
        config: Limits.
    """
    told = _Told(sets)
    gatherer = _Gatherer(drive, signals, config)
    poses = drive.pose_buffer()
    for frame in sorted(frames, key=lambda frame: (frame.stamp_ns, frame.camera)):
        key = (frame.camera, frame.stamp_ns)
        if key not in told.images:
            continue  # the runtime left it out
        try:
            pose = poses.at(frame.stamp_ns)
        except PoseError:
            continue
        gatherer.look(frame, pose, told.boxes.get(key, []), told.expected.get(key, []))
    for map_id, place in told.map_places.items():
        gatherer.lights[map_id].places.append(place)
    for track_id, place in told.track_places.items():
        if track_id in gatherer.tracks:
            gatherer.tracks[track_id].places.append(place)
    return DriveEvidence(gatherer.lights, gatherer.tracks)


class _Told:
    """Estimates by image: which box is which light, which unmapped tracks were expected in vain, and last places."""

    def __init__(self, sets: Sequence[EstimateSet]) -> None:
        self.images = {key for entry in sets for key in entry.frames}
        self.boxes: dict[Image, list[tuple[LightEstimate, Box]]] = {}
        self.expected: dict[Image, list[LightEstimate]] = {}
        self.map_places: dict[str, tuple[FloatArray, FloatArray]] = {}
        self.track_places: dict[int, tuple[FloatArray, FloatArray]] = {}
        for entry in sets:
            for light in entry.lights:
                for view in light.views:
                    key = (view.camera, view.stamp_ns)
                    if view.box_xyxy is not None:
                        self.boxes.setdefault(key, []).append((light, view.box_xyxy))
                    elif light.map_id is None:
                        self.expected.setdefault(key, []).append(light)
                if light.covariance is None:
                    continue
                # The last one knows most.
                if light.map_id is None:
                    self.track_places[light.track_id] = light.position, light.covariance
                else:
                    self.map_places[light.map_id] = light.position, light.covariance


class _Gatherer:
    """Goes through the images of one drive."""

    def __init__(self, drive: Drive, signals: SignalSet, config: MapAuditConfig) -> None:
        self.lights = {light_id: Evidence() for light_id in drive.lights.ids}
        self.tracks: dict[int, Evidence] = {}
        self._drive, self._signals, self._config = drive, signals, config
        heading = np.radians(drive.lights.headings_deg)
        self._faces = np.stack([np.sin(heading), np.cos(heading)], axis=1)
        self._row_of_id = {light_id: row for row, light_id in enumerate(drive.lights.ids)}
        self._shifts: dict[str, deque[FloatArray]] = {name: deque(maxlen=_SHIFT_MEMORY) for name in drive.cameras}

    def look(
        self,
        frame: DetectedFrame,
        pose: Pose,
        told: Sequence[tuple[LightEstimate, Box]],
        expected_tracks: Sequence[LightEstimate],
    ) -> None:
        """Take in one image."""
        config, camera = self._config, self._drive.cameras[frame.camera]
        good = frame.scores >= config.min_score
        boxes_xyxy = frame.boxes_xyxy[good]
        types = [self._signals.type_of[name] for name, is_good in zip(frame.classes, good, strict=True) if is_good]
        owners = _owners(told, boxes_xyxy)
        projected = project_lights(self._drive.lights, camera, pose)
        row_of_light = {int(light): row for row, light in enumerate(projected.indices)}

        pairs = {}  # row of `projected` → detection
        for detection, light in owners.items():
            row = None if light.map_id is None else row_of_light.get(self._row_of_id[light.map_id])
            if row is not None:
                pairs[row] = detection
        rows, matched = np.array(list(pairs), dtype=np.int64), np.array(list(pairs.values()), dtype=np.int64)
        shift_px = self._shift(frame.camera, projected.boxes_xyxy[rows], boxes_xyxy[matched])
        expected_xyxy = projected.boxes_xyxy + np.tile(shift_px, 2)
        free = [row for row in range(len(projected)) if row not in pairs]
        others = [d for d in range(len(boxes_xyxy)) if d not in set(pairs.values())]
        pairs |= _nearby(expected_xyxy, free, boxes_xyxy, others, config.same_place_heights)

        middles, found = cxcywh_from_xyxy(expected_xyxy), cxcywh_from_xyxy(boxes_xyxy)
        whole = self._expected(projected, expected_xyxy, camera, pose)
        plain = in_plain_view(expected_xyxy, boxes_xyxy, min_height_px=config.min_height_px)
        ids = self._drive.lights.ids
        for row, detection in pairs.items():
            evidence = self.lights[ids[projected.indices[row]]]
            distance_m, is_whole = float(projected.distances_m[row]), bool(whole[row])
            evidence.seen.append(self._sighting(frame, pose, boxes_xyxy[detection], distance_m, is_whole))
            evidence.types[types[detection]] += 1
            right, down = (found[detection, :2] - middles[row, :2]).tolist()
            evidence.residuals_px.append((right, down))
        for row in np.flatnonzero(whole & plain).tolist():
            if row not in pairs:
                sighting = self._sighting(frame, pose, expected_xyxy[row], float(projected.distances_m[row]), True)
                self.lights[ids[projected.indices[row]]].missed.append(sighting)
        taken = set(pairs.values())
        self._look_at_tracks(frame, pose, camera, boxes_xyxy, types, owners, expected_tracks, taken)

    def _look_at_tracks(
        self,
        frame: DetectedFrame,
        pose: Pose,
        camera: CameraModel,
        boxes_xyxy: FloatArray,
        types: Sequence[str],
        owners: Mapping[int, LightEstimate],
        expected: Sequence[LightEstimate],
        taken: set[int],
    ) -> None:
        """Lights that the map does not hold; a detection that hangs at a light of the map is that light's."""
        for detection, light in owners.items():
            if light.map_id is None and detection not in taken:
                evidence = self.tracks.setdefault(light.track_id, Evidence())
                distance_m = float(np.linalg.norm(light.position - pose.position))
                box_xyxy = boxes_xyxy[detection]
                tall = box_xyxy[3] - box_xyxy[1] >= self._config.min_height_px
                expected_there = bool(tall and distance_m <= camera.max_range_m)
                evidence.seen.append(self._sighting(frame, pose, box_xyxy, distance_m, expected_there))
                evidence.types[types[detection]] += 1
        known = [light for light in expected if light.track_id in self.tracks]
        if not known:
            return
        positions = np.array([light.position for light in known])
        east, north = (pose.position - positions)[:, :2].T
        corners = light_corners(
            positions, np.degrees(np.arctan2(east, north)), self._signals.sizes_m(light.type for light in known)
        )
        wanted_xyxy = project_corners(corners, camera, camera.cam_from_ins @ invert_rigid(pose.utm_from_ins))
        distances_m = np.linalg.norm(positions - pose.position, axis=1)
        plain = in_plain_view(wanted_xyxy, boxes_xyxy, min_height_px=self._config.min_height_px)
        for i in np.flatnonzero(plain & (distances_m <= camera.max_range_m)).tolist():
            sighting = self._sighting(frame, pose, wanted_xyxy[i], float(distances_m[i]), True)
            self.tracks[known[i].track_id].missed.append(sighting)

    def _shift(self, camera: str, expected_xyxy: FloatArray, found_xyxy: FloatArray) -> FloatArray:
        """(2,) pixels by which all lights of an image are off: errors of mounting and pose, no matter of the map."""
        offsets = cxcywh_from_xyxy(found_xyxy)[:, :2] - cxcywh_from_xyxy(expected_xyxy)[:, :2]
        memory = self._shifts[camera]
        if len(offsets) >= _SHIFT_PAIRS:
            shift = np.median(offsets, axis=0)
            memory.append(shift)
            return np.asarray(shift)
        return np.asarray(np.median(memory, axis=0)) if memory else np.zeros(2)

    def _expected(
        self, projected: ProjectedLights, boxes_xyxy: FloatArray, camera: CameraModel, pose: Pose
    ) -> BoolArray:
        """(n,) whether lights of the map should be seen: tall, whole, in range and facing the vehicle."""
        config = self._config
        lows, highs = boxes_xyxy[:, :2], boxes_xyxy[:, 2:]
        to_vehicle = (pose.position - self._drive.lights.positions[projected.indices])[:, :2]
        cosine = (self._faces[projected.indices] * to_vehicle).sum(axis=1) / np.linalg.norm(to_vehicle, axis=1)
        whole = (lows >= 0).all(axis=1) & (highs <= np.array(camera.size_wh)).all(axis=1)
        tall = highs[:, 1] - lows[:, 1] >= config.min_height_px
        near = projected.distances_m <= camera.max_range_m
        return np.asarray(whole & tall & near & (cosine >= np.cos(np.radians(config.facing_deg))))

    def _sighting(
        self, frame: DetectedFrame, pose: Pose, box_xyxy: FloatArray, distance_m: float, expected: bool
    ) -> Sighting:
        left, top, right, bottom = box_xyxy.tolist()
        east, north, _ = pose.position.tolist()
        return Sighting(
            self._drive.name,
            frame.camera,
            frame.stamp_ns,
            (left, top, right, bottom),
            distance_m,
            (east, north),
            expected,
        )


def _share(count: int, others: int) -> float:
    return count / (count + others) if count + others else 0.0


def _owners(told: Sequence[tuple[LightEstimate, Box]], boxes_xyxy: FloatArray) -> dict[int, LightEstimate]:
    """Row of a detection → the light for which the runtime took it."""
    if not told or not len(boxes_xyxy):
        return {}
    wanted = np.array([box for _, box in told])
    apart_px = np.abs(wanted[:, None] - boxes_xyxy[None]).max(axis=2)
    nearest = apart_px.argmin(axis=1)
    return {
        int(detection): told[i][0]
        for i, detection in enumerate(nearest.tolist())
        if apart_px[i, detection] <= _SAME_BOX_PX
    }


def _nearby(
    expected_xyxy: FloatArray, rows: Sequence[int], boxes_xyxy: FloatArray, detections: Sequence[int], heights: float
) -> dict[int, int]:
    """Pairs of lights and detections, of any type, whose centres are at most so many heights apart; the closest."""
    if not rows or not detections:
        return {}
    lights, found = cxcywh_from_xyxy(expected_xyxy[list(rows)]), cxcywh_from_xyxy(boxes_xyxy[list(detections)])
    apart = np.linalg.norm(lights[:, None, :2] - found[None, :, :2], axis=2) / lights[:, None, 3]
    gain = np.minimum(apart - heights, 0.0)
    pairs = zip(*linear_sum_assignment(gain), strict=True)
    return {rows[i]: detections[j] for i, j in pairs if gain[i, j] < 0}
