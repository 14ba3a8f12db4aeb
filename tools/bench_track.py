"""What fusion and tracking cost: two cameras, 20 lights in view of both, detections made beforehand.

Usage: python tools/bench_track.py [--lights 20] [--unmapped 2] [--sets 600] [--config runtime/default]
       python tools/bench_track.py --map-lights 1000000     the same lights in a map of a million; a query of that map
       python tools/bench_track.py --soak 100000            laps of a road with 10 junctions; the memory now and then
"""

import argparse
import gc
import time
from pathlib import Path

import numpy as np

from autolights.core import (
    CameraModel,
    Certainty,
    Detections,
    HmmParameters,
    Pose,
    PoseBuffer,
    SignalSet,
    TrafficLightMap,
    load_config,
    load_signals,
)
from autolights.core.frames import CameraFrame
from autolights.core.light_box import light_corners, project_corners
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, invert_rigid, rigid
from autolights.pipeline import LightPipeline, PipelineConfig

RATE_HZ = 10.0
LIGHTS_PER_KM2 = 100.0  # of a large map
SPEED_MPS, JUNCTIONS, SPACING_M = 12.0, 10, 90.0  # of the soak
IMAGE = np.zeros((1, 1, 3), np.uint8)  # never looked at


class NoDetector:
    """Detections are made before the clock starts."""

    def batch(self, images_bgr: object) -> list[Detections]:
        """Never called."""
        raise AssertionError


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lights", type=int, default=20)
    parser.add_argument("--unmapped", type=int, default=2, help="of the lights, how many the map does not hold")
    parser.add_argument("--sets", type=int, default=600)
    parser.add_argument("--map-lights", type=int, default=0, help="fill the map up to so many lights, far away")
    parser.add_argument("--soak", type=int, default=0, metavar="SETS", help="print the memory over so many sets")
    parser.add_argument("--config", default="runtime/default")
    arguments = parser.parse_args()

    signals = load_signals()
    cameras = {"narrow": make_camera("narrow", 47.3), "wide": make_camera("wide", 85.7)}
    lights = make_lights(arguments.lights, signals)
    known = lights.take(np.arange(arguments.lights - arguments.unmapped))
    if arguments.map_lights:
        known = fill_up(known, arguments.map_lights)
        time_queries(known)
    config = load_config(arguments.config, PipelineConfig)
    if arguments.soak:
        soak(arguments.soak, lights, known, cameras, signals, config)
        return
    poses = [make_pose(i / 50) for i in range(int(50 * arguments.sets / RATE_HZ) + 50)]
    pipeline = LightPipeline(NoDetector(), make_hmm(signals), signals, cameras, known, config, poses=PoseBuffer(poses))
    rng = np.random.default_rng(0)
    times_ms, cpu_ms, reported, in_view = [], [], [], []
    for i in range(arguments.sets):
        frames = expose(cameras, i / RATE_HZ)
        detections = [
            detect(lights, cameras[f.camera], make_pose(f.stamp_ns / 1e9), f.stamp_ns / 1e9, signals, rng)
            for f in frames
        ]
        start_ns, cpu_ns = time.perf_counter_ns(), time.thread_time_ns()
        estimates = pipeline.step_detections(frames, detections)
        times_ms.append((time.perf_counter_ns() - start_ns) / 1e6)
        cpu_ms.append((time.thread_time_ns() - cpu_ns) / 1e6)
        reported.append(len(estimates))
        in_view.append(np.mean([len(found) for found in detections]))

    median_ms, p99_ms = np.median(times_ms), np.percentile(times_ms, 99)
    print(f"{arguments.sets} sets of 2 images, {np.mean(in_view):.1f} detections an image, ", end="")
    print(f"{np.mean(reported):.1f} lights reported")
    print(f"per set:   median {median_ms:.2f} ms, p99 {p99_ms:.2f} ms")
    print(f"per image: median {median_ms / 2:.2f} ms, p99 {p99_ms / 2:.2f} ms")
    print(f"processor: median {np.median(cpu_ms):.2f} ms, p99 {np.percentile(cpu_ms, 99):.2f} ms per set, ", end="")
    print("without the time that other programs took")


def fill_up(lights: TrafficLightMap, count: int) -> TrafficLightMap:
    """The same lights and others, 2 km and more away, as many to the square kilometre as in a town."""
    rng = np.random.default_rng(1)
    more = count - len(lights)
    positions = np.zeros((more, 3))
    positions[:, :2] = 2000 + rng.uniform(0, 1000 * np.sqrt(more / LIGHTS_PER_KM2), (more, 2))
    return TrafficLightMap(
        ids=(*lights.ids, *(f"far-{i}" for i in range(more))),
        types=(*lights.types, *(lights.types[0],) * more),
        positions=np.concatenate([lights.positions, positions]),
        headings_deg=np.concatenate([lights.headings_deg, rng.uniform(0, 360, more)]),
        sizes_m=np.concatenate([lights.sizes_m, np.tile(lights.sizes_m[0], (more, 1))]),
        intersections=(*lights.intersections, *("",) * more),
        groups=(*lights.groups, *("",) * more),
    )


def time_queries(lights: TrafficLightMap, radius_m: float = 150.0) -> None:
    """How long it takes to find the lights around a vehicle, as far as the pipeline looks."""
    rng = np.random.default_rng(2)
    times_us, found = [], []
    for place in lights.positions[rng.integers(len(lights), size=5000)]:
        start_ns = time.perf_counter_ns()
        near = lights.within(place, radius_m)
        times_us.append((time.perf_counter_ns() - start_ns) / 1e3)
        found.append(len(near))
    times_us = times_us[1000:]  # the first builds the tree
    print(f"map of {len(lights)} lights, {np.mean(found):.1f} within {radius_m:.0f} m: ", end="")
    print(f"query median {np.median(times_us):.1f} us, p99 {np.percentile(times_us, 99):.1f} us")


def soak(
    sets: int,
    lights: TrafficLightMap,
    known: TrafficLightMap,
    cameras: dict[str, CameraModel],
    signals: SignalSet,
    config: PipelineConfig,
) -> None:
    """Drive laps along a road of equal junctions, with live poses, and print the memory ten times."""
    along_m = SPACING_M * np.arange(1, JUNCTIONS)
    known = repeat(known, along_m)
    pipeline = LightPipeline(NoDetector(), make_hmm(signals), signals, cameras, known, config)
    rng, reported, times_ms = np.random.default_rng(0), 0, []
    for i in range(sets):
        t = i / RATE_HZ
        for ahead in range(-2, 4):
            pipeline.update_pose(lap_pose(t + ahead / 50))
        frames = expose(cameras, t)
        detections = []
        for frame in frames:
            pose = lap_pose(frame.stamp_ns / 1e9)
            next_m = SPACING_M * np.clip(np.ceil((pose.position[0] - 48) / SPACING_M), 0, JUNCTIONS - 1)
            seen_from = Pose(pose.stamp_ns, pose.position - np.array([next_m, 0, 0]), pose.quaternion_xyzw)
            detections.append(detect(lights, cameras[frame.camera], seen_from, t, signals, rng))
        start_ns = time.perf_counter_ns()
        reported += len(pipeline.step_detections(frames, detections))
        times_ms.append((time.perf_counter_ns() - start_ns) / 1e6)
        if (i + 1) % max(sets // 10, 1) == 0:
            gc.collect()
            print(
                f"{i + 1:8d} sets: {resident_mb():.1f} MB, {len(gc.get_objects())} objects, "
                f"{reported / (i + 1):.1f} lights reported, median {np.median(times_ms):.2f} ms",
                flush=True,
            )
            times_ms = []


def repeat(lights: TrafficLightMap, along_m: np.ndarray) -> TrafficLightMap:
    """The same lights again farther along the road."""
    again = np.array([[east, 0.0, 0.0] for east in along_m])
    times = len(along_m) + 1
    return TrafficLightMap(
        ids=(*lights.ids, *(f"{light_id}-{k + 1}" for k in range(len(along_m)) for light_id in lights.ids)),
        types=lights.types * times,
        positions=np.concatenate([lights.positions, *(lights.positions + offset for offset in again)]),
        headings_deg=np.tile(lights.headings_deg, times),
        sizes_m=np.tile(lights.sizes_m, (times, 1)),
        intersections=tuple(f"{name}-{k}" for k in range(times) for name in lights.intersections),
        groups=lights.groups * times,
    )


def lap_pose(t: float) -> Pose:
    """The vehicle drives along the road, and is set back to its beginning."""
    return Pose(
        round(t * 1e9),
        np.array([(SPEED_MPS * t) % (SPACING_M * JUNCTIONS), 0.0, 1.5]),
        np.array([0.0, 0.0, 0.0, 1.0]),
    )


def resident_mb() -> float:
    """Memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def expose(cameras: dict[str, CameraModel], t: float) -> list[CameraFrame]:
    """One frame of each camera, 4 ms apart."""
    return [CameraFrame(name, round((t + 0.004 * k) * 1e9), IMAGE) for k, name in enumerate(cameras)]


def make_camera(name: str, fov_deg: float) -> CameraModel:
    """A forward camera of 1280 x 800 pixels that sees 64 m far."""
    focal_px = 640 / np.tan(np.radians(fov_deg / 2))
    return CameraModel(
        name=name,
        size_wh=(1280, 800),
        intrinsics=np.array([[focal_px, 0, 639.5], [0, focal_px, 399.5], [0, 0, 1]]),
        distortion=np.array([-0.08, 0.02, 0.0004, -0.0003]),
        cam_from_ins=rigid(CAMERA_AXES_FROM_VEHICLE_AXES, np.zeros(3)),
        max_range_m=64.0,
    )


def make_lights(count: int, signals: SignalSet) -> TrafficLightMap:
    """Lights in two rows across the road, 1.6 m apart, of all types by turns; those of a type show the same phase."""
    types = tuple(list(signals.types)[i % len(signals.types)] for i in range(count))
    across = 1.6 * (np.arange(count) // 2 - count / 4)
    return TrafficLightMap(
        ids=tuple(f"light-{i}" for i in range(count)),
        types=types,
        positions=np.stack([np.full(count, 50.0), across, 5.0 + 3.0 * (np.arange(count) % 2)], axis=1),
        headings_deg=np.full(count, 270.0),
        sizes_m=signals.sizes_m(types),
        intersections=("junction",) * count,
        groups=types,
    )


def make_pose(t: float) -> Pose:
    """The vehicle creeps, so that all lights stay in view."""
    return Pose(round(t * 1e9), np.array([min(0.2 * t, 10.0), 0.0, 1.5]), np.array([0.0, 0.0, 0.0, 1.0]))


def make_hmm(signals: SignalSet) -> dict[str, HmmParameters]:
    """A detector that is right nine times out of ten, with what `autolights fit-hmm` finds about its confidence."""
    hmm = {}
    for name in signals.types:
        states, rates = signals.states_of(name), signals.rates(name)
        k = len(states)
        observation = np.full((k, k), 0.1 / (k - 1)) + np.eye(k) * (0.9 - 0.1 / (k - 1))
        hmm[name] = HmmParameters(
            type=name,
            states=states,
            initial=np.full(k, 1 / k),
            rates=rates,
            nominal_dt_s=1 / RATE_HZ,
            transition=np.eye(k) + rates / RATE_HZ,
            observation=observation,
            evidence=observation.T,
            miss_probs=np.full(k, 0.1),
            counts=observation,
            temperature=0.93,
            certainty=Certainty((0.73, 0.88), (0.03, 0.09, 0.88), (0.67, 0.25, 0.08), 0.6),
            provenance={},
        )
    return hmm


def detect(
    lights: TrafficLightMap, camera: CameraModel, pose: Pose, t: float, signals: SignalSet, rng: np.random.Generator
) -> Detections:
    """The truth with jitter, one in twenty missed, one class in ten wrong; arrow lights flash."""
    corners = light_corners(lights.positions, lights.headings_deg, lights.sizes_m)
    boxes = project_corners(corners, camera, camera.cam_from_ins @ invert_rigid(pose.utm_from_ins))
    inside = (boxes[:, :2] >= 0).all(axis=1) & (boxes[:, 2:] <= camera.size_wh).all(axis=1)  # NaN compares false
    seen = inside & (rng.random(len(lights)) > 0.05)
    class_probs = np.full((len(lights), len(signals.classes)), 0.02)
    for i, light_type in enumerate(lights.types):
        states = signals.states_of(light_type)
        shown = states[0]
        if signals.types[light_type].flashing:
            pair = signals.types[light_type].flashing[0]
            shown = pair.on if t % 1.1 < 0.6 else pair.off
        if rng.random() < 0.1:
            shown = states[int(rng.integers(len(states)))]
        class_probs[i, signals.class_ids[shown]] = 0.85
    boxes = boxes + rng.normal(0, 1, boxes.shape)
    return Detections(boxes[seen], np.full(len(lights), 0.9)[seen], class_probs[seen])


if __name__ == "__main__":
    main()
