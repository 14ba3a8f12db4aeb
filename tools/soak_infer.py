"""Run a pipeline of two cameras for thousands of frames and watch its memory: it must be small and stay flat.

    python tools/soak_infer.py runs/demo/bundle --frames 10000

Two cameras of 1920 x 1200 px pass 200 lights of a map, one after the other. The detector runs on each of their images;
as there is nothing to see in them, the lights that it should have found are added to what it says, so that tracks are
born and die all the time. The process holds nothing but the runtime and four images.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from autolights.core import Bundle, CameraFrame, CameraModel, Detections, FloatArray, ImageArray, Pose, TrafficLightMap
from autolights.core.progress import track
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, rigid
from autolights.infer import Detector, Region
from autolights.pipeline import LightPipeline, PipelineConfig
from autolights.track import RegionConfig, project_lights

IMAGE_WH = (1920, 1200)
LIGHTS, SPACING_M, SPEED_MPS, RATE_HZ = 200, 40.0, 12.0, 15.0
LIMIT_MB, GROWTH_MB = 400.0, 4.0


def resident_mb() -> tuple[float, float]:
    """Anonymous and all resident memory, MB."""
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(lines["RssAnon"].split()[0]) / 1024, int(lines["VmRSS"].split()[0]) / 1024


def camera(name: str, focal_px: float) -> CameraModel:
    """A camera above the vehicle's nose that looks ahead."""
    intrinsics = np.array([[focal_px, 0, IMAGE_WH[0] / 2], [0, focal_px, IMAGE_WH[1] / 2], [0, 0, 1]])
    cam_from_ins = rigid(CAMERA_AXES_FROM_VEHICLE_AXES, CAMERA_AXES_FROM_VEHICLE_AXES @ np.array([-1.0, 0.0, -1.5]))
    return CameraModel(name, IMAGE_WH, intrinsics, np.zeros(4), cam_from_ins, 64.0)


def along_a_road(bundle: Bundle) -> TrafficLightMap:
    """Lights of all types over a road that leads east."""
    types = tuple(list(bundle.signals.types)[i % len(bundle.signals.types)] for i in range(LIGHTS))
    places = np.arange(LIGHTS, dtype=np.float64)
    positions = np.column_stack([SPACING_M * (places + 1), 6 * (places % 3 - 1), np.full(LIGHTS, 5.0)])
    return TrafficLightMap(
        tuple(f"light-{i}" for i in range(LIGHTS)),
        types,
        positions,
        np.full(LIGHTS, 270.0),
        bundle.signals.sizes_m(types),
    )


def images() -> list[ImageArray]:
    """Two of each camera, so that no two sets in a row are the same."""
    random = np.random.default_rng(0)
    small = random.integers(0, 256, (4, IMAGE_WH[1] // 16, IMAGE_WH[0] // 16, 3), dtype=np.uint8)
    return [np.asarray(cv2.resize(each, IMAGE_WH, interpolation=cv2.INTER_CUBIC), dtype=np.uint8) for each in small]


def place(stamp_ns: int) -> FloatArray:
    """Where the vehicle is: to the end of the road, and from its beginning again."""
    return np.array([SPEED_MPS * stamp_ns / 1e9 % (SPACING_M * LIGHTS), 0.0, 0.0])


class Seeing:
    """The bundle's detector, and beside what it finds the map's lights where they stand in the images."""

    def __init__(self, detector: Detector, lights: TrafficLightMap, cameras: dict[str, CameraModel]) -> None:
        self.pose = Pose(0, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        self._detector = detector
        self._lights = lights
        self._cameras = list(cameras.values())

    def batch(
        self, images_bgr: Sequence[ImageArray], regions: Sequence[Region | None] | None = None
    ) -> list[Detections]:
        """See `Detector.batch`; the images are those of all cameras."""
        found = self._detector.batch(images_bgr, regions)
        return [self._with_lights(seen, each) for seen, each in zip(found, self._cameras, strict=True)]

    def _with_lights(self, seen: Detections, camera: CameraModel) -> Detections:
        projected = project_lights(self._lights, camera, self.pose)
        boxes_xyxy = projected.boxes_xyxy[projected.expected]
        n, class_count = len(boxes_xyxy), len(self._detector.classes)
        types = [name.partition("-")[0] for name in self._detector.classes]
        class_probs = np.full((n, class_count), 0.02)
        class_probs[np.arange(n), [types.index(name) for name in projected.types[projected.expected]]] = 0.9
        return Detections(
            np.concatenate([seen.boxes_xyxy, boxes_xyxy]),
            np.concatenate([seen.objectness, np.full(n, 0.9)]),
            np.concatenate([seen.class_probs, class_probs]),
        )


def main() -> None:
    """Drive, watch, judge: exit code 1 if a limit is broken."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--frames", type=int, default=10_000, help="of both cameras together")
    parser.add_argument("--threads", type=int)
    parser.add_argument("--regions", action="store_true", help="look around the lights of the map only")
    arguments = parser.parse_args()

    bundle = Bundle.load(arguments.bundle)
    cameras = {each.name: each for each in (camera("narrow", 2200.0), camera("wide", 1000.0))}
    config = PipelineConfig(regions=dict.fromkeys(cameras, RegionConfig()) if arguments.regions else {})
    lights = along_a_road(bundle)
    detector = Seeing(
        Detector.from_bundle(bundle, threads=arguments.threads, images_at_once=len(cameras)), lights, cameras
    )
    pipeline = LightPipeline(detector, bundle.hmm, bundle.signals, cameras, lights, config)
    frames, sets = images(), arguments.frames // 2
    samples: list[tuple[float, float]] = []
    told = 0
    started = time.perf_counter()
    for i in track(range(sets), description="sets of frames", total=sets, unit="sets"):
        stamp_ns = round(i * 1e9 / RATE_HZ)
        detector.pose = Pose(stamp_ns, place(stamp_ns), np.array([0.0, 0.0, 0.0, 1.0]))
        pipeline.update_pose(detector.pose)
        pair = [CameraFrame(name, stamp_ns, frames[2 * k + i % 2]) for k, name in enumerate(cameras)]
        told += len(pipeline.step(pair))
        if i % max(sets // 100, 1) == 0 or i == sets - 1:
            samples.append(resident_mb())
    seconds = time.perf_counter() - started

    # What is allocated once (arenas, caches, the first tracks) is there after a tenth of the way.
    settled = samples[len(samples) // 10 :]
    third = max(len(settled) // 3, 1)
    growth_mb = np.median([anon for anon, _ in settled[-third:]]) - np.median([anon for anon, _ in settled[:third]])
    peak_mb = max(rss for _, rss in samples)
    print(
        f"{2 * sets} frames in {seconds:.0f} s, {told / sets:.1f} lights told of in a set, {pipeline.skipped} skipped"
    )
    print(
        f"resident: at most {peak_mb:.0f} MB (limit {LIMIT_MB:.0f}), of it {samples[-1][0]:.0f} MB anonymous at the end"
    )
    print(f"growth from the first to the last third: {growth_mb:+.1f} MB (limit {GROWTH_MB:.0f})")
    if peak_mb > LIMIT_MB or growth_mb > GROWTH_MB:
        sys.exit(1)


if __name__ == "__main__":
    main()
