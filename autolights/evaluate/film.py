"""A short film of a drive as the runtime sees it: map boxes, detections, associations and tracks."""

import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray, LightEstimate, SignalSet
from autolights.core.boxes import cxcywh_from_xyxy
from autolights.core.errors import DataError
from autolights.core.light_box import project_visible
from autolights.data import DetectedFrame, FrameRecord
from autolights.evaluate.moments import estimate_box, estimates_in
from autolights.evaluate.outcomes import RunOutcomes
from autolights.evaluate.palette import ASSOCIATION, DARK, MAP, bgr, main_color

LENGTH_S = 8.0
WIDTH_PX = 960
_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.44


@dataclass(frozen=True, eq=False)
class Scene:
    """A stretch of one camera's frames."""

    run: RunOutcomes
    records: tuple[FrameRecord, ...]

    @property
    def fps(self) -> float:
        """Frames per second of the camera."""
        if len(self.records) < 2:
            return 10.0
        return (len(self.records) - 1) * 1e9 / (self.records[-1].stamp_ns - self.records[0].stamp_ns)


def best_scene(runs: Sequence[RunOutcomes]) -> Scene | None:
    """The eight seconds of one camera in which tracking is right and detection alone is wrong most often."""
    best: tuple[int, int] | None = None
    scene: Scene | None = None
    for run in runs:
        if "od" not in run.variants or "full" not in run.variants:
            continue
        wrong = {(r.camera, r.stamp_ns, r.truth.truth_id) for r in run.variants["od"].outcomes if not r.correct}
        right = [r for r in run.variants["full"].outcomes if r.correct]
        for camera in run.drive.cameras:
            records = [r for r in run.drive.frames if r.camera == camera and (camera, r.stamp_ns) in run.posed_frames]
            stamps = np.array([record.stamp_ns for record in records])
            rescued = np.zeros(len(records), dtype=np.int64)
            shown = np.zeros(len(records), dtype=np.int64)
            for row in right:
                if row.camera == camera:
                    i = int(np.searchsorted(stamps, row.stamp_ns))
                    rescued[i] += (camera, row.stamp_ns, row.truth.truth_id) in wrong
                    shown[i] += 1
            ends = np.searchsorted(stamps, stamps + LENGTH_S * 1e9)
            for start, end in enumerate(ends):
                worth = int(rescued[start:end].sum()), int(shown[start:end].sum())
                if best is None or worth > best:
                    best, scene = worth, Scene(run, tuple(records[start:end]))
    return scene


def film_frames(scene: Scene, detections: Sequence[DetectedFrame], signals: SignalSet) -> list[ImageArray]:
    """Draw what the runtime sees into each image.

    Args:
        scene: Which frames.
        detections: Of the run; frames that are missing get none.
        signals: For colours and sizes.

    Returns:
        BGR images, 960 px wide or as wide as the camera if that is less; frames that do not decode are left out.
    """
    by_frame = {(frame.camera, frame.stamp_ns): frame for frame in detections}
    drawn = []
    for record in scene.records:
        try:
            image_bgr = scene.run.drive.read(record).image_bgr
        except DataError:
            continue
        drawn.append(_draw(scene.run, record, image_bgr, by_frame.get((record.camera, record.stamp_ns)), signals))
    return drawn


def encode_webm(frames: Sequence[ImageArray], fps: float) -> bytes | None:
    """VP8 in WebM, which every browser plays; None if this build of OpenCV cannot write it."""
    height, width = frames[0].shape[:2]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.webm"
        with _quiet_stderr():
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"VP80"), fps, (width, height))
        if not writer.isOpened():
            return None
        for frame in frames:
            writer.write(frame)
        writer.release()
        return path.read_bytes()


@contextmanager
def _quiet_stderr() -> Iterator[None]:
    """Silence the process's stderr: OpenCV's C code writes there that WebM wants no four-letter code, and goes on."""
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _draw(
    run: RunOutcomes, record: FrameRecord, image_bgr: ImageArray, detected: DetectedFrame | None, signals: SignalSet
) -> ImageArray:
    height, width = image_bgr.shape[:2]
    # Even sides, as the codec wants them.
    scale = min(1.0, WIDTH_PX / width)
    size_wh = (round(width * scale) // 2 * 2, round(height * scale) // 2 * 2)
    small = cv2.resize(image_bgr, size_wh, interpolation=cv2.INTER_AREA)
    image = np.asarray(cv2.medianBlur(small, 3), dtype=np.uint8)  # sensor noise is two thirds of a film's bytes
    frame = (record.camera, record.stamp_ns)

    map_boxes = _map_boxes(run, frame)
    if detected is not None:
        for box, name in zip(detected.boxes_xyxy, detected.classes, strict=True):
            # Drawn around the light, so that what it shows stays visible.
            _rectangle(image, np.asarray(box) * scale + [-2, -2, 2, 2], main_color(name, signals), 2)
    for box in map_boxes.values():
        _rectangle(image, box * scale, MAP, 1)
    for estimate in estimates_in(run.estimates, "full", frame):
        drawn = estimate_box(estimate, run, frame, signals)
        if drawn is None or not (drawn[2] > 0 and drawn[0] < width and drawn[3] > 0 and drawn[1] < height):
            continue
        box = np.array(drawn) * scale
        seen = any((v.camera, v.stamp_ns) == frame and v.box_xyxy is not None for v in estimate.views)
        if seen and estimate.map_id in map_boxes:
            _line(image, map_boxes[estimate.map_id] * scale, box)
        _track_label(image, box, estimate, signals)
    seconds = (record.stamp_ns - run.drive.frames[0].stamp_ns) / 1e9
    _text(image, f"{run.drive.name}  {record.camera}  {seconds:5.1f} s", (10, 20), "#1a1f26", "#ffffff")
    return image


def _map_boxes(run: RunOutcomes, frame: tuple[str, int]) -> dict[str | None, FloatArray]:
    """Where the runtime looked for the map's lights."""
    lights = run.drive.lights
    rows, boxes = project_visible(lights, run.drive.cameras[frame[0]], run.poses.at(frame[1]))
    return {lights.ids[row]: box for row, box in zip(rows, boxes, strict=True)}


def _rectangle(image: ImageArray, box: FloatArray, color: str, thickness: int) -> None:
    left, top, right, bottom = (round(float(edge)) for edge in box)
    cv2.rectangle(image, (left, top), (right, bottom), bgr(color), thickness, cv2.LINE_AA)


def _line(image: ImageArray, from_box: FloatArray, to_box: FloatArray) -> None:
    (x1, y1), (x2, y2) = (cxcywh_from_xyxy(box)[:2].round().astype(int) for box in (from_box, to_box))
    cv2.line(image, (int(x1), int(y1)), (int(x2), int(y2)), bgr(ASSOCIATION), 2, cv2.LINE_AA)


def _track_label(image: ImageArray, box: FloatArray, estimate: LightEstimate, signals: SignalSet) -> None:
    color = DARK if estimate.withheld else main_color(estimate.class_name, signals)
    what = "withheld" if estimate.withheld else estimate.class_name
    label = f"{estimate.track_id} {what}" + (" *" if estimate.flashing else "")
    ink = "#ffffff" if color == DARK else "#14181d"
    _text(image, label, (round(float(box[0])), max(round(float(box[1])) - 8, 34)), color, ink)


def _text(image: ImageArray, text: str, at: tuple[int, int], background: str, ink: str) -> None:
    (width, height), baseline = cv2.getTextSize(text, _FONT, _FONT_SCALE, 1)
    x = max(min(at[0], image.shape[1] - width - 4), 4)
    y = at[1]
    cv2.rectangle(image, (x - 3, y - height - 3), (x + width + 3, y + baseline), bgr(background), -1)
    cv2.putText(image, text, (x, y), _FONT, _FONT_SCALE, bgr(ink), 1, cv2.LINE_AA)
