"""`autolights detect`: a bundle's detector over images, videos and cameras, without map, poses or tracking."""

import signal
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2

from autolights.core import Bundle
from autolights.core.atomic import new_folder
from autolights.core.errors import UsageError
from autolights.core.progress import say, track
from autolights.data.detection_files import DetectedImage, DetectionFormat, open_writer
from autolights.infer import Detector, ImageSources, draw_detections
from autolights.infer.sources import SourceImage

PICTURES = "pictures"


@dataclass(frozen=True)
class DetectSummary:
    """What was done.

    Attributes:
        images: Looked at, frames of videos and cameras included.
        detections: Lights found in them.
        skipped: Files of which nothing decoded.
        bad_frames: Frames of videos and cameras that did not decode.
        images_per_s: From decoded image to boxes; 0 if there were none.
    """

    images: int
    detections: int
    skipped: int
    bad_frames: int
    images_per_s: float

    def to_json(self) -> dict[str, Any]:
        """The counts as JSON-ready values."""
        return asdict(self)


def detect_files(
    bundle_dir: Path,
    inputs: Sequence[str | Path],
    out_dir: Path,
    *,
    formats: Sequence[DetectionFormat] = ("jsonl",),
    score_threshold: float | None = None,
    scores: bool = True,
    pictures: bool = True,
    max_images: int | None = None,
    threads: int | None = None,
    force: bool = False,
) -> DetectSummary:
    """Detect lights in images, videos or a camera's frames.

    Writes one file or folder for each format (see `data.detection_files`), and pictures with boxes into ``pictures/``.
    What does not decode is named on stderr and counted. Boxes are in pixels of the upright image, as viewers show it.

    Args:
        bundle_dir: A bundle.
        inputs: See `ImageSources`.
        out_dir: Appears whole or not at all. With a camera, Ctrl-C is the ordinary end and what was seen until then is
            kept.
        formats: ``jsonl``, ``yolo``, ``coco``.
        score_threshold: Instead of the bundle's.
        scores: Add scores to YOLO labels.
        pictures: Write pictures as well.
        max_images: Stop after so many; None for no limit.
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
    spent_s = 0.0
    with new_folder(out_dir, force=force) as folder:
        with ExitStack() as stack:
            writers = [
                stack.enter_context(open_writer(kind, folder, detector.classes, scores=scores))
                for kind in dict.fromkeys(formats)
            ]
            for source in _shown(sources, max_images):
                start = time.perf_counter()
                detections = detector(source.image_bgr)
                spent_s += time.perf_counter() - start
                height, width = source.image_bgr.shape[:2]
                image = DetectedImage(source.picture_name, source.path, source.frame, (width, height))
                for writer in writers:
                    writer.write(image, detections)
                images += 1
                found += len(detections)
                if pictures:
                    path = folder / PICTURES / f"{source.picture_name}.jpg"
                    path.parent.mkdir(parents=True, exist_ok=True)
                    cv2.imwrite(str(path), draw_detections(source.image_bgr, detections, bundle.signals))
        _tell_what_failed(sources)
        if not images:
            raise UsageError(f"none of the {len(sources.paths)} inputs gave an image, the first: {sources.skipped[0]}")
    return DetectSummary(
        images=images,
        detections=found,
        skipped=len(sources.skipped),
        bad_frames=sources.bad_frames.total(),
        images_per_s=round(images / spent_s, 2),
    )


def _shown(sources: ImageSources, max_images: int | None) -> Iterator[SourceImage]:
    """The images with progress. With a camera Ctrl-C does not interrupt: the image at hand is the last one."""
    total = sources.expected_images
    if max_images is not None:
        total = max_images if total is None else min(total, max_images)
    images: Iterable[SourceImage] = islice(sources, max_images)
    if not sources.live:
        yield from track(images, description="detect", total=total, unit="images")
        return
    stop = threading.Event()
    earlier = signal.signal(signal.SIGINT, lambda *_: stop.set())
    try:
        for source in track(images, description="detect (Ctrl-C ends it)", total=total, unit="images"):
            yield source
            if stop.is_set():
                return
    finally:
        signal.signal(signal.SIGINT, earlier)


def _tell_what_failed(sources: ImageSources) -> None:
    for path in sources.skipped:
        say(f"warning: {path}: does not decode, skipped")
    for path, count in sources.bad_frames.items():
        if path not in sources.skipped:
            say(f"warning: {path}: {count} frames do not decode, left out")
