"""Which cells and anchors answer for a label."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

MAX_SIDE_RATIO = 4.0  # (2σ)² reaches at most 4 times an anchor's side


@dataclass(frozen=True, eq=False)
class Assignment:
    """The positives of one level, a row for each.

    Attributes:
        images: (m,) index in the batch.
        anchors: (m,) index of the anchor.
        rows: (m,) cell's y.
        columns: (m,) cell's x.
        boxes: (m, 4) the label: centre relative to the cell's corner, width and height; in cells.
        class_ids: (m,) the label's class.
    """

    images: Tensor
    anchors: Tensor
    rows: Tensor
    columns: Tensor
    boxes: Tensor
    class_ids: Tensor

    def __len__(self) -> int:
        return len(self.images)


def assign(labels: Tensor, anchors: Tensor, grid_sizes_wh: Sequence[tuple[int, int]]) -> list[Assignment]:
    """Choose the positives of each level, as in YOLOv5.

    An anchor takes part if neither side differs from the label's by a factor of 4 or more. Beside the cell that holds
    the centre, the nearer neighbour in x and the nearer one in y answer too, unless they lie beyond the edge.

    Args:
        labels: (n, 6) image index, class, centre x, centre y, width, height; the last four as fractions of the input.
        anchors: (levels, A, 2) width and height in cells of the level.
        grid_sizes_wh: Per level its width and height in cells.

    Returns:
        One assignment per level.

    References:
        The assignment of YOLOv5 v6 (https://github.com/ultralytics/yolov5), described in its documentation.
    """
    return [
        _assign_level(labels, level_anchors, size_wh)
        for level_anchors, size_wh in zip(anchors, grid_sizes_wh, strict=True)
    ]


def _assign_level(labels: Tensor, anchors: Tensor, size_wh: tuple[int, int]) -> Assignment:
    limits = labels.new_tensor(size_wh)
    sides = labels[:, 4:6] * limits
    ratios = sides[:, None, :] / anchors[None, :, :]
    fits = torch.maximum(ratios, 1 / ratios).amax(dim=2) < MAX_SIDE_RATIO
    label_index, anchor_index = torch.nonzero(fits, as_tuple=True)

    centres = labels[label_index, 2:4] * limits
    from_far_edge = limits - centres
    # (m, 2) in x and y: the lower (left, upper) or the higher (right, lower) neighbour is the nearer one and exists.
    lower = (centres % 1 < 0.5) & (centres > 1)
    higher = (from_far_edge % 1 < 0.5) & (from_far_edge > 1)
    half_x, half_y = centres.new_tensor([0.5, 0.0]), centres.new_tensor([0.0, 0.5])
    choices = (
        (torch.ones_like(lower[:, 0]), torch.zeros_like(half_x)),
        (lower[:, 0], -half_x),
        (lower[:, 1], -half_y),
        (higher[:, 0], half_x),
        (higher[:, 1], half_y),
    )
    picked = torch.cat([torch.nonzero(mask).flatten() for mask, _ in choices])
    shifts = torch.cat([shift.expand(int(mask.sum()), 2) for mask, shift in choices])
    label_index, anchor_index, centres = label_index[picked], anchor_index[picked], centres[picked]
    # A centre on the input's far edge would floor to a cell that does not exist.
    cells = torch.minimum((centres + shifts).floor(), limits - 1).clamp_(min=0)
    return Assignment(
        images=labels[label_index, 0].long(),
        anchors=anchor_index,
        rows=cells[:, 1].long(),
        columns=cells[:, 0].long(),
        boxes=torch.cat([centres - cells, sides[label_index]], dim=1),
        class_ids=labels[label_index, 1].long(),
    )
