"""The labels of one image: a text file with a box or an outline in each line."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from autolights.core.arrays import FloatArray, IntArray
from autolights.core.boxes import xyxy_from_cxcywh
from autolights.core.errors import DataError

_OUTSIDE_TOLERANCE = 1e-6  # fractions: six printed decimals round a touching box this far out


@dataclass(frozen=True)
class LabelWarnings:
    """What was unusual in the labels but could be used.

    Attributes:
        without_label_file: Images that have none and count as background.
        clipped_boxes: Boxes that left the image and were cut at its edges.
        dropped_boxes: Boxes without area, as given or once cut.
        duplicate_boxes: Boxes that were given before, with the same class; the first one counts.
    """

    without_label_file: int = 0
    clipped_boxes: int = 0
    dropped_boxes: int = 0
    duplicate_boxes: int = 0

    def __add__(self, other: "LabelWarnings") -> "LabelWarnings":
        return LabelWarnings(
            self.without_label_file + other.without_label_file,
            self.clipped_boxes + other.clipped_boxes,
            self.dropped_boxes + other.dropped_boxes,
            self.duplicate_boxes + other.duplicate_boxes,
        )

    def __str__(self) -> str:
        parts = (
            (self.without_label_file, "images without a label file (taken as background)"),
            (self.clipped_boxes, "boxes cut at the image's edge"),
            (self.dropped_boxes, "boxes without area dropped"),
            (self.duplicate_boxes, "boxes given twice dropped"),
        )
        return ", ".join(f"{count} {what}" for count, what in parts if count)


@dataclass(frozen=True, eq=False)
class ImageLabels:
    """The usable labels of one image.

    Attributes:
        class_ids: (n,).
        boxes_cxcywh: (n, 4) centre, width and height as fractions of the image; inside it, with an area.
        warnings: What was repaired or dropped.
    """

    class_ids: IntArray
    boxes_cxcywh: FloatArray
    warnings: LabelWarnings


def read_labels(path: Path, class_count: int) -> ImageLabels:
    """Read a label file; if there is none, the image is background.

    A line of a class and at least three points outlines a shape; the box around it is taken.

    Raises:
        DataError: If a line breaks the format; the text names it.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return ImageLabels(np.empty(0, np.int64), np.empty((0, 4)), LabelWarnings(without_label_file=1))
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read ({error})") from error
    rows = [_row(f"{path}:{number}", line, class_count) for number, line in enumerate(lines, start=1) if line.strip()]
    return _usable(np.array(rows, dtype=np.float64).reshape(-1, 5))


def _row(place: str, line: str, class_count: int) -> FloatArray:
    """(5,) class and corners as fractions."""
    fields = line.split()
    try:
        values = np.array(fields, dtype=np.float64)
    except ValueError as error:
        raise DataError(f"{place}: must hold numbers only, got {line!r}") from error
    is_box, is_outline = len(values) == 5, len(values) >= 7 and len(values) % 2 == 1
    if not (is_box or is_outline) or not np.isfinite(values).all():
        raise DataError(
            f"{place}: must read 'class centre_x centre_y width height' or 'class x y x y x y ...', got {line!r}"
        )
    if values[0] != int(values[0]) or not 0 <= values[0] < class_count:
        raise DataError(f"{place}: class must be 0 to {class_count - 1}, got {fields[0]}")
    if (is_box and (values[3:] < 0).any()) or np.abs(values[1:]).max() > 10:
        raise DataError(
            f"{place}: width and height must not be negative and all be fractions of the image, not pixels; "
            f"got {line!r}"
        )
    if is_box:
        return np.concatenate([values[:1], xyxy_from_cxcywh(values[1:])])
    points = values[1:].reshape(-1, 2)
    return np.concatenate([values[:1], points.min(axis=0), points.max(axis=0)])


def _usable(rows: FloatArray) -> ImageLabels:
    """Labels from (n, 5) classes and corners, which may be anywhere."""
    _, first = np.unique(rows, axis=0, return_index=True)
    distinct = rows[np.sort(first)]
    corners = distinct[:, 1:]
    inside = np.clip(corners, 0.0, 1.0)
    sides = inside[:, 2:] - inside[:, :2]
    solid = (sides > 0).all(axis=1)
    return ImageLabels(
        class_ids=distinct[solid, 0].astype(np.int64),
        boxes_cxcywh=np.concatenate([inside[:, :2] + sides / 2, sides], axis=1)[solid],
        warnings=LabelWarnings(
            clipped_boxes=int((np.abs(inside - corners) > _OUTSIDE_TOLERANCE).any(axis=1).sum()),
            dropped_boxes=int((~solid).sum()),
            duplicate_boxes=len(rows) - len(distinct),
        ),
    )
