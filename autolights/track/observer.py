"""Hold one set of images against the lights that are known: projection, alignment, association, localisation."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from autolights.core import BoolArray, CameraModel, Detections, FloatArray, IntArray, Pose, SignalSet, TrafficLightMap
from autolights.core.boxes import cxcywh_columns
from autolights.core.shots import Shots
from autolights.track.alignment import Alignment, AlignmentConfig, RigAlignment
from autolights.track.association import Association, associate_pairs, pair_costs
from autolights.track.camera_health import CameraHealth
from autolights.track.known_lights import ANY_CODE, KnownLights, Surroundings
from autolights.track.lights_in_images import LightsInImages, project_known
from autolights.track.localization import localize_in_images
from autolights.track.misses import behind_mask
from autolights.track.new_lights import may_be_near, may_be_new
from autolights.track.observation import SetObservation
from autolights.track.place_book import PlaceBook


class View(NamedTuple):
    """One image.

    Attributes:
        camera: The camera.
        pose: The vehicle's at the image's stamp.
        detections: All of them.
        occlusion: See `CameraFrame`.
    """

    camera: CameraModel
    pose: Pose
    detections: Detections
    occlusion: BoolArray | None = None


class MatchConfig(NamedTuple):
    """What makes a detection a known light, or a new one; see `PipelineConfig`."""

    fusion_score_threshold: float
    new_light_score_threshold: float
    max_distance_px: float
    max_distance_heights: float | None
    misread_distance_heights: float


class Observer:
    """Knows the map, the cameras, and how far these are off.

    Args:
        lights: The map.
        signals: The signal description.
        cameras: By name.
        config: Of pairs.
        alignment: Of the common errors of an image; None takes calibration and poses as they are.
    """

    def __init__(
        self,
        lights: TrafficLightMap,
        signals: SignalSet,
        cameras: Mapping[str, CameraModel],
        config: MatchConfig,
        alignment: AlignmentConfig | None,
    ) -> None:
        self._map_length = len(lights)
        self._cameras = dict(cameras)
        self._config = config
        self._alignment_config = alignment
        self._alignment = self._new_alignment()
        type_names = tuple(signals.types)
        range_m = max((camera.max_range_m for camera in cameras.values()), default=1.0)
        self._surroundings = Surroundings(lights, type_names, range_m)
        self._placed: tuple[KnownLights, FloatArray, KnownLights] | None = None
        self._class_types = np.array([type_names.index(signals.type_of[name]) for name in signals.classes])
        self._class_sizes_m = signals.sizes_m(signals.type_of[name] for name in signals.classes)

    def project(
        self, camera: CameraModel, pose: Pose, unmapped: TrafficLightMap, places: PlaceBook | None = None
    ) -> LightsInImages:
        """The known lights in one image, as calibration, pose and the places that images have refined have them."""
        return project_known(self._around(pose.position, unmapped, places), Shots.of([camera], [pose]))

    def observe(
        self,
        views: Sequence[View],
        unmapped: TrafficLightMap,
        places: PlaceBook | None = None,
        *,
        localize_all: bool = False,
    ) -> SetObservation:
        """Hold images against the lights of the map and the unmapped ones.

        Args:
            views: At least one image.
            unmapped: Lights that the map does not hold.
            places: Where lights stand, as far as the images have told: those of the map are looked for there, and
                detections of unmapped ones are not localised again. None takes the map's word.
            localize_all: Localise what is no known light's, even where it is of no use: by far too far away, or of a
                score too low.
        """
        config = self._config
        ordered = sorted(views, key=lambda view: (view.pose.stamp_ns, view.camera.name))
        shots = Shots.of([view.camera for view in ordered], [view.pose for view in ordered])
        detections, seen_in = self._taking_part([view.detections for view in ordered])
        lights = project_known(self._around(ordered[-1].pose.position, unmapped, places), shots)
        known, seen = cxcywh_columns(lights.boxes_xyxy), cxcywh_columns(detections.boxes_xyxy)
        on_map = lights.indices < self._map_length
        pairs = self._may_be_same(lights, detections, seen_in)
        alignment = self._align(shots, lights, known, seen, pairs, on_map)
        gates_px = None
        if alignment is not None and self._alignment_config is not None:
            lights = lights.shifted(alignment.shifts_px.T)
            known[:2] += alignment.shifts_px
            gates_px = self._alignment_config.gate * alignment.sigmas_px
        lights = _but_occluded(lights, ordered)
        costs = pair_costs(
            known,
            seen,
            pairs,
            max_distance_px=config.max_distance_px,
            max_distance_heights=config.max_distance_heights,
            gates_px=gates_px,
        )
        cost = np.full((len(lights), len(detections)), np.inf)
        cost[pairs] = costs
        association = associate_pairs(pairs, costs, cost.shape, unmatched_cost=config.max_distance_px)
        new = self._may_be_near(association.unmatched_detections, seen, detections, seen_in, shots)
        placed = self._placed_lights(lights, on_map, unmapped, places)
        unplaced = _unplaced(placed, association, association.unmatched_detections if localize_all else new, cost.shape)
        positions = np.full((len(detections), 3), np.nan)
        if len(unplaced):
            positions[unplaced] = self._localized(seen, detections, unplaced, seen_in, shots, alignment)
        if len(new):
            may = may_be_new(
                seen[:, new],
                positions[new],
                seen_in[new],
                known,
                lights.images,
                shots,
                misread_distance_heights=config.misread_distance_heights,
            )
            new = new[may]
        return SetObservation(
            shots, detections, seen_in, lights, lights.images, cost, association, positions, new_lights=new
        )

    def begin_anew(self) -> None:
        """Forget the errors of cameras and poses: the clock was set back."""
        self._alignment = self._new_alignment()

    def health(self) -> dict[str, CameraHealth]:
        """What each camera's images say of its calibration; empty without alignment."""
        return {} if self._alignment is None else self._alignment.health()

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, by camera, as JSON-ready values."""
        return {} if self._alignment is None else self._alignment.to_json()

    def restore(self, values: dict[str, Any]) -> None:
        """Go on from where `to_json` left off.

        Raises:
            ValueError: If it is of other cameras, or of other settings of alignment.
        """
        ours = set() if self._alignment is None else set(self._cameras)
        if set(values) != ours:
            raise ValueError(f"alignment was saved of cameras {sorted(values)}, and is of {sorted(ours)} now")
        if self._alignment is not None:
            self._alignment.restore(values)

    def _around(self, position: FloatArray, unmapped: TrafficLightMap, places: PlaceBook | None) -> KnownLights:
        """The known lights around the vehicle where they are to be looked for, made anew when places have changed."""
        known = self._surroundings.around(position, unmapped)
        if places is None:
            return known
        before, told, placed = self._placed or (None, None, known)
        if before is not known or told is not places.places.positions:
            placed = known.looked_for_at(places.offsets_m(known.rows).T)
            self._placed = known, places.places.positions, placed
        return placed

    def _new_alignment(self) -> RigAlignment | None:
        return RigAlignment(self._cameras, self._alignment_config) if self._alignment_config else None

    def _taking_part(self, found: Sequence[Detections]) -> tuple[Detections, IntArray]:
        """Detections whose score suffices, and the image of each."""
        every = Detections.joined(found)
        images = np.arange(len(found)).repeat([len(one) for one in found])
        rows = (every.scores >= self._config.fusion_score_threshold).nonzero()[0]
        return (every, images) if len(rows) == len(every) else (every[rows], images[rows])

    def _may_be_same(
        self, lights: LightsInImages, detections: Detections, seen_in: IntArray
    ) -> tuple[IntArray, IntArray]:
        """(k,) lights and (k,) detections that are of one image, and can be the same by their types."""
        count = len(self._class_types)
        keys = lights.images * count + lights.type_codes
        fits = keys[:, None] == seen_in * count + self._class_types.take(detections.class_ids)
        untyped = (lights.type_codes == ANY_CODE).nonzero()[0]
        if len(untyped):
            fits[untyped] = lights.images.take(untyped)[:, None] == seen_in
        rows, columns = fits.nonzero()
        return rows, columns

    def _align(
        self,
        shots: Shots,
        lights: LightsInImages,
        known: FloatArray,
        seen: FloatArray,
        pairs: tuple[IntArray, IntArray],
        on_map: BoolArray,
    ) -> Alignment | None:
        """The common error of each image; only lights of the map speak for it, the others were placed by it."""
        if self._alignment is None:
            return None
        votes = on_map.take(pairs[0]).nonzero()[0]
        may_vote = pairs[0].take(votes), pairs[1].take(votes)
        return self._alignment.align(shots, known, lights.distances_m, lights.images, seen, may_vote)

    def _placed_lights(
        self, lights: LightsInImages, on_map: BoolArray, unmapped: TrafficLightMap, places: PlaceBook | None
    ) -> BoolArray:
        """(n,) whether the map or the images before tell where a light stands: a single box says less."""
        if places is None or not len(unmapped):
            return on_map
        placed, off_map = on_map.copy(), (~on_map).nonzero()[0]
        placed[off_map] = places.knows(unmapped).take(lights.indices.take(off_map) - self._map_length)
        return placed

    def _may_be_near(
        self, rows: IntArray, seen: FloatArray, detections: Detections, seen_in: IntArray, shots: Shots
    ) -> IntArray:
        """Those of some detections that are sure enough and tall enough to be a light within range."""
        rows = rows[detections.scores.take(rows) >= self._config.new_light_score_threshold]
        heights_m = self._class_sizes_m[:, 1].take(detections.class_ids.take(rows))
        return rows[may_be_near(seen[3].take(rows), heights_m, seen_in.take(rows), shots)]

    def _localized(
        self,
        seen: FloatArray,
        detections: Detections,
        rows: IntArray,
        seen_in: IntArray,
        shots: Shots,
        alignment: Alignment | None,
    ) -> FloatArray:
        """(k, 3) metres: detections by the sizes of their types, with the common error taken off."""
        sizes_m, images = self._class_sizes_m.take(detections.class_ids.take(rows), axis=0), seen_in.take(rows)
        boxes = seen.take(rows, axis=1)
        if alignment is not None:
            boxes[:2] -= alignment.shifts_of_seen(boxes, sizes_m[:, 1], images)
        return localize_in_images(boxes, sizes_m, shots, images)


def _but_occluded(lights: LightsInImages, views: Sequence[View]) -> LightsInImages:
    """The same lights, those that a mask hides not expected."""
    expected = lights.expected
    for image, view in enumerate(views):
        if view.occlusion is not None:
            mine = (lights.images == image).nonzero()[0]
            expected = expected.copy()
            expected[mine] &= ~behind_mask(lights.boxes_xyxy[mine], view.occlusion, view.camera.size_wh)
    return lights if expected is lights.expected else replace(lights, expected=expected)


def _unplaced(placed: BoolArray, association: Association, others: IntArray, shape: tuple[int, ...]) -> IntArray:
    """Rows of the detections of lights whose places are not known, of which (n,) `placed` tells, and of some others."""
    unplaced = np.zeros(shape[1], dtype=bool)
    unplaced[others] = True
    lights, detections = association.matches.T
    unplaced[detections[~placed.take(lights)]] = True
    return unplaced.nonzero()[0]
