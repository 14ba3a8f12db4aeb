"""Draw detections on an image so that the light itself stays visible."""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from autolights.core import Detections, FloatArray, ImageArray, SignalSet
from autolights.core.boxes import iou_matrix

Bgr = tuple[int, int, int]
COLORS_BGR: dict[str, Bgr] = {"red": (66, 60, 240), "yellow": (30, 200, 255), "green": (110, 220, 70)}
DARK_BGR: Bgr = (225, 225, 225)  # nothing is lit
_OUTLINE_BGR: Bgr = (25, 25, 25)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


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
    place.

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
    for left, top, right, bottom in lights:  # no frame lies on any light
        picture[top:bottom, left:right] = image_bgr[top:bottom, left:right]
    occupied = [*boxes_xyxy]
    for box, text, color in zip(boxes_xyxy, texts, colors, strict=True):
        occupied.append(_draw_label(picture, text, box, color, unit, occupied))
    return picture


def _draw_label(
    picture: ImageArray, text: str, box: FloatArray, color: Bgr, unit: int, occupied: Sequence[FloatArray]
) -> FloatArray:
    """Write on a dark plate beside the box; returns the plate, (4,) xyxy."""
    scale = 0.45 * unit
    (text_width, text_height), baseline = cv2.getTextSize(text, _FONT, scale, unit)
    margin = 3 * unit
    size = np.array([text_width + 2 * margin, text_height + baseline + 2 * margin], dtype=np.float64)
    plate = _free_place(box, size, 4 * unit, picture.shape, occupied)
    left, top, right, bottom = (int(edge) for edge in np.round(plate))
    cv2.rectangle(picture, (left, top), (right, bottom), _OUTLINE_BGR, cv2.FILLED)
    cv2.putText(picture, text, (left + margin, bottom - margin - baseline), _FONT, scale, color, unit, cv2.LINE_AA)
    return plate


def _free_place(
    box: FloatArray, size: FloatArray, gap: int, picture_shape: Sequence[int], occupied: Sequence[FloatArray]
) -> FloatArray:
    """Above, below or beside the box: the first place that is free, else the one that overlaps least."""
    left, top, right, bottom = box
    width, height = size
    corners = np.array(
        [
            [left - gap, top - gap - height],
            [left - gap, bottom + gap],
            [right + gap - width, top - gap - height],
            [right + gap - width, bottom + gap],
            [right + gap, top],
            [left - gap - width, top],
        ]
    )
    limits = np.array([picture_shape[1], picture_shape[0]]) - size
    corners = np.clip(corners, 0, np.maximum(limits, 0))
    plates = np.concatenate([corners, corners + size], axis=1)
    covered = iou_matrix(plates, np.array(occupied)).sum(axis=1)
    return np.asarray(plates[int(np.argmin(covered))])


def _whole_pixels(box: FloatArray) -> tuple[int, int, int, int]:
    """The pixels that a box touches: first and one past the last, across and down."""
    left, top = (max(math.floor(edge), 0) for edge in box[:2])
    right, bottom = (math.ceil(edge) for edge in box[2:])
    return left, top, right, bottom
