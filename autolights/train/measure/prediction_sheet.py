"""A picture of validation images: on the left what is labelled, on the right what the runtime would report."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray
from autolights.core.atomic import new_file
from autolights.core.boxes import match_boxes
from autolights.infer.draw import Bgr, draw_boxes
from autolights.train.measure.predictions import Labels, Predictions
from autolights.train.measure.validate import DatasetDetections

_IOU_THRESHOLD = 0.5
_PANEL_WIDTH_PX = 600
_GAP_PX, _LEGEND_PX = 8, 34
_MIN_WINDOW = 0.25  # of the image: a single light is still seen in its surroundings
_MARGIN = 1.3  # of the window around all boxes: room for their texts
_PAPER_BGR, _INK_BGR = (255, 255, 255), (38, 31, 26)
_RIGHT_BGR, _WRONG_BGR = (128, 222, 74), (36, 178, 255)
_FALSE_BGR, _MISSED_BGR = (222, 90, 255), (80, 80, 255)
_LEGEND = (("right", _RIGHT_BGR), ("other class", _WRONG_BGR), ("missed", _MISSED_BGR), ("false alarm", _FALSE_BGR))


def prediction_sheet(detections: DatasetDetections, *, count: int = 8) -> ImageArray:
    """Show some validation images, cut to where lights are.

    Args:
        detections: Labels and detections of the images; the pictures are read again.
        count: How many, spread evenly over those that hold labels (over all if none does).

    Returns:
        RGB: two images in a row, of each the labels on the left and the detections on the right.
    """
    labelled = [i for i, truth in enumerate(detections.labels) if len(truth.class_ids)]
    candidates = labelled or list(range(len(detections.labels)))
    chosen = np.linspace(0, len(candidates) - 1, min(count, len(candidates))).round().astype(int)
    panel_wh: tuple[int, int] | None = None
    pairs: list[ImageArray] = []
    for i in (candidates[k] for k in chosen):
        image_bgr = detections.dataset.read(detections.indices[i])
        panel_wh = panel_wh or _panel_size(image_bgr)
        seen = detections.reported[i].above(detections.score_threshold)
        pairs.append(_draw_pair(image_bgr, detections.labels[i], seen, detections.dataset.classes, panel_wh))
    if len(pairs) > 1 and len(pairs) % 2:
        pairs.append(np.full_like(pairs[0], _PAPER_BGR))
    rows = [np.concatenate(pairs[i : i + 2], axis=1) for i in range(0, len(pairs), 2)]
    sheet = np.concatenate([_draw_legend(rows[0].shape[1]), *rows])
    return np.asarray(cv2.cvtColor(sheet, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def save_sheet(detections: DatasetDetections, path: Path) -> None:
    """Write the sheet, e.g. ``predictions.jpg``; see `prediction_sheet`."""
    encoded, data = cv2.imencode(path.suffix, cv2.cvtColor(prediction_sheet(detections), cv2.COLOR_RGB2BGR))
    assert encoded
    with new_file(path) as temporary:
        temporary.write_bytes(data.tobytes())


def _panel_size(image_bgr: ImageArray) -> tuple[int, int]:
    """Of the image's shape, at most square."""
    height, width = image_bgr.shape[:2]
    return _PANEL_WIDTH_PX, min(round(_PANEL_WIDTH_PX * height / width), _PANEL_WIDTH_PX)


def _draw_pair(
    image_bgr: ImageArray, truth: Labels, seen: Predictions, classes: Sequence[str], panel_wh: tuple[int, int]
) -> ImageArray:
    """Both panels of one image, with a margin right of and below each."""
    label_colors, seen_colors = [_MISSED_BGR] * len(truth.class_ids), [_FALSE_BGR] * len(seen.class_ids)
    for row, column in zip(*match_boxes(truth.boxes_xyxy, seen.boxes_xyxy, iou_threshold=_IOU_THRESHOLD), strict=True):
        is_right = truth.class_ids[row] == seen.class_ids[column]
        label_colors[row] = seen_colors[column] = _RIGHT_BGR if is_right else _WRONG_BGR
    names = [classes[i] for i in truth.class_ids]
    scored = [f"{classes[i]} {score:.2f}" for i, score in zip(seen.class_ids, seen.scores, strict=True)]
    window = _window(np.concatenate([truth.boxes_xyxy, seen.boxes_xyxy]), image_bgr, panel_wh)
    panels = [
        _draw_panel(image_bgr, window, panel_wh, truth.boxes_xyxy, names, label_colors),
        _draw_panel(image_bgr, window, panel_wh, seen.boxes_xyxy, scored, seen_colors),
    ]
    framed = [cv2.copyMakeBorder(p, 0, _GAP_PX, 0, _GAP_PX, cv2.BORDER_CONSTANT, value=_PAPER_BGR) for p in panels]
    return np.concatenate(framed, axis=1, dtype=np.uint8)


def _window(boxes_xyxy: FloatArray, image_bgr: ImageArray, panel_wh: tuple[int, int]) -> tuple[int, int, int, int]:
    """The part of the image that shows all boxes, of the panel's shape if the image has room for it; whole pixels."""
    image_wh = np.array([image_bgr.shape[1], image_bgr.shape[0]], dtype=np.float64)
    if not len(boxes_xyxy):
        return 0, 0, int(image_wh[0]), int(image_wh[1])
    lows, highs = boxes_xyxy[:, :2].min(axis=0), boxes_xyxy[:, 2:].max(axis=0)
    wanted = np.maximum((highs - lows) * _MARGIN, image_wh * _MIN_WINDOW)
    scale = (wanted / panel_wh).max()
    size = np.minimum(np.multiply(panel_wh, scale), image_wh)
    corner = np.clip((lows + highs - size) / 2, 0, image_wh - size)
    left, top = np.floor(corner).astype(int).tolist()
    right, bottom = np.ceil(corner + size).astype(int).tolist()
    return left, top, min(right, image_bgr.shape[1]), min(bottom, image_bgr.shape[0])


def _draw_panel(
    image_bgr: ImageArray,
    window: tuple[int, int, int, int],
    panel_wh: tuple[int, int],
    boxes_xyxy: FloatArray,
    texts: Sequence[str],
    colors: Sequence[Bgr],
) -> ImageArray:
    """The window as large as the panel allows, boxes drawn in."""
    left, top, right, bottom = window
    scale = min(panel_wh[0] / (right - left), panel_wh[1] / (bottom - top))
    scaled_wh = max(round((right - left) * scale), 1), max(round((bottom - top) * scale), 1)
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    view = np.asarray(cv2.resize(image_bgr[top:bottom, left:right], scaled_wh, interpolation=interpolation))
    panel = np.full((panel_wh[1], panel_wh[0], 3), _PAPER_BGR, dtype=np.uint8)
    in_view = (boxes_xyxy - np.tile([left, top], 2)) * scale
    panel[: scaled_wh[1], : scaled_wh[0]] = draw_boxes(view.astype(np.uint8), in_view, texts, colors)
    return panel


def _draw_legend(width_px: int) -> ImageArray:
    strip = np.full((_LEGEND_PX, width_px, 3), _PAPER_BGR, dtype=np.uint8)
    x = 4
    for text, color in (("left: labels, right: detections", _INK_BGR), *_LEGEND):
        if text in dict(_LEGEND):
            cv2.rectangle(strip, (x, 9), (x + 14, 23), color, cv2.FILLED)
            x += 22
        cv2.putText(strip, text, (x, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _INK_BGR, 1, cv2.LINE_AA)
        x += cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)[0][0] + 24
    return strip
