"""Draw detections on an image so that the light itself stays visible."""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from autolights.core import Detections, FloatArray, ImageArray, SignalSet

Bgr = tuple[int, int, int]
COLORS_BGR: dict[str, Bgr] = {"red": (66, 60, 240), "yellow": (30, 200, 255), "green": (110, 220, 70)}
DARK_BGR: Bgr = (225, 225, 225)  # nothing is lit
_OUTLINE_BGR: Bgr = (25, 25, 25)
_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.45
_MARGIN = 3  # units around a text
_ROWS = 12  # places above and below a box in which its text may go


def state_color(class_name: str, signals: SignalSet) -> Bgr:
    """The colour of a state: of its lit lamp, of several the one that permits most, light grey if none is lit."""
    lamps = signals.types[signals.type_of[class_name]].lamps
    lit = [lamps[name] for name in signals.state(class_name).lit]
    if not lit:
        return DARK_BGR
    return COLORS_BGR[max(lit, key=lambda lamp: ("stop", "caution", "go").index(lamp.meaning)).color]


def draw_detections(image_bgr: ImageArray, detections: Detections, signals: SignalSet) -> ImageArray:
    """Draw each box in its state's colour, with class and score beside it; see `draw_boxes`.

    Args:
        image_bgr: (H, W, 3) uint8; it is not changed.
        detections: In pixels of this image.
        signals: The signal description whose classes the detector knows.

    Returns:
        A new (H, W, 3) picture.
    """
    names = [signals.classes[i] for i in detections.class_ids]
    texts = [f"{name} {score:.2f}" for name, score in zip(names, detections.scores, strict=True)]
    return draw_boxes(image_bgr, detections.boxes_xyxy, texts, [state_color(name, signals) for name in names])


def draw_boxes(
    image_bgr: ImageArray, boxes_xyxy: FloatArray, texts: Sequence[str], colors: Sequence[Bgr]
) -> ImageArray:
    """Frame boxes and write a text beside each.

    Frames lie outside all boxes, and a text is put where it covers neither a box nor another text if there is such a
    place; a line leads to it when that is not beside the box.

    Args:
        image_bgr: (H, W, 3) uint8; it is not changed.
        boxes_xyxy: (n, 4) in pixels of this image.
        texts: One for each box.
        colors: One for each box.

    Returns:
        A new (H, W, 3) picture.
    """
    picture = image_bgr.copy()
    unit = max(1, round(max(picture.shape[:2]) / 1000))  # px; about one pixel when the picture fills a screen
    lights = [_whole_pixels(box) for box in boxes_xyxy]
    for (left, top, right, bottom), color in zip(lights, colors, strict=True):
        corners = (left - 2 * unit, top - 2 * unit), (right - 1 + 2 * unit, bottom - 1 + 2 * unit)
        cv2.rectangle(picture, *corners, _OUTLINE_BGR, 3 * unit)
        cv2.rectangle(picture, *corners, color, unit)
    plates: list[FloatArray] = []
    for box, text in zip(boxes_xyxy, texts, strict=True):
        size = _plate_size(text, unit)
        plates.append(_free_place(box, size, 4 * unit, picture.shape, np.array([*boxes_xyxy, *plates])))
    for box, plate, color in zip(boxes_xyxy, plates, colors, strict=True):
        _draw_leader(picture, box, plate, color, unit)
    for left, top, right, bottom in lights:  # neither frame nor line lies on any light
        picture[top:bottom, left:right] = image_bgr[top:bottom, left:right]
    for text, plate, color in zip(texts, plates, colors, strict=True):
        _draw_label(picture, text, plate, color, unit)
    return picture


def _plate_size(text: str, unit: int) -> FloatArray:
    (width, height), baseline = cv2.getTextSize(text, _FONT, _FONT_SCALE * unit, unit)
    return np.array([width, height + baseline], dtype=np.float64) + 2 * _MARGIN * unit


def _draw_label(picture: ImageArray, text: str, plate: FloatArray, color: Bgr, unit: int) -> None:
    """Write on a dark plate."""
    _, baseline = cv2.getTextSize(text, _FONT, _FONT_SCALE * unit, unit)
    left, top, right, bottom = (int(edge) for edge in np.round(plate))
    cv2.rectangle(picture, (left, top), (right, bottom), _OUTLINE_BGR, cv2.FILLED)
    at = (left + _MARGIN * unit, bottom - _MARGIN * unit - baseline)
    cv2.putText(picture, text, at, _FONT, _FONT_SCALE * unit, color, unit, cv2.LINE_AA)


def _draw_leader(picture: ImageArray, box: FloatArray, plate: FloatArray, color: Bgr, unit: int) -> None:
    """A line from a plate that is not beside its box to the nearest points of both."""
    at_box = np.clip((plate[:2] + plate[2:]) / 2, box[:2], box[2:])
    at_plate = np.clip(at_box, plate[:2], plate[2:])
    if np.linalg.norm(at_box - at_plate) <= 8 * unit:
        return
    start, end = ([round(float(value)) for value in point] for point in (at_box, at_plate))
    cv2.line(picture, start, end, _OUTLINE_BGR, 3 * unit, cv2.LINE_AA)
    cv2.line(picture, start, end, color, unit, cv2.LINE_AA)


def _free_place(
    box: FloatArray, size: FloatArray, gap: int, picture_shape: Sequence[int], occupied: FloatArray
) -> FloatArray:
    """The place nearest to the box that covers nothing, else the one that covers least; (4,) xyxy.

    Places are above, below and beside the box, in rows that go away from it; in each, with the left edges level, the
    right edges level, and pushed out to either side.
    """
    left, top, right, bottom = box
    width, height = size
    step = height + gap
    rows = np.arange(_ROWS) * step
    tops = np.concatenate([top - gap - height - rows, bottom + gap + rows, [top, bottom - height]])
    lefts = np.array([left - gap, right + gap - width, right + gap, left - gap - width, (left + right - width) / 2])
    corners = np.stack(np.meshgrid(lefts, tops), axis=-1).reshape(-1, 2)
    limits = np.array([picture_shape[1], picture_shape[0]]) - size
    corners = np.clip(corners, 0, np.maximum(limits, 0))
    plates = np.concatenate([corners, corners + size], axis=1)
    overlap = np.minimum(plates[:, None, 2:], occupied[:, 2:]) - np.maximum(plates[:, None, :2], occupied[:, :2])
    # Frames need room too, and a plate that touches another reads as one with it.
    covered = np.prod(np.maximum(overlap + gap - 1, 0), axis=2).sum(axis=1)
    away = np.linalg.norm(np.maximum(np.maximum(box[:2] - plates[:, 2:], plates[:, :2] - box[2:]), 0), axis=1)
    return np.asarray(plates[np.lexsort((away, covered))[0]])


def _whole_pixels(box: FloatArray) -> tuple[int, int, int, int]:
    """The pixels that a box touches: first and one past the last, across and down."""
    left, top = (max(math.floor(edge), 0) for edge in box[:2])
    right, bottom = (math.ceil(edge) for edge in box[2:])
    return left, top, right, bottom
