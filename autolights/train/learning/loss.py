"""The detector's loss: boxes by CIoU, objectness and classes by cross-entropy."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor
from torchvision.ops import sigmoid_focal_loss

from autolights.train.config import LossConfig
from autolights.train.learning.assign import Assignment, assign
from autolights.train.learning.complete_iou import complete_iou
from autolights.train.processes import ALONE, Processes

# By stride: fine levels have more cells, so each of their cells weighs less in the mean.
_LEVEL_WEIGHTS = {8: 4.0, 16: 1.0, 32: 0.4}
_FINE_LEVEL_WEIGHTS = {4: 4.0, 8: 1.0, 16: 0.25, 32: 0.06}
_REFERENCE_SIDE_PX = 640
_REFERENCE_CLASSES = 80
_REFERENCE_LEVELS = 3


@dataclass(frozen=True, eq=False)
class Losses:
    """Weighted parts of the loss.

    Attributes:
        box: 1 − CIoU of the positives; like the next two a mean over the images of all processes.
        objectness: Over all cells.
        classes: Over the positives.
        total: What this process is to minimise. Its mean over the processes is the sum of the parts times the images of
            all, so that gradients may be averaged over processes and summed over batches.
    """

    box: Tensor
    objectness: Tensor
    classes: Tensor
    total: Tensor


def class_weights(counts: Sequence[int], power: float) -> Tensor:
    """Weights that let rare classes count more.

    Args:
        counts: Labels of each class in the training data.
        power: 0: all alike; 1: each class as much as any other.

    Returns:
        (C,) proportional to counts^−power, their mean over the labels 1.
    """
    labels = torch.tensor(counts, dtype=torch.float64)
    weights = labels.clamp(min=1) ** -power  # the weight of a class without labels never counts
    return (weights * (labels.sum() / (weights * labels).sum())).float() if labels.sum() else weights.float()


def detection_loss(
    maps: Sequence[Tensor],
    labels: Tensor,
    anchors: Tensor,
    *,
    strides: Sequence[int],
    input_side_px: int,
    config: LossConfig,
    class_weights: Tensor | None = None,
    processes: Processes = ALONE,
) -> Losses:
    """Compare the network's maps with labels, as published for YOLOv5.

    Computed in single precision whatever the maps are. Means are over the positives and cells of all processes: the
    gradients that they average are those of one process with all their images.

    Args:
        maps: Per level (B, A, H, W, 5 + C) logits.
        labels: (n, 6) image index, class, centre x, centre y, width, height; the last four as fractions of the input.
        anchors: (levels, A, 2) in cells of the level.
        strides: Of the levels, pixels.
        input_side_px: Long side of the input: small inputs have few cells, each with a larger share of the objects.
        config: Gains, label smoothing and focal exponent.
        class_weights: (C,) how much a positive of each class counts in the class loss; None: all 1.
        processes: That train together.

    Returns:
        The losses; finite for a batch without any label.

    References:
        Zheng et al. 2020, "Distance-IoU loss" (CIoU); Lin et al. 2017, "Focal loss"; YOLOv5 v6 for gains and weights.
    """
    grid_sizes = [(logits.shape[3], logits.shape[2]) for logits in maps]
    assignments = assign(labels, anchors, grid_sizes)
    counts = _Counts.over(processes, maps, assignments)
    level_weights = _FINE_LEVEL_WEIGHTS if min(strides) == 4 else _LEVEL_WEIGHTS
    box = objectness = classes = maps[0].new_zeros((), dtype=torch.float32)
    for level, (logits, positives, stride) in enumerate(zip(maps, assignments, strides, strict=True)):
        wanted = torch.zeros(logits.shape[:4], device=logits.device)
        if len(positives):
            chosen = logits[positives.images, positives.anchors, positives.rows, positives.columns].float()
            ciou = _ciou(chosen, anchors[level, positives.anchors], positives)
            box = box + (1 - ciou).sum() / counts.positives[level]
            _keep_best(wanted, positives, ciou.detach().clamp(min=0))
            by_class = _class_losses(chosen[:, 5:], positives.class_ids, config, class_weights)
            classes = classes + by_class.sum() / (counts.positives[level] * by_class.shape[1])
        cells = _cross_entropy(logits[..., 4].float(), wanted, config.focal_gamma)
        objectness = objectness + level_weights[stride] * cells.sum() / counts.cells[level]

    level_gain = _REFERENCE_LEVELS / len(maps)
    class_count = maps[0].shape[-1] - 5
    box = box * (config.box_gain * level_gain)
    objectness = objectness * (config.objectness_gain * level_gain * (input_side_px / _REFERENCE_SIDE_PX) ** 2)
    classes = classes * (config.class_gain * level_gain * class_count / _REFERENCE_CLASSES)
    parts = torch.stack([box, objectness, classes])
    means = processes.sum(parts.detach())
    return Losses(means[0], means[1], means[2], parts.sum() * counts.images * processes.size)


@dataclass(frozen=True, eq=False)
class _Counts:
    """What the means are over, summed over the processes.

    Attributes:
        positives: (levels,), at least 1.
        cells: (levels,) anchors × cells × images.
        images: Scalar.
    """

    positives: Tensor
    cells: Tensor
    images: Tensor

    @classmethod
    def over(cls, processes: Processes, maps: Sequence[Tensor], assignments: Sequence[Assignment]) -> "_Counts":
        counts = [len(positives) for positives in assignments]
        cells = [logits.shape[:4].numel() for logits in maps]
        # Double precision: single counts cells one by one only up to 2^24.
        local = torch.tensor([*counts, *cells, len(maps[0])], dtype=torch.float64, device=maps[0].device)
        everywhere = processes.sum(local).float()
        return cls(everywhere[: len(maps)].clamp(min=1), everywhere[len(maps) : -1], everywhere[-1])


def _ciou(logits: Tensor, anchors: Tensor, positives: Assignment) -> Tensor:
    """(m,) complete IoU of the decoded boxes with their labels, in [-1.5, 1]."""
    values = logits[:, :4].sigmoid()
    centres = values[:, :2] * 2 - 0.5
    sides = (values[:, 2:] * 2) ** 2 * anchors
    return complete_iou(torch.cat([centres, sides], dim=1), positives.boxes)


def _keep_best(wanted: Tensor, positives: Assignment, overlap: Tensor) -> None:
    """Write each positive's overlap into its cell; of several labels in one cell the best counts, in any order."""
    _, anchor_count, height, width = wanted.shape
    cell = ((positives.images * anchor_count + positives.anchors) * height + positives.rows) * width + positives.columns
    wanted.view(-1).scatter_reduce_(0, cell, overlap, reduce="amax")


def _class_losses(logits: Tensor, class_ids: Tensor, config: LossConfig, weights: Tensor | None) -> Tensor:
    """(m, C) each class of each positive."""
    wanted = F.one_hot(class_ids, logits.shape[1]).to(logits.dtype)
    wanted = wanted * (1 - config.label_smoothing) + config.label_smoothing / 2
    losses = _cross_entropy(logits, wanted, config.focal_gamma)
    return losses if weights is None else losses * weights[class_ids, None]


def _cross_entropy(logits: Tensor, wanted: Tensor, focal_gamma: float) -> Tensor:
    """Element by element; times (1 − p)^γ, p the probability given to what is wanted."""
    if focal_gamma == 0:
        return F.binary_cross_entropy_with_logits(logits, wanted, reduction="none")
    focal: Tensor = sigmoid_focal_loss(logits, wanted, alpha=-1, gamma=focal_gamma)  # -1: positives weigh no less
    return focal
