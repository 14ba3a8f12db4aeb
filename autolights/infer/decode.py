"""From the network's outputs to the lights of an image."""

from collections.abc import Sequence

import numpy as np

from autolights.core import Detections, FloatArray, ModelInfo
from autolights.core.boxes import area, nms, xyxy_from_cxcywh
from autolights.infer.letterbox import Letterbox

NMS_IOU_THRESHOLD = 0.5
MAX_DETECTIONS = 100


def decode(
    raw: FloatArray,
    letterbox: Letterbox,
    *,
    score_threshold: float,
    iou_threshold: float = NMS_IOU_THRESHOLD,
    max_detections: int = MAX_DETECTIONS,
) -> Detections:
    """Keep the best box of each light, with its whole class vector.

    Suppression does not look at classes: a washed-out head must not become a red and a yellow light.

    Args:
        raw: (N, 5 + C) centre x, y, width, height in input pixels, objectness, class probabilities.
        letterbox: Where the image lies in the input.
        score_threshold: On objectness times the largest class probability.
        iou_threshold: Of two boxes that overlap more than this the worse one goes.
        max_detections: Of the best are kept.

    Returns:
        Detections in pixels of the image, cut at its edges, best first.
    """
    # Class probabilities are at most 1, so objectness alone rules out nearly all cells before anything is copied.
    candidates = raw[np.flatnonzero(raw[:, 4] >= score_threshold)].astype(np.float32, copy=False)
    scores = candidates[:, 4] * candidates[:, 5:].max(axis=1, initial=0.0)
    confident = np.flatnonzero(scores >= score_threshold)
    candidates = candidates[confident]
    boxes_xyxy = xyxy_from_cxcywh(candidates[:, :4])
    kept = nms(boxes_xyxy, scores[confident], iou_threshold=iou_threshold, max_boxes=max_detections)
    candidates = candidates[kept]
    return _in_image(boxes_xyxy[kept], candidates[:, 4], candidates[:, 5:], letterbox)


def decode_chosen(
    boxes_xyxy: FloatArray,
    scores: FloatArray,
    class_probs: FloatArray,
    letterbox: Letterbox,
    *,
    score_threshold: float,
) -> Detections:
    """Read the detections that the network's graph has chosen itself.

    Args:
        boxes_xyxy: (K, 4) in input pixels.
        scores: (K,) objectness times the largest class probability; 0 where there is nothing.
        class_probs: (K, C).
        letterbox: Where the image lies in the input.
        score_threshold: On `scores`.

    Returns:
        Detections in pixels of the image, cut at its edges, in the order of the network: best first.
    """
    kept = np.flatnonzero(scores >= score_threshold)
    class_probs = class_probs[kept].astype(np.float32, copy=False)
    largest = class_probs.max(axis=1, initial=np.finfo(np.float32).tiny)
    objectness = np.minimum(scores[kept] / largest, 1.0)  # halves round
    return _in_image(boxes_xyxy[kept].astype(np.float32, copy=False), objectness, class_probs, letterbox)


def decode_outputs(
    outputs: Sequence[FloatArray], index: int, letterbox: Letterbox, info: ModelInfo, *, score_threshold: float
) -> Detections:
    """Decode one image of a batch by the model's head.

    Args:
        outputs: What a session returned.
        index: Of the image in the batch.
        letterbox: Where the image lies in the input.
        info: Head and settings of the suppression.
        score_threshold: On objectness times the largest class probability.
    """
    if info.head == "end2end":
        boxes_xyxy, scores, class_probs = (output[index] for output in outputs)
        return decode_chosen(boxes_xyxy, scores, class_probs, letterbox, score_threshold=score_threshold)
    return decode(
        outputs[0][index],
        letterbox,
        score_threshold=score_threshold,
        iou_threshold=info.nms_iou_threshold,
        max_detections=info.max_detections,
    )


def _in_image(
    boxes_xyxy: FloatArray, objectness: FloatArray, class_probs: FloatArray, letterbox: Letterbox
) -> Detections:
    in_image = letterbox.boxes_to_image(boxes_xyxy)
    there = area(in_image) > 0  # what lay in the grey margin is nowhere in the image
    if not there.all():
        in_image, objectness, class_probs = in_image[there], objectness[there], class_probs[there]
    return Detections(in_image, objectness.astype(np.float64), class_probs.astype(np.float64))
