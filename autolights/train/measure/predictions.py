"""What is labelled in an image, what a detector says about it, and COCO's file for the latter."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from autolights.core import FloatArray, IntArray
from autolights.core.atomic import write_text
from autolights.core.errors import DataError

_FIELDS = ("image_id", "category_id", "bbox", "score")


@dataclass(frozen=True, eq=False)
class Labels:
    """The truth of one image: (n, 4) boxes in pixels of the original image and (n,) class indices."""

    boxes_xyxy: FloatArray
    class_ids: IntArray


@dataclass(frozen=True, eq=False)
class Predictions:
    """What a detector said about one image: (m, 4) boxes in pixels, (m,) class indices, (m,) scores.

    `class_probs` are the (m, C) sigmoids behind the class, where they are kept.
    """

    boxes_xyxy: FloatArray
    class_ids: IntArray
    scores: FloatArray
    class_probs: FloatArray | None = None

    def above(self, score_threshold: float) -> Self:
        """Those with at least this score."""
        kept = self.scores >= score_threshold
        class_probs = None if self.class_probs is None else self.class_probs[kept]
        return type(self)(self.boxes_xyxy[kept], self.class_ids[kept], self.scores[kept], class_probs)


def save_predictions(path: Path, image_paths: Sequence[Path], predictions: Sequence[Predictions]) -> None:
    """Write predictions as COCO results.

    Args:
        path: Gets a JSON list with an entry for each prediction: ``image_id`` is the image file's name without its
            ending, ``category_id`` the class index, ``bbox`` left, top, width and height in pixels.
        image_paths: Of the images.
        predictions: One entry per image.
    """
    results: list[dict[str, Any]] = []
    for image_path, image in zip(image_paths, predictions, strict=True):
        lows, highs = image.boxes_xyxy[:, :2], image.boxes_xyxy[:, 2:]
        boxes = np.concatenate([lows, highs - lows], axis=1).round(3).tolist()
        for box, class_id, score in zip(boxes, image.class_ids.tolist(), image.scores.tolist(), strict=True):
            results.append(dict(zip(_FIELDS, (image_path.stem, class_id, box, round(score, 6)), strict=True)))
    write_text(path, "[" + ",\n".join(map(json.dumps, results)) + "]\n")


def load_predictions(path: Path, image_paths: Sequence[Path], class_count: int) -> list[Predictions]:
    """Read COCO results that `save_predictions` or a YOLOv5 trainer wrote.

    Args:
        path: Of the file.
        image_paths: Whose predictions are wanted; images that the file does not name have none.
        class_count: C.

    Returns:
        One entry per image, in the order of `image_paths`.

    Raises:
        DataError: If the file is no list of COCO results, names an image that is not among `image_paths`, or a class
            that there is not.
    """
    rows = _read_results(path)
    names = [_image_id(image_path.stem) for image_path in image_paths]
    index = {name: i for i, name in enumerate(names)}
    if len(index) < len(names):
        raise DataError(f"{path}: cannot be assigned, as several images have the same name but for their endings")
    values = np.empty((len(rows), 7))
    for row, result in zip(values, rows, strict=True):
        i = index.get(_image_id(result["image_id"]))
        if i is None:
            raise DataError(f"{path}: image_id {result['image_id']!r} is none of the {len(names)} images measured on")
        if not (isinstance(result["category_id"], int) and 0 <= result["category_id"] < class_count):
            raise DataError(
                f"{path}: category_id must be from 0 to {class_count - 1}, got {result['category_id']!r}; "
                "predictions and data must have the same classes"
            )
        left, top, width, height = result["bbox"]
        row[:] = i, result["category_id"], result["score"], left, top, left + width, top + height
    by_image = [values[values[:, 0] == i] for i in range(len(names))]
    return [Predictions(rows[:, 3:], rows[:, 1].astype(np.int64), rows[:, 2]) for rows in by_image]


def _read_results(path: Path) -> list[dict[str, Any]]:
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}); `autolights val --save-predictions`") from error
    except ValueError as error:
        raise DataError(f"{path}: not JSON ({error})") from error
    if not (isinstance(rows, list) and all(isinstance(row, dict) and row.keys() >= set(_FIELDS) for row in rows)):
        raise DataError(f"{path}: must be a list of COCO results, each with {', '.join(_FIELDS)}")
    return rows


def _image_id(name: Any) -> str:
    """YOLOv5 writes a name that is a number as one: 000123 as 123."""
    return str(int(name)) if str(name).isdecimal() else str(name)
