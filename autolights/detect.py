"""`autolights detect`: a bundle's detector over images, videos and cameras, without map, poses or tracking."""

import errno
import signal
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2

from autolights.core import Bundle, ImageArray
from autolights.core.atomic import new_folder
from autolights.core.errors import UsageError
from autolights.core.progress import say, track
from autolights.data.detection_files import DetectedImage, DetectionFormat, open_writer
from autolights.infer import Detector, Execution, ImageSources, draw_detections
from autolights.infer.sources import SourceImage

PICTURES = "pictures"
_JPEG_QUALITY = 90  # a third smaller than at 95, and small lights stay clean


@dataclass(frozen=True)
class DetectSummary:
    """What was done.

    Attributes:
        images: Looked at, frames of videos and cameras included.
        detections: Lights found in them.
        skipped: Files of which nothing decoded.
        bad_frames: Frames of videos, and gaps of a camera, that did not decode.
        missing_frames: Frames that the headers of videos promise beyond those that came.
        lost_camera: The camera fell silent before it was stopped.
        images_per_s: From decoded image to boxes; 0 if there were none.
    """

    images: int
    detections: int
    skipped: int
    bad_frames: int
    missing_frames: int
    lost_camera: bool
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
    execution: Execution | None = None,
    force: bool = False,
) -> DetectSummary:
    """Detect lights in images, videos or a camera's frames.

    Writes one file or folder for each format (see `data.detection_files`), and pictures with boxes into ``pictures/``.
    What does not decode is named on stderr and counted. Boxes are in pixels of the upright image, as viewers show it.

    Args:
        bundle_dir: A bundle.
        inputs: See `ImageSources`.
        out_dir: Appears whole or not at all. With a camera, Ctrl-C or SIGTERM is the ordinary end and what was seen
            until then is kept; so it is when the camera is lost.
        formats: ``jsonl``, ``yolo``, ``coco``.
        score_threshold: Instead of the bundle's.
        scores: Add scores to YOLO labels.
        pictures: Write pictures as well.
        max_images: Stop after so many; None for no limit.
        execution: How the detector is run; None: see `Detector.from_bundle`.
        force: Replace `out_dir` if it exists.

    Raises:
        UsageError: If an input is missing, `out_dir` exists and `force` is not set, or no image could be decoded.
        BundleError: If the bundle is incomplete or altered.
    """
    bundle = Bundle.load(bundle_dir)
    sources = ImageSources(inputs, cameras=True)
    detector = Detector.from_bundle(bundle, execution, score_threshold=score_threshold)
    images = found = 0
    spent_s = 0.0
    with _signals_stop(sources) if sources.live else nullcontext(), new_folder(out_dir, force=force) as folder:
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
                    picture = draw_detections(source.image_bgr, detections, bundle.signals)
                    _write_picture(folder / PICTURES / f"{source.picture_name}.jpg", picture)
        _tell_what_failed(sources)
        if not images:
            raise UsageError(f"none of the {len(sources.paths)} inputs gave an image, the first: {sources.paths[0]}")
    return DetectSummary(
        images=images,
        detections=found,
        skipped=len(sources.skipped),
        bad_frames=sources.bad_frames.total(),
        missing_frames=sources.missing_frames.total(),
        lost_camera=bool(sources.lost),
        images_per_s=round(images / spent_s, 2),
    )


def _shown(sources: ImageSources, max_images: int | None) -> Iterator[SourceImage]:
    """The images with progress."""
    total = sources.expected_images
    if max_images is not None:
        total = max_images if total is None else min(total, max_images)
    images: Iterable[SourceImage] = islice(sources, max_images)
    description = "detect (Ctrl-C ends it)" if sources.live else "detect"
    return track(images, description=description, total=total, unit="images")


@contextmanager
def _signals_stop(sources: ImageSources) -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end a camera in good order; a second one ends the program as usual."""
    if threading.current_thread() is not threading.main_thread():  # only the main thread may say what a signal does
        yield
        return
    earlier = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, handler in earlier.items():
            signal.signal(number, handler)

    def stop(_number: int, _frame: object) -> None:
        restore()
        sources.stop()

    for number in earlier:
        signal.signal(number, stop)
    try:
        yield
    finally:
        restore()


def _write_picture(path: Path, picture: ImageArray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]):
        raise OSError(errno.EIO, "cannot be written; is the disk full?", str(path))


def _tell_what_failed(sources: ImageSources) -> None:
    for path in sources.skipped:
        say(f"warning: {path}: does not decode, skipped")
    for path, count in sources.bad_frames.items():
        if path not in sources.skipped:
            say(f"warning: {path}: {count} frames do not decode, left out")
    for path, count in sources.missing_frames.items():
        say(f"warning: {path}: {count} frames that its header promises did not come")
    for path in sources.lost:
        say(f"warning: {path}: gives no frames any more")
