"""From the network's raw output to the lights of an image."""

import numpy as np

from autolights.core import Detections, FloatArray
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
    candidates = raw[raw[:, 4] >= score_threshold]
    scores = candidates[:, 4] * candidates[:, 5:].max(axis=1, initial=0.0)
    confident = scores >= score_threshold
    candidates, scores = candidates[confident].astype(np.float64), scores[confident]
    boxes_xyxy = xyxy_from_cxcywh(candidates[:, :4])
    kept = nms(boxes_xyxy, scores, iou_threshold=iou_threshold, max_boxes=max_detections)
    in_image = letterbox.boxes_to_image(boxes_xyxy[kept])
    detections = Detections(in_image, candidates[kept, 4], candidates[kept, 5:])
    return detections[area(in_image) > 0]  # what lay in the grey margin is nowhere in the image
