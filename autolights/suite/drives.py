"""A scenario's drive: the truth, what the detector model says, and what a runtime is given, with all its errors."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from autolights.core import CameraModel, Detections, FloatArray, IntArray, Pose, SignalSet, load_signals
from autolights.core.errors import UsageError
from autolights.core.transforms import transform_points
from autolights.data import Drive, FrameRecord, TruthFrame, TruthLight
from autolights.sim.detector_model import DetectorModel, LightViews, confusion_rates, perturb_errors
from autolights.sim.rig import build_cameras
from autolights.sim.survey import heading_deg
from autolights.sim.vehicle import measure_poses
from autolights.suite.arrival import arrival, in_time
from autolights.suite.config import ScenarioConfig, SuiteConfig
from autolights.suite.disturb import shift_poses, turn_cameras, wrong_map
from autolights.suite.scene import Scene, build_scene, facing, image_boxes

_START_NS = 1_790_000_000_000_000_000
_EVERY_THIRD = 3
# Independent random streams of a drive.
_SCENE, _DETECTOR, _FRAMES, _POSES, _MAP, _MOUNTING, _CONFUSION = range(7)


@dataclass(frozen=True, eq=False)
class SuiteDrive:
    """One drive, ready for any pipeline.

    Attributes:
        name: Scenario and number.
        scenario: Name.
        signals: The signal description.
        drive: What a runtime is given; it lies nowhere on disk.
        true_drive: The same with the true mounting and the true poses, for scoring.
        truth: By (camera, stamp_ns): of the frames that arrive in time.
        sets: Frames in the order of their arrival.
        detections: By (camera, stamp_ns).
        sources: By (camera, stamp_ns): truth id behind each detection, None for a false alarm.
        map_positions: Surveyed position by map id.
        flash_ends_ns: By truth id: when its flashes ended, in view or not, as far as that is known.
    """

    name: str
    scenario: str
    signals: SignalSet
    drive: Drive
    true_drive: Drive
    truth: dict[tuple[str, int], TruthFrame]
    sets: tuple[tuple[FrameRecord, ...], ...]
    detections: dict[tuple[str, int], Detections]
    sources: dict[tuple[str, int], tuple[str | None, ...]]
    map_positions: dict[str, FloatArray]
    flash_ends_ns: Mapping[str, IntArray] = field(default_factory=dict)


def scenario_drives(suite: SuiteConfig, name: str) -> Iterator[SuiteDrive]:
    """The drives of one scenario.

    Raises:
        UsageError: If the suite has no such scenario.
    """
    if name not in suite.scenarios:
        raise UsageError(f"the suite has no scenario '{name}'; it has {', '.join(suite.scenarios)}")
    for index in range(suite.scenarios[name].drives):
        yield build_drive(suite, name, index)


def build_drive(suite: SuiteConfig, name: str, index: int) -> SuiteDrive:
    """Simulate one drive; depends on the suite's seed, the scenario's name and settings, and the index alone."""
    scenario = suite.scenarios[name]
    signals = load_signals(scenario.signals)
    seed = (suite.seed, *name.encode(), index)
    rng = {stream: np.random.default_rng([*seed, stream]) for stream in range(7)}
    scene = build_scene(scenario, signals, rng[_SCENE])
    cameras = build_cameras(suite.cameras)
    lights, map_ids = wrong_map(scene, scenario.map_errors, rng[_MAP])
    model = _detector_model(suite, scenario, signals, len(scene.heads) + len(scene.lookalikes), (*seed, _DETECTOR))
    sets = arrival(_exposed(suite, scenario, rng[_FRAMES]), scenario, [camera.name for camera in cameras], rng[_FRAMES])

    truth: dict[tuple[str, int], TruthFrame] = {}
    detections: dict[tuple[str, int], Detections] = {}
    sources: dict[tuple[str, int], tuple[str | None, ...]] = {}
    true_poses: list[Pose] = []
    for number, camera in enumerate(cameras):
        frames = sorted((f for s in sets for f in s if f.camera == camera.name), key=lambda frame: frame.stamp_ns)
        times_s = np.array([(frame.stamp_ns - _START_NS) / 1e9 for frame in frames])
        poses = scene.poses(times_s)
        views = _views(scene, camera, times_s, poses, suite.truth_range_m)
        for frame, modelled in zip(frames, model.detect(views, camera=number), strict=True):
            key = (camera.name, frame.stamp_ns)
            detections[key] = modelled.detections
            sources[key] = tuple(
                scene.heads[i].id if 0 <= i < len(scene.heads) else None for i in modelled.sources.tolist()
            )
        for frame, lights_there in zip(frames, _truth_lights(scene, camera, times_s, views, map_ids), strict=True):
            truth[camera.name, frame.stamp_ns] = TruthFrame(frame.stamp_ns, camera.name, lights_there)
        utm_from_ins = scene.utm_from_town @ poses
        quaternions = Rotation.from_matrix(utm_from_ins[:, :3, :3]).as_quat()
        true_poses += [
            Pose(frame.stamp_ns, position, quaternion)
            for frame, position, quaternion in zip(frames, utm_from_ins[:, :3, 3], quaternions, strict=True)
        ]

    asked = in_time(sets)
    measured = measure_poses(scene.motion, scene.utm_from_town, _START_NS, scenario.poses, rng[_POSES])
    lateral = index % _EVERY_THIRD == _EVERY_THIRD - 1
    believed = turn_cameras(cameras, scenario.mounting_error_deg, rng[_MOUNTING], lateral=lateral)
    drive = Drive(
        folder=Path(),
        name=f"{name}-{index + 1}",
        utm_zone=17,
        hemisphere="north",
        height_datum="ellipsoid",
        cameras={camera.name: camera for camera in believed},
        poses=tuple(shift_poses(measured, scenario.pose_error_m, rng[_POSES])),
        lights=lights,
        frames=tuple(frame for frames in sets for frame in frames),
    )
    true_drive = replace(
        drive, cameras={c.name: c for c in cameras}, poses=tuple(sorted(true_poses, key=lambda pose: pose.stamp_ns))
    )
    return SuiteDrive(
        name=drive.name,
        scenario=name,
        signals=signals,
        drive=drive,
        true_drive=true_drive,
        truth={key: frame for key, frame in truth.items() if key in asked},
        sets=sets,
        detections=detections,
        sources=sources,
        map_positions=dict(zip(lights.ids, lights.positions, strict=True)),
        flash_ends_ns={
            head: _START_NS + np.round(ends_s * 1e9).astype(np.int64)
            for head, ends_s in scene.flash_ends_s(scenario.duration_s).items()
        },
    )


def known_rates(suite: SuiteConfig, signals: SignalSet) -> FloatArray:
    """(C, C) confusion on the validation set, of the classes that a signal description knows."""
    table = {
        truth: {seen: rate for seen, rate in errors.items() if seen in signals.class_ids}
        for truth, errors in suite.confusion.items()
        if truth in signals.class_ids
    }
    return confusion_rates(table, signals)


def road_rates(suite: SuiteConfig, signals: SignalSet) -> FloatArray:
    """(C, C) confusion of the detector on the road: that of the validation set, each error a little different."""
    rng = np.random.default_rng([suite.seed, _CONFUSION])
    return perturb_errors(known_rates(suite, signals), suite.confusion_spread, rng)


def _detector_model(
    suite: SuiteConfig, scenario: ScenarioConfig, signals: SignalSet, count: int, seed: tuple[int, ...]
) -> DetectorModel:
    config = type(suite.detector).model_validate(suite.detector.model_dump() | scenario.detector)
    duration_s = scenario.duration_s + 1
    return DetectorModel(signals, road_rates(suite, signals), config, count=count, duration_s=duration_s, seed=seed)


def _views(scene: Scene, camera: CameraModel, times_s: FloatArray, poses: FloatArray, range_m: float) -> LightViews:
    things = (*scene.heads, *scene.lookalikes)
    boxes = image_boxes(np.array([head.corners() for head in things]), camera, poses)
    positions = (poses @ np.append(np.linalg.inv(camera.cam_from_ins)[:3, 3], 1.0))[:, :3]
    boxes[~facing(things, positions)] = np.nan
    lows, highs = boxes[..., :2], boxes[..., 2:]
    outside = ~((highs > 0) & (lows < np.array(camera.size_wh))).all(axis=-1)  # NaN compares false
    places = np.array([head.position for head in things])
    beyond = np.linalg.norm(poses[:, None, :3, 3] - places, axis=-1) > range_m
    boxes[outside | beyond] = np.nan
    lit, _, _ = scene.shown(times_s)
    others = np.broadcast_to(scene.lookalike_classes, (len(times_s), len(scene.lookalikes)))
    hidden = np.pad(scene.occlusions.hidden(times_s), ((0, 0), (0, len(scene.lookalikes))))
    return LightViews(
        times_s=times_s,
        size_wh=camera.size_wh,
        boxes_xyxy=boxes,
        class_ids=np.concatenate([lit, others], axis=1),
        hidden=hidden,
        is_light=np.arange(len(things)) < len(scene.heads),
    )


def _truth_lights(
    scene: Scene,
    camera: CameraModel,
    times_s: FloatArray,
    views: LightViews,
    map_ids: dict[str, str | None],
) -> Iterator[tuple[TruthLight, ...]]:
    classes, heads = scene.signals.classes, scene.heads
    lit, reported, flashing = scene.shown(times_s)
    places = np.array([head.position for head in heads])
    utm = transform_points(scene.utm_from_town, places)
    headings = [heading_deg(head, scene.utm_from_town) for head in heads]
    boxes = views.boxes_xyxy[:, : len(heads)]
    width, height = camera.size_wh
    cut = (boxes[..., :2] < 0).any(axis=-1) | (boxes[..., 2] > width) | (boxes[..., 3] > height)
    there = np.asarray(np.isfinite(boxes).all(axis=-1))
    for t in range(len(times_s)):
        yield tuple(
            TruthLight(
                truth_id=heads[i].id,
                map_id=map_ids[heads[i].id],
                type=heads[i].type,
                class_name=classes[reported[t, i]],
                lit_class=classes[lit[t, i]],
                flashing=bool(flashing[t, i]),
                box_xyxy=tuple(boxes[t, i].tolist()),
                occlusion=float(views.hidden[t, i]),
                truncated=bool(cut[t, i]),
                position=utm[i],
                heading_deg=headings[i],
            )
            for i in np.flatnonzero(there[t]).tolist()
        )


def _exposed(suite: SuiteConfig, scenario: ScenarioConfig, rng: np.random.Generator) -> list[list[FrameRecord]]:
    """Sets of frames with each image's own stamp."""
    sets = []
    for number in range(round(scenario.duration_s * scenario.frame_rate_hz)):
        frames = []
        for camera in suite.cameras:
            delay_s = (camera.stamp_offset_ms + float(rng.normal(0, suite.stamp_jitter_ms))) / 1e3
            stamp_ns = _START_NS + round((number / scenario.frame_rate_hz + delay_s) * 1e9)
            frames.append(FrameRecord(stamp_ns, camera.name, Path()))
        sets.append(frames)
    return sets
