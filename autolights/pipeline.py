"""One set of frames, end to end: images and poses in, located and tracked lights out. The file to read first.

::

    frames ──detector──► detections ─┐
    poses ──at each image's stamp──► known lights projected ──► association ──► tracks ──► estimates
                                     └► leftovers localised by their size ───────┘
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol, Self, cast

import numpy as np
from pydantic import Field

from autolights.core import (
    Bundle,
    CameraFrame,
    CameraModel,
    Config,
    Detections,
    HmmParameters,
    ImageArray,
    LightEstimate,
    Pose,
    PoseBuffer,
    SignalSet,
    TrafficLightMap,
)
from autolights.core.boxes import area
from autolights.core.errors import DataError, MapError, PoseError, UsageError
from autolights.core.estimates import Variant
from autolights.infer import Detector, Region
from autolights.track import (
    AlignmentConfig,
    CameraHealth,
    DuplicateConfig,
    Duplicates,
    MatchConfig,
    MemorylessLights,
    Observer,
    PlaceBook,
    PlaceConfig,
    RegionConfig,
    Relevance,
    RelevanceConfig,
    SetObservation,
    TrackConfig,
    TrackManager,
    View,
    explain_observation,
    region_of_interest,
)

NO_POSE, LATE = "no pose", "earlier than the set before"
_POSE_HISTORY_S = 5.0  # nothing comes later than that: if it does, the clock was set back


class PipelineConfig(Config):
    """Settings of the runtime (``configs/runtime``).

    Attributes:
        variant: ``od``: each detection for itself; ``fusion``: each image associated with the map, no memory; ``full``:
            with tracks. The paper's ablation.
        fusion_score_threshold: Detections below it take no part in fusion and tracking.
        new_light_score_threshold: Detections below it are no evidence of a light that the map does not hold.
        max_distance_px: Farther from its projection than this no detection is a known light; also the price of leaving
            a light and a detection unmatched together.
        max_distance_heights: The same in heights of the projected box; null for no such limit.
        misread_distance_heights: A detection that nobody matched, but whose centre is this close to a known light, is
            that light misread, not a new one; 0 lets it start a track.
        alignment: What is known of the errors of calibration, pose and map; of it come the common
            shift of each camera's lights and the gate around each. null takes all as they are (the paper).
        places: What is known of the errors of places before anything is seen; of it come positions that the images
            have refined, with their covariance. null leaves map lights where the map has them (the paper).
        track: Birth, death and memory.
        duplicates: When two tracks are taken for one light; null keeps them, and so does places: null.
        relevance: Which lights belong to one intersection and govern the vehicle's approach; null tells nothing of
            that and leaves estimates in the order of track ids.
        regions: By camera, which part of its images the detector looks at; of cameras that are not named, all.
    """

    variant: Variant = "full"
    fusion_score_threshold: float = Field(default=0.25, ge=0, lt=1)
    new_light_score_threshold: float = Field(default=0.5, ge=0, lt=1)
    max_distance_px: float = Field(default=80.0, gt=0)
    max_distance_heights: float | None = Field(default=1.0, gt=0)
    misread_distance_heights: float = Field(default=0.75, ge=0)
    alignment: AlignmentConfig | None = AlignmentConfig()
    places: PlaceConfig | None = PlaceConfig()
    track: TrackConfig = TrackConfig()
    duplicates: DuplicateConfig | None = DuplicateConfig()
    relevance: RelevanceConfig | None = RelevanceConfig()
    regions: dict[str, RegionConfig] = Field(default_factory=dict)


class ImageDetector(Protocol):
    """Anything that finds lights in images: the shipped one, a recorded one, a user's own."""

    def batch(self, images_bgr: Sequence[ImageArray]) -> list[Detections]:
        """Detections in each (H, W, 3) image, in pixels of that image; boxes without area are dropped."""
        ...


class RegionDetector(Protocol):
    """A detector that can be told where to look."""

    def batch(self, images_bgr: Sequence[ImageArray], regions: Sequence[Region | None]) -> list[Detections]:
        """See `ImageDetector`; of each image the region in which lights can be, None for all of it."""
        ...


class Stamped(Protocol):
    """Says which camera took an image, and when."""

    @property
    def camera(self) -> str:
        """Name of the camera."""
        ...

    @property
    def stamp_ns(self) -> int:
        """Of the exposure, nanoseconds."""
        ...


class LightPipeline:
    """The runtime of one vehicle: feed it poses and sets of frames in the order of time.

    Args:
        detector: Finds lights in images.
        hmm: One hidden Markov model per type of light.
        signals: The signal description.
        cameras: By name.
        lights: The map; its types are those of `signals`.
        config: Settings.
        poses: A buffer that is filled already, e.g. with a whole drive. By default an empty one.

    Attributes:
        skipped: How many frames were left out, by reason.
        clock_jumps: How often the clock was set back, after which all tracks began anew.
        last_skip: The latest reason in full; empty if no frame was left out.
        lanes: Names of the map's lanes on which the vehicle is, if you know better; None lets its place tell.

    Raises:
        MapError: If a light has a type that `signals` does not know.
        UsageError: If a region is that of an unknown camera.
    """

    def __init__(
        self,
        detector: ImageDetector,
        hmm: Mapping[str, HmmParameters],
        signals: SignalSet,
        cameras: Mapping[str, CameraModel],
        lights: TrafficLightMap,
        config: PipelineConfig | None = None,
        *,
        poses: PoseBuffer | None = None,
    ) -> None:
        for light_id, light_type in zip(lights.ids, lights.types, strict=True):
            if light_type not in signals.types:
                raise MapError(
                    f"light '{light_id}': unknown type '{light_type}'; "
                    f"the signal description '{signals.name}' has {', '.join(signals.types)}"
                )
        self.config = config or PipelineConfig()
        for name in self.config.regions:
            if name not in cameras:
                raise UsageError(f"regions: unknown camera '{name}'; calibrated are: {', '.join(cameras)}")
        self.skipped: Counter[str] = Counter()
        self.last_skip = ""
        self.clock_jumps = 0
        self.lanes: Sequence[str] | None = None
        self._detector = detector
        self._hmm = hmm
        self._signals = signals
        self._cameras = dict(cameras)
        self._lights = lights
        self._poses = PoseBuffer(history_s=_POSE_HISTORY_S) if poses is None else poses
        self._observer = Observer(lights, signals, cameras, self._match_config(), self.config.alignment)
        places = self.config.places
        self._places = PlaceBook(lights, self._cameras, places) if places else None
        self._duplicates = self._new_duplicates()
        relevance = self.config.relevance
        self._relevance = Relevance(lights, relevance) if relevance else None
        self._tracks = TrackManager(lights, signals, hmm, self.config.track)
        self._memoryless = MemorylessLights(lights, signals)
        self._last_set_ns: int | None = None
        self._detected_sets = 0
        self._behind: tuple[SetObservation, TrafficLightMap] | None = None

    @classmethod
    def from_bundle(
        cls,
        bundle: Bundle,
        cameras: Mapping[str, CameraModel],
        lights: TrafficLightMap,
        config: PipelineConfig | None = None,
        *,
        poses: PoseBuffer | None = None,
        threads: int | None = None,
    ) -> Self:
        """The pipeline of a bundle, with its detector on ONNX Runtime."""
        detector = Detector.from_bundle(bundle, threads=threads, images_at_once=len(cameras))
        return cls(detector, bundle.hmm, bundle.signals, cameras, lights, config, poses=poses)

    def update_pose(self, pose: Pose) -> None:
        """Take in where the vehicle is."""
        self._poses.add(pose)

    def step(self, frames: Sequence[CameraFrame]) -> list[LightEstimate]:
        """Detect, fuse and track the lights in one set of frames.

        Args:
            frames: Of the cameras that exposed together, in any order; each has its own stamp.

        Returns:
            Estimates at the latest stamp of the set, nearest upcoming intersection first; none if every frame had to be
            left out.

        Raises:
            UsageError: If a frame comes from an unknown camera.
        """
        self._check_cameras(frames)
        if not frames:
            return []
        return self.step_detections(frames, self.detect(frames))

    def detect(self, frames: Sequence[CameraFrame]) -> list[Detections]:
        """Detect lights in one set of frames, where they can be (`PipelineConfig.regions`)."""
        images_bgr = [frame.image_bgr for frame in frames]
        if not self.config.regions:
            return self._detector.batch(images_bgr)
        regions = [self._region(frame) for frame in frames]
        self._detected_sets += 1
        return cast(RegionDetector, self._detector).batch(images_bgr, regions)

    def step_detections(self, frames: Sequence[Stamped], detections: Sequence[Detections]) -> list[LightEstimate]:
        """Do what `step` does after detection: recorded detections can serve several pipelines.

        A frame whose pose is not known, and a set that is older than the one before, are left out and counted in
        `skipped`; one that is older by more than 5 s tells that the clock was set back, and all tracks begin anew.

        Args:
            frames: Camera and stamp of each image.
            detections: Of each image, in the same order.

        Raises:
            UsageError: If a frame comes from an unknown camera, or the detections do not fit the signal description.
        """
        self._check_cameras(frames)
        views = list(self._with_pose(frames, detections))
        if not views:
            return []
        set_ns = max(frame.stamp_ns for frame in frames)
        self._last_set_ns = set_ns
        if self.config.variant == "od":
            return [light for view in views for light in self._memoryless.detected(*view[:3], set_ns)]
        unmapped = self._tracks.unmapped
        observations = self._observer.observe(
            views, unmapped, self._places, localize_all=self.config.variant == "fusion"
        )
        self._behind = observations, unmapped
        if self.config.variant == "fusion":
            return [light for observation in observations for light in self._memoryless.fused(observation, set_ns)]
        if self._places is not None:
            self._places.take_in(observations, unmapped, set_ns)
        estimates = self._tracks.update(observations, set_ns, self._places)
        if len(unmapped) and self._places is not None and self._duplicates is not None:
            self._merge_duplicates(observations, unmapped, self._duplicates, self._places)
        if self._relevance is None:
            return estimates
        return self._relevance.tell(estimates, self._tracks.unmapped, observations.shots.poses[-1], self.lanes)

    def health(self) -> dict[str, CameraHealth]:
        """What each camera's images say of its calibration and stamps; empty without `alignment`."""
        health = self._observer.health()
        return health if self._places is None else self._places.with_delays(health)

    def to_json(self) -> dict[str, Any]:
        """All that is remembered but poses, as JSON-ready values; `restore` goes on from there with equal estimates."""
        return {
            "last_set_ns": self._last_set_ns,
            "detected_sets": self._detected_sets,
            "tracks": self._tracks.to_json(),
            "places": None if self._places is None else self._places.to_json(),
            "duplicates": None if self._duplicates is None else self._duplicates.to_json(),
            "alignments": self._observer.to_json(),
        }

    def restore(self, values: dict[str, Any]) -> None:
        """Go on from where `to_json` left off, in a pipeline of the same map, cameras and settings.

        Raises:
            DataError: If the state is of something else, or is damaged; the pipeline is not to be used then.
        """
        try:
            self._tracks.restore(values["tracks"])
            if (self._places is None) != (values["places"] is None):
                raise DataError("pipeline state: was saved with other settings of places")
            if self._places is not None:
                self._places.restore(values["places"])
            if self._duplicates is not None and values.get("duplicates"):
                self._duplicates.restore(values["duplicates"])
            self._observer.restore(values["alignments"])
            self._last_set_ns, self._detected_sets = values["last_set_ns"], int(values["detected_sets"])
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(f"pipeline state: damaged ({type(error).__name__}: {error}); start without it") from error

    def explain(self) -> dict[str, Any]:
        """What was behind the latest estimates, as JSON-ready values: boxes, costs, pairs, beliefs and lanes."""
        images = []
        if self._behind is not None:
            observations, unmapped = self._behind
            images = [explain_observation(one, self._lights, unmapped, self._signals) for one in observations]
        relevance = None if self._relevance is None else self._relevance.explain()
        return {"images": images, "tracks": self._tracks.explain(), "relevance": relevance}

    def _check_cameras(self, frames: Sequence[Stamped]) -> None:
        for frame in frames:
            if frame.camera not in self._cameras:
                raise UsageError(f"unknown camera '{frame.camera}'; calibrated are: {', '.join(self._cameras)}")

    def _with_pose(self, frames: Sequence[Stamped], detections: Sequence[Detections]) -> Iterator[View]:
        """Each frame with the vehicle's pose at its own stamp, as far as that is known; boxes without area go."""
        behind_ns = 0
        if self._last_set_ns is not None and frames:
            behind_ns = self._last_set_ns - max(frame.stamp_ns for frame in frames)
        if behind_ns > _POSE_HISTORY_S * 1e9:
            self._begin_anew()
        elif behind_ns > 0:
            self._skip(LATE, len(frames), f"the set is {LATE}, of stamp {self._last_set_ns}")
            return
        for frame, found in zip(frames, detections, strict=True):
            if found.class_probs.shape[1] != len(self._signals.classes):
                raise UsageError(
                    f"the detector knows {found.class_probs.shape[1]} classes, "
                    f"the signal description '{self._signals.name}' {len(self._signals.classes)}"
                )
            try:
                pose = self._poses.at(frame.stamp_ns)
            except PoseError as error:
                self._skip(NO_POSE, 1, f"camera '{frame.camera}': {error}")
                continue
            # A box without area has no size to be placed by.
            if np.count_nonzero(found.boxes_xyxy[:, 2:] <= found.boxes_xyxy[:, :2]):
                found = found[area(found.boxes_xyxy) > 0]
            occlusion = frame.occlusion if isinstance(frame, CameraFrame) else None
            yield View(self._cameras[frame.camera], pose, found, occlusion)

    def _begin_anew(self) -> None:
        """The clock was set back: states and shifts belong to another time, places and track ids do not."""
        self.clock_jumps += 1
        self._tracks = TrackManager(
            self._lights, self._signals, self._hmm, self.config.track, last_id=self._tracks.last_id
        )
        self._observer.begin_anew()
        self._duplicates = self._new_duplicates()

    def _merge_duplicates(
        self, observations: SetObservation, unmapped: TrafficLightMap, duplicates: Duplicates, places: PlaceBook
    ) -> None:
        """Make one of tracks that turned out to be one light, from the next set of frames on."""
        duplicates.take_in(observations, unmapped)
        for key, other in duplicates.found(places, observations.shots.vehicle[-1]):
            merged = self._tracks.merge(key, other)
            if merged is not None:
                places.merge(key, other, merged)
                self._tracks.take_over(places)
            for gone in (key, other):
                duplicates.forget(gone)

    def _new_duplicates(self) -> Duplicates | None:
        config = self.config.duplicates
        return Duplicates(self._lights, config) if config and self.config.places else None

    def _match_config(self) -> MatchConfig:
        return MatchConfig(**{name: getattr(self.config, name) for name in MatchConfig._fields})

    def _skip(self, reason: str, count: int, text: str) -> None:
        self.skipped[reason] += count
        self.last_skip = text

    def _region(self, frame: CameraFrame) -> Region | None:
        """Where to look in one frame; everywhere if the vehicle's pose is not known."""
        config = self.config.regions.get(frame.camera)
        if config is None or (config.whole_every and self._detected_sets % config.whole_every == 0):
            return None
        try:
            pose = self._poses.at(frame.stamp_ns)
        except PoseError:
            return None
        camera = self._cameras[frame.camera]
        boxes_xyxy = self._observer.project(camera, pose, self._tracks.unmapped, self._places).boxes_xyxy
        return region_of_interest(config, boxes_xyxy, (frame.image_bgr.shape[1], frame.image_bgr.shape[0]))
