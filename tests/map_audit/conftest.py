"""A street whose map has one fault of each kind, driven along once or twice, as folders of runs and drives."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from autolights.core import TrafficLightMap
from autolights.core.json_files import write_json
from autolights.data import DetectedFrame, EstimateSet, FrameRecord, write_drive
from autolights.data.run_output import DETECTIONS, ESTIMATES, RUN
from autolights.pipeline import PipelineConfig


def _light(kind: str, aside_m: float, shown: str) -> tuple[str, tuple[float, float, float], Callable]:
    return kind, (60.0, aside_m, 5.0), lambda t: shown


LIGHTS = {
    "ok-1": _light("3", -9.0, "3-red"),
    "ok-2": _light("3", -6.0, "3-red"),
    "ok-3": _light("4", 9.0, "4-rleft"),
    "moved": _light("3", -3.0, "3-green"),
    "odd": _light("5dh", 3.0, "5dh-red"),
    "new": _light("3", 6.0, "3-green"),
}
GHOST = ("3", (60.0, 0.5, 5.0))
MOVED_M = np.array([0.0, -1.2, 0.0])  # from the true place to the map's


@dataclass(frozen=True, eq=False)
class Street:
    """One drive in memory, and how to write it down."""

    scene: object
    name: str
    sets: tuple[EstimateSet, ...]
    frames: tuple[DetectedFrame, ...]

    def write(self, folder: Path, *, pictures: bool = False) -> tuple[Path, Path]:
        """Folders of the run and of the drive; without pictures the images are empty files."""
        drive_dir, run_dir = folder / self.name, folder / f"{self.name}-run"
        (drive_dir / "images").mkdir(parents=True)
        records = []
        for frame in self.frames:
            path = Path("images") / f"{frame.camera}_{frame.stamp_ns}.jpg"
            if pictures:
                cv2.imwrite(str(drive_dir / path), np.full((800, 1280, 3), 90, np.uint8))
            else:
                (drive_dir / path).touch()
            records.append(FrameRecord(frame.stamp_ns, frame.camera, path))
        write_drive(
            drive_dir,
            name=self.name,
            utm_zone=17,
            hemisphere="north",
            height_datum="ellipsoid",
            cameras=list(self.scene.rig.values()),
            poses=[self.scene.pose(t) for t in np.arange(0, 10, 0.1)],
            lights=self.scene.map,
            frames=records,
            truth=None,
        )
        run_dir.mkdir()
        lines = [
            {
                "format": 2,
                "stamp_ns": entry.stamp_ns,
                "variant": entry.variant,
                "frames": [{"camera": camera, "stamp_ns": stamp_ns} for camera, stamp_ns in entry.frames],
                "lights": [light.to_json() for light in entry.lights],
            }
            for entry in self.sets
        ]
        (run_dir / ESTIMATES).write_text("".join(json.dumps(line) + "\n" for line in lines))
        found = [
            {
                "stamp_ns": frame.stamp_ns,
                "camera": frame.camera,
                "boxes_xyxy": np.round(frame.boxes_xyxy, 2).tolist(),
                "scores": frame.scores.tolist(),
                "classes": list(frame.classes),
            }
            for frame in self.frames
        ]
        (run_dir / DETECTIONS).write_text("".join(json.dumps(line) + "\n" for line in found))
        config = PipelineConfig().model_dump(mode="json")
        write_json(run_dir / RUN, {"drive": str(drive_dir), "config": config, "variants": {"full": {}}})
        return run_dir, drive_dir


@pytest.fixture
def drive_along(make_scene: Callable) -> Callable[..., Street]:
    def drive(
        name: str = "monday",
        *,
        lights: dict = LIGHTS,
        seconds: float = 4.5,
        seed: int = 7,
        fault: bool = True,
        config: PipelineConfig | None = None,
    ) -> Street:
        phantoms = {"ghost": GHOST} if fault else {}
        scene = make_scene(
            lights,
            off_map=frozenset({"new"}) if fault else frozenset(),
            phantoms=phantoms,
            cameras=("narrow", "wide"),
            speed_mps=10.0,
            noise_px=0.5,
        )
        scene.rng = np.random.default_rng(seed)
        if fault:
            scene.map = with_faults(scene.map, scene.signals)
        pipeline = scene.pipeline(config)
        sets, frames = [], []
        for t in np.arange(0, seconds, 0.1):
            shots = scene.shots(t)
            found = [scene.detect(shot.camera, t) for shot in shots]
            keys = tuple((shot.camera, shot.stamp_ns) for shot in shots)
            told = pipeline.step_detections(shots, found)
            sets.append(EstimateSet(shots[0].stamp_ns, "full", keys, tuple(told)))
            for shot, d in zip(shots, found, strict=True):
                classes = tuple(scene.signals.classes[i] for i in d.class_ids)
                frames.append(DetectedFrame(shot.stamp_ns, shot.camera, d.boxes_xyxy, d.scores, classes))
        return Street(scene, name, tuple(sets), tuple(frames))

    return drive


def with_faults(lights: TrafficLightMap, signals: object) -> TrafficLightMap:
    """The map with one light moved and one of another type."""
    moved = np.array([light_id == "moved" for light_id in lights.ids])
    types = tuple("3" if light_id == "odd" else kind for light_id, kind in zip(lights.ids, lights.types, strict=True))
    return replace(
        lights,
        types=types,
        sizes_m=signals.sizes_m(types),  # type: ignore[attr-defined]
        positions=lights.positions + moved[:, None] * MOVED_M,
        intersections=("main",) * len(lights),
    )
