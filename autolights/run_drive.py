"""A whole recorded drive through the pipeline: drive → ``estimates.jsonl``, ``detections.jsonl``, ``run.json``."""

import json
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

import autolights
from autolights.core import Bundle, CameraFrame, Detections, LightEstimate, SignalSet
from autolights.core.atomic import new_folder, refuse_existing
from autolights.core.errors import DataError, UsageError
from autolights.core.estimates import VARIANTS, Variant
from autolights.core.json_files import write_json
from autolights.core.progress import say, track
from autolights.data import Drive, FrameRecord
from autolights.data.run_output import DETECTIONS, ESTIMATES, ESTIMATES_FORMAT, RUN
from autolights.infer import Detector, Execution
from autolights.pipeline import ImageDetector, LightPipeline, PipelineConfig
from autolights.track import CameraHealth

UNREADABLE = "unreadable image"


@dataclass(frozen=True, eq=False)
class VariantTimes:
    """What one variant cost.

    Attributes:
        images: Images that took part.
        detect_ms: Detection of each set of frames, all cameras.
        track_ms: All the rest of each set.
    """

    images: int
    detect_ms: tuple[float, ...]
    track_ms: tuple[float, ...]

    @property
    def fps(self) -> float:
        """Sets of frames per second, end to end but for the decoding of images; 0 if there were none."""
        total_ms = sum(self.detect_ms) + sum(self.track_ms)
        return 1000 * len(self.track_ms) / total_ms if total_ms else 0.0

    def to_json(self) -> dict[str, Any]:
        """The entry of ``run.json``."""
        return {
            "sets": len(self.track_ms),
            "images": self.images,
            "detect_ms": _spread(self.detect_ms),
            "track_ms": _spread(self.track_ms),
            "fps": round(self.fps, 2),
        }


@dataclass(frozen=True, eq=False)
class RunSummary:
    """What came of a run.

    Attributes:
        drive: Folder of the drive.
        skipped: How many frames were left out, by reason.
        variants: Times of each variant.
        health: What the images say of each camera; empty without variant ``full``, or without alignment.
    """

    drive: Path
    skipped: dict[str, int]
    variants: dict[str, VariantTimes]
    health: dict[str, CameraHealth]

    def to_json(self) -> dict[str, Any]:
        """The summary as JSON-ready values."""
        return {
            "drive": str(self.drive),
            "skipped_frames": sum(self.skipped.values()),
            "skipped_reasons": self.skipped,
            "variants": {name: times.to_json() for name, times in self.variants.items()},
            "cameras": {name: own.to_json() for name, own in self.health.items()},
        }


def run_drive(
    bundle: Bundle,
    drive: Drive,
    config: PipelineConfig,
    out_dir: Path,
    *,
    variants: Sequence[str] = VARIANTS,
    explain: bool = False,
    force: bool = False,
    execution: Execution | None = None,
    detector: ImageDetector | None = None,
) -> RunSummary:
    """Run the pipeline's variants over a drive; images are detected once for all of them.

    Images that do not decode and frames whose pose is not known are left out, counted and named on stderr.

    Args:
        bundle: Detector and HMMs.
        drive: The drive.
        config: Settings; its variant is replaced by each of `variants`.
        out_dir: Appears whole or not at all.
        variants: Of ``od``, ``fusion``, ``full``.
        explain: Also write boxes, costs, pairs and beliefs into each line.
        force: Replace `out_dir`.
        execution: How the bundle's detector is run; None: see `Detector.from_bundle`.
        detector: Instead of the bundle's.

    Raises:
        UsageError: If a variant is unknown or `out_dir` exists and `force` is not set.
        DataError: If not a single frame of the drive could be used.
    """
    unknown = sorted(set(variants) - set(VARIANTS))
    if unknown or not variants:
        raise UsageError(f"variant must be one of {', '.join(VARIANTS)}, got {unknown[0] if unknown else 'none'}")
    refuse_existing(out_dir, force=force)
    detector = detector or Detector.from_bundle(bundle, execution, images_at_once=len(drive.cameras))
    poses = drive.pose_buffer()  # only read from here on, so one serves all variants
    run = _Run(
        drive,
        bundle.signals,
        {
            variant: LightPipeline(
                detector,
                bundle.hmm,
                bundle.signals,
                drive.cameras,
                drive.lights,
                config.model_copy(update={"variant": variant}),
                poses=poses,
            )
            for variant in VARIANTS
            if variant in variants
        },
        explain,
    )
    with new_folder(out_dir, force=force) as folder:
        with (folder / ESTIMATES).open("w") as estimates, (folder / DETECTIONS).open("w") as detections:
            sets = drive.frame_sets()
            for frame_set in track(sets, description=f"run {drive.name}", total=len(sets), unit="sets"):
                run.step(frame_set, estimates, detections)
        summary = run.summary()
        if not any(times.images for times in summary.variants.values()):
            raise DataError(f"{drive.folder}: none of {len(drive.frames)} frames could be used; {run.last_skip}")
        values = {
            "version": autolights.__version__,
            "bundle": str(bundle.model_path.parent.resolve()),
            "config": config.model_dump(mode="json"),
            "execution": detector.execution.model_dump(mode="json") if isinstance(detector, Detector) else None,
            **summary.to_json(),
        }
        write_json(folder / RUN, values)
    if summary.skipped:
        reasons = ", ".join(f"{count} x {reason}" for reason, count in summary.skipped.items())
        say(f"warning: drive {drive.name}: frames left out: {reasons}; the last: {run.last_skip}")
    for name, health in summary.health.items():
        for warning in health.warnings():
            say(f"warning: drive {drive.name}: camera '{name}' {warning}")
    return summary


class _Run:
    """One pass over a drive with all variants side by side."""

    def __init__(
        self,
        drive: Drive,
        signals: SignalSet,
        pipelines: dict[Variant, LightPipeline],
        explain: bool,
    ) -> None:
        self.last_skip = ""
        self._drive = drive
        self._signals = signals
        self._detecting = list(pipelines.values())[-1]  # of all variants the last remembers most
        self._pipelines = pipelines
        self._explain = explain
        self._unreadable: Counter[str] = Counter()
        self._images: Counter[str] = Counter()
        self._detect_ms: list[float] = []
        self._track_ms: dict[Variant, list[float]] = {variant: [] for variant in pipelines}

    def step(self, records: Sequence[FrameRecord], estimates: IO[str], detections: IO[str]) -> None:
        frames = self._read(records)
        if not frames:
            return
        start_ns = time.perf_counter_ns()
        found = self._detecting.detect(frames)
        detect_ms = (time.perf_counter_ns() - start_ns) / 1e6
        answered = False
        for variant, pipeline in self._pipelines.items():
            left_out = pipeline.skipped.total()
            start_ns = time.perf_counter_ns()
            lights = pipeline.step_detections(frames, found)
            track_ms = (time.perf_counter_ns() - start_ns) / 1e6
            used = len(frames) - (pipeline.skipped.total() - left_out)
            if not used:
                self.last_skip = pipeline.last_skip
                continue
            if used < len(frames):
                self.last_skip = pipeline.last_skip
            answered = True
            self._images[variant] += used
            self._track_ms[variant].append(track_ms)
            line = self._line(frames, variant, lights)
            if self._explain:
                line["explain"] = pipeline.explain()
            estimates.write(json.dumps(line) + "\n")
        if answered:
            self._detect_ms.append(detect_ms)
        for frame, seen in zip(frames, found, strict=True):
            detections.write(json.dumps(self._detection_line(frame, seen)) + "\n")

    def summary(self) -> RunSummary:
        skipped = Counter(self._unreadable)
        skipped.update(next(iter(self._pipelines.values())).skipped)
        return RunSummary(
            drive=self._drive.folder.resolve(),
            skipped=dict(skipped),
            variants={
                variant: VariantTimes(self._images[variant], tuple(self._detect_ms), tuple(track_ms))
                for variant, track_ms in self._track_ms.items()
            },
            health=self._pipelines["full"].health() if "full" in self._pipelines else {},
        )

    def _read(self, records: Sequence[FrameRecord]) -> list[CameraFrame]:
        frames: list[CameraFrame] = []
        for record in records:
            try:
                frames.append(self._drive.read(record))
            except DataError as error:
                self._unreadable[UNREADABLE] += 1
                self.last_skip = str(error)
        return frames

    def _line(self, frames: Sequence[CameraFrame], variant: str, lights: Sequence[LightEstimate]) -> dict[str, Any]:
        return {
            "format": ESTIMATES_FORMAT,
            "stamp_ns": max(frame.stamp_ns for frame in frames),
            "variant": variant,
            "frames": [{"camera": frame.camera, "stamp_ns": frame.stamp_ns} for frame in frames],
            "lights": [light.to_json() for light in lights],
        }

    def _detection_line(self, frame: CameraFrame, seen: Detections) -> dict[str, Any]:
        return {
            "stamp_ns": frame.stamp_ns,
            "camera": frame.camera,
            "boxes_xyxy": np.round(seen.boxes_xyxy, 2).tolist(),
            "scores": np.round(seen.scores, 4).tolist(),
            "classes": [self._signals.classes[i] for i in seen.class_ids],
        }


def _spread(times_ms: Sequence[float]) -> dict[str, float]:
    if not times_ms:
        return {"mean": 0.0, "median": 0.0, "p99": 0.0}
    mean, median, p99 = np.mean(times_ms), np.median(times_ms), np.percentile(times_ms, 99)
    return {"mean": round(float(mean), 3), "median": round(float(median), 3), "p99": round(float(p99), 3)}
