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
    limits = anchors.new_tensor(grid_sizes_wh)  # (levels, 2)
    sides = labels[None, :, 4:6] * limits[:, None, :]
    ratios = sides[:, :, None, :] / anchors[:, None, :, :]
    fits = torch.maximum(ratios, 1 / ratios).amax(dim=3) < MAX_SIDE_RATIO
    # All levels at once, sorted by level; each search waits for the device, so there are but two.
    level_index, label_index, anchor_index = torch.nonzero(fits, as_tuple=True)
    limits = limits[level_index]
    centres = labels[label_index, 2:4] * limits
    neighbours = centres.new_tensor(_NEIGHBOURS)
    pair_index, neighbour_index = torch.nonzero(_answering(centres, limits), as_tuple=True)
    level_index, label_index, anchor_index = level_index[pair_index], label_index[pair_index], anchor_index[pair_index]
    centres, limits = centres[pair_index], limits[pair_index]
    # A centre on the input's far edge would floor to a cell that does not exist.
    cells = torch.minimum((centres + neighbours[neighbour_index]).floor(), limits - 1).clamp_(min=0)
    boxes = torch.cat([centres - cells, labels[label_index, 4:6] * limits], dim=1)
    image_ids, class_ids = labels[label_index, :2].long().unbind(dim=1)
    columns, rows = cells.long().unbind(dim=1)
    per_level = torch.bincount(level_index, minlength=len(anchors)).tolist()
    fields = (image_ids, anchor_index, rows, columns, boxes, class_ids)
    return [Assignment(*level) for level in zip(*(torch.split(field, per_level) for field in fields), strict=True)]


# Where the answering cell is looked for, in cells from the label's centre: its own, left, upper, right, lower.
_NEIGHBOURS = ((0.0, 0.0), (-0.5, 0.0), (0.0, -0.5), (0.5, 0.0), (0.0, 0.5))


def _answering(centres: Tensor, limits: Tensor) -> Tensor:
    """(m, 5) which of `_NEIGHBOURS` answer for centres in a grid of these limits."""
    from_far_edge = limits - centres
    # (m, 2) in x and y: the lower (left, upper) or the higher (right, lower) neighbour is the nearer one and exists.
    lower = (centres % 1 < 0.5) & (centres > 1)
    higher = (from_far_edge % 1 < 0.5) & (from_far_edge > 1)
    return torch.cat([torch.ones_like(lower[:, :1]), lower, higher], dim=1)
