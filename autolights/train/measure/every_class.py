"""What a network says for COCO's average precision: each class of each cell, not only what the runtime reports."""

import numpy as np
import torch
from torch import Tensor
from torchvision.ops import batched_nms, box_convert

from autolights.infer.letterbox import Letterbox
from autolights.train.measure.predictions import Predictions

COCO_SCORE_THRESHOLD = 0.001
COCO_NMS_IOU_THRESHOLD = 0.6
COCO_MAX_DETECTIONS = 300
_MAX_CANDIDATES = 4096  # of the best enter the suppression; an untrained network would offer a hundred thousand


def decode_every_class(raw: Tensor, letterbox: Letterbox) -> Predictions:
    """Decode for COCO's average precision: each class of each cell is a detection of its own, suppressed by class.

    Args:
        raw: (N, 5 + C) of one image, on the CPU.
        letterbox: Where the image lies in the input.

    Returns:
        At most 300 predictions from a score of 0.001, in pixels of the image, best first.
    """
    raw = raw[raw[:, 4] >= COCO_SCORE_THRESHOLD]
    scores = raw[:, 4:5] * raw[:, 5:]
    cells, class_ids = torch.nonzero(scores >= COCO_SCORE_THRESHOLD, as_tuple=True)
    scores = scores[cells, class_ids]
    if len(scores) > _MAX_CANDIDATES:
        scores, best = scores.topk(_MAX_CANDIDATES)
        cells, class_ids = cells[best], class_ids[best]
    boxes = box_convert(raw[cells, :4], "cxcywh", "xyxy")
    kept = batched_nms(boxes, scores, class_ids, COCO_NMS_IOU_THRESHOLD)[:COCO_MAX_DETECTIONS]
    return Predictions(
        letterbox.boxes_to_image(boxes[kept].numpy().astype(np.float64)),
        class_ids[kept].numpy(),
        scores[kept].numpy(),
    )
