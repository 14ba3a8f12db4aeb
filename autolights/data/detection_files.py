"""Detections as files that other programs read: JSON lines, YOLO labels, a COCO data set. Written as they come."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Literal, NamedTuple, Protocol, Self, TypeAlias

from autolights.core import Detections
from autolights.core.boxes import area, cxcywh_from_xyxy

DetectionFormat: TypeAlias = Literal["jsonl", "yolo", "coco"]
DETECTIONS, LABELS, COCO = "detections.jsonl", "labels", "coco.json"


class DetectedImage(NamedTuple):
    """Which image detections are of.

    Attributes:
        name: Relative path without ending, unique among all images.
        path: The file that the image comes from.
        frame: Its number in a video, else None.
        size_wh: Width and height in pixels.
    """

    name: str
    path: Path
    frame: int | None
    size_wh: tuple[int, int]


class DetectionWriter(Protocol):
    """Takes the detections of one image after the other; a context manager that finishes its files at the end."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...

    def write(self, image: DetectedImage, detections: Detections) -> None:
        """Add an image with its detections, in pixels of the image."""
        ...


def open_writer(kind: DetectionFormat, folder: Path, classes: Sequence[str], *, scores: bool = True) -> DetectionWriter:
    """A writer into a folder that exists; `scores` adds them to YOLO labels as a sixth column."""
    if kind == "jsonl":
        return _JsonLines(folder / DETECTIONS, classes)
    if kind == "yolo":
        return _YoloLabels(folder, classes, scores=scores)
    return _CocoDataset(folder / COCO, classes)


class _JsonLines:
    """A line per image: path, frame, boxes_xyxy in pixels, scores, classes."""

    def __init__(self, path: Path, classes: Sequence[str]) -> None:
        self._classes = classes
        self._file = path.open("w", encoding="utf-8")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def write(self, image: DetectedImage, detections: Detections) -> None:
        line = {
            "path": str(image.path),
            "frame": image.frame,
            "boxes_xyxy": [[round(edge, 2) for edge in box] for box in detections.boxes_xyxy.tolist()],
            "scores": [round(score, 4) for score in detections.scores.tolist()],
            "classes": [self._classes[i] for i in detections.class_ids],
        }
        self._file.write(json.dumps(line) + "\n")


class _YoloLabels:
    """A text per image, empty where nothing was found: class, centre x, y, width, height as shares of the image."""

    def __init__(self, folder: Path, classes: Sequence[str], *, scores: bool) -> None:
        self._folder = folder / LABELS
        self._scores = scores
        self._folder.mkdir()
        (folder / "classes.txt").write_text("".join(f"{name}\n" for name in classes), encoding="utf-8")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def write(self, image: DetectedImage, detections: Detections) -> None:
        shares = cxcywh_from_xyxy(detections.boxes_xyxy) / (*image.size_wh, *image.size_wh)
        lines = []
        for class_id, box, score in zip(detections.class_ids, shares.tolist(), detections.scores, strict=True):
            numbers = [*box, float(score)] if self._scores else box
            lines.append(f"{class_id} " + " ".join(f"{number:.6f}" for number in numbers) + "\n")
        file = self._folder / f"{image.name}.txt"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("".join(lines), encoding="utf-8")


class _CocoDataset:
    """One COCO data set whose annotations have a ``score``, so that they serve as results too.

    Annotations go straight into the file; only the short list of images waits in a second one, so a long video takes
    no memory.
    """

    def __init__(self, path: Path, classes: Sequence[str]) -> None:
        categories = [{"id": i, "name": name} for i, name in enumerate(classes)]
        self._file = path.open("w", encoding="utf-8")
        self._images_path = path.with_suffix(".images.tmp")
        self._images = self._images_path.open("w+", encoding="utf-8")
        self._image_count = self._annotation_count = 0
        self._file.write(f'{{"categories": {json.dumps(categories)},\n"annotations": [')

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.write('],\n"images": [')
        self._images.seek(0)
        for line in self._images:
            self._file.write(line)
        self._file.write("]}\n")
        self._file.close()
        self._images.close()
        self._images_path.unlink()

    def write(self, image: DetectedImage, detections: Detections) -> None:
        self._image_count += 1
        file_name = str(image.path) if image.frame is None else image.name
        width, height = image.size_wh
        entry = {"id": self._image_count, "file_name": file_name, "width": width, "height": height}
        _append(self._images, entry, first=self._image_count == 1)
        rows = zip(
            detections.boxes_xyxy.round(2).tolist(),
            area(detections.boxes_xyxy).tolist(),
            detections.class_ids.tolist(),
            detections.scores.tolist(),
            strict=True,
        )
        for (left, top, right, bottom), pixels, class_id, score in rows:
            self._annotation_count += 1
            annotation = {
                "id": self._annotation_count,
                "image_id": self._image_count,
                "category_id": class_id,
                "bbox": [left, top, round(right - left, 2), round(bottom - top, 2)],
                "area": round(pixels, 2),
                "iscrowd": 0,
                "score": round(score, 4),
            }
            _append(self._file, annotation, first=self._annotation_count == 1)


def _append(file: IO[str], entry: object, *, first: bool) -> None:
    file.write(("\n" if first else ",\n") + json.dumps(entry))
