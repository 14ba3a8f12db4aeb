"""`autolights detect`: a bundle's detector over images and videos, without map, poses or tracking."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from autolights.core import Bundle, Detections
from autolights.core.atomic import new_folder
from autolights.core.errors import UsageError
from autolights.core.progress import say, track
from autolights.infer import Detector, ImageSources, draw_detections
from autolights.infer.sources import SourceImage

DETECTIONS, PICTURES = "detections.jsonl", "pictures"


@dataclass(frozen=True)
class DetectSummary:
    """What was done: images looked at, lights found in them, files that did not decode."""

    images: int
    detections: int
    skipped: int

    def to_json(self) -> dict[str, Any]:
        """The counts as JSON-ready values."""
        return {"images": self.images, "detections": self.detections, "skipped": self.skipped}


def detect_files(
    bundle_dir: Path,
    inputs: Sequence[str | Path],
    out_dir: Path,
    *,
    score_threshold: float | None = None,
    pictures: bool = True,
    threads: int | None = None,
    force: bool = False,
) -> DetectSummary:
    """Detect lights in images and videos.

    Writes ``detections.jsonl``, one line per image (path, frame of a video or null, boxes_xyxy in pixels, scores,
    classes), and pictures with boxes into ``pictures/``. A file that does not decode is named on stderr and counted.

    Args:
        bundle_dir: A bundle.
        inputs: See `ImageSources`.
        out_dir: Appears whole or not at all.
        score_threshold: Instead of the bundle's.
        pictures: Write pictures as well.
        threads: Of ONNX Runtime within an operator; None leaves the choice to it.
        force: Replace `out_dir` if it exists.

    Raises:
        UsageError: If an input is missing, `out_dir` exists and `force` is not set, or no image could be decoded.
        BundleError: If the bundle is incomplete or altered.
    """
    bundle = Bundle.load(bundle_dir)
    sources = ImageSources(inputs)
    detector = Detector.from_bundle(bundle, score_threshold=score_threshold, threads=threads)
    images = found = 0
    with new_folder(out_dir, force=force) as folder, (folder / DETECTIONS).open("w", encoding="utf-8") as lines:
        for source in track(sources, description="detect", total=sources.expected_images, unit="images"):
            detections = detector(source.image_bgr)
            lines.write(json.dumps(_line(source, detections, detector.classes)) + "\n")
            images += 1
            found += len(detections)
            if pictures:
                path = folder / PICTURES / f"{source.picture_name}.jpg"
                path.parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(path), draw_detections(source.image_bgr, detections, bundle.signals))
        for path in sources.skipped:
            say(f"warning: {path}: does not decode, skipped")
        if not images:
            raise UsageError(
                f"none of the {len(sources.paths)} files could be decoded, the first: {sources.skipped[0]}"
            )
    return DetectSummary(images, found, len(sources.skipped))


def _line(source: SourceImage, detections: Detections, classes: Sequence[str]) -> dict[str, Any]:
    return {
        "path": str(source.path),
        "frame": source.frame,
        "boxes_xyxy": [[round(edge, 2) for edge in box] for box in detections.boxes_xyxy.tolist()],
        "scores": [round(score, 4) for score in detections.scores.tolist()],
        "classes": [classes[i] for i in detections.class_ids],
    }
