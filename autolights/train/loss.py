"""The detector's loss: boxes by CIoU, objectness and classes by cross-entropy."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor
from torchvision.ops import box_convert, complete_box_iou_loss

from autolights.train.assign import Assignment, assign
from autolights.train.config import LossConfig

_LEVEL_WEIGHTS = (4.0, 1.0, 0.4)  # fine levels have more cells, so each weighs less in the mean
_REFERENCE_SIDE_PX = 640
_REFERENCE_CLASSES = 80


@dataclass(frozen=True, eq=False)
class Losses:
    """Weighted parts of the loss, means over the batch; `total` is what is to be minimised.

    Attributes:
        box: 1 − CIoU of the positives.
        objectness: Over all cells.
        classes: Over the positives.
        total: Their sum times the images in the batch, so that gradients may be summed over batches.
    """

    box: Tensor
    objectness: Tensor
    classes: Tensor
    total: Tensor


def detection_loss(
    maps: Sequence[Tensor], labels: Tensor, anchors: Tensor, *, input_side_px: int, config: LossConfig
) -> Losses:
    """Compare the network's maps with labels, as published for YOLOv5.

    Args:
        maps: Per level (B, A, H, W, 5 + C) logits.
        labels: (n, 6) image index, class, centre x, centre y, width, height; the last four as fractions of the input.
        anchors: (levels, A, 2) in cells of the level.
        input_side_px: Long side of the input: small inputs have few cells, each with a larger share of the objects.
        config: Gains.

    Returns:
        The losses; finite for a batch without any label.

    References:
        Zheng et al. 2020, "Distance-IoU loss" (CIoU); YOLOv5 v6 for gains and weights.
    """
    box = objectness = classes = maps[0].new_zeros(())
    grid_sizes = [(logits.shape[3], logits.shape[2]) for logits in maps]
    assignments = assign(labels, anchors, grid_sizes)
    for logits, level_anchors, positives, weight in zip(
        maps, anchors, assignments, _LEVEL_WEIGHTS[: len(maps)], strict=True
    ):
        wanted = logits.new_zeros(logits.shape[:4])
        if len(positives):
            chosen = logits[positives.images, positives.anchors, positives.rows, positives.columns]
            ciou = _ciou(chosen, level_anchors[positives.anchors], positives)
            box = box + (1 - ciou).mean()
            _keep_best(wanted, positives, ciou.detach().clamp(min=0).to(wanted.dtype))
            one_hot = F.one_hot(positives.class_ids, chosen.shape[1] - 5).to(chosen.dtype)
            classes = classes + F.binary_cross_entropy_with_logits(chosen[:, 5:], one_hot)
        objectness = objectness + weight * F.binary_cross_entropy_with_logits(logits[..., 4], wanted)
    level_gain = 3 / len(maps)
    class_count = maps[0].shape[-1] - 5
    box = box * (config.box_gain * level_gain)
    objectness = objectness * (config.objectness_gain * level_gain * (input_side_px / _REFERENCE_SIDE_PX) ** 2)
    classes = classes * (config.class_gain * level_gain * class_count / _REFERENCE_CLASSES)
    total = (box + objectness + classes) * maps[0].shape[0]
    return Losses(box.detach(), objectness.detach(), classes.detach(), total)


def _ciou(logits: Tensor, anchors: Tensor, positives: Assignment) -> Tensor:
    """(m,) complete IoU of the decoded boxes with their labels, in [-1.5, 1]."""
    values = logits[:, :4].sigmoid()
    centres = values[:, :2] * 2 - 0.5
    sides = (values[:, 2:] * 2) ** 2 * anchors
    predicted = box_convert(torch.cat([centres, sides], dim=1), "cxcywh", "xyxy")
    loss: Tensor = complete_box_iou_loss(predicted, box_convert(positives.boxes, "cxcywh", "xyxy"))
    return 1 - loss


def _keep_best(wanted: Tensor, positives: Assignment, overlap: Tensor) -> None:
    """Write each positive's overlap into its cell; of several labels in one cell the best counts, in any order."""
    _, anchor_count, height, width = wanted.shape
    cell = ((positives.images * anchor_count + positives.anchors) * height + positives.rows) * width + positives.columns
    wanted.view(-1).scatter_reduce_(0, cell, overlap, reduce="amax")
