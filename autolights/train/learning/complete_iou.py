"""Overlap of boxes that also tells boxes apart which do not meet: what the network's boxes are trained by."""

import math

import torch
from torch import Tensor

_EPSILON = 1e-7


def complete_iou(predicted: Tensor, wanted: Tensor) -> Tensor:
    """IoU, less how far the centres lie apart and how much the aspect ratios differ.

    torchvision's `complete_box_iou_loss` takes corners: the height of a flat box is then a difference that rounds to
    zero, and its gradient is not a number. Here sides stay sides, and any positive one has a finite gradient.

    Args:
        predicted: (m, 4) centre x and y, width, height.
        wanted: (m, 4) likewise; sides above 0.

    Returns:
        (m,) complete IoU in [-1.5, 1].

    References:
        Zheng et al. 2020, "Distance-IoU loss": CIoU, with the weight of the aspect term held constant.
    """
    centres, sides = predicted[:, :2], predicted[:, 2:]
    wanted_centres, wanted_sides = wanted[:, :2], wanted[:, 2:]
    lows, highs = centres - sides / 2, centres + sides / 2
    wanted_lows, wanted_highs = wanted_centres - wanted_sides / 2, wanted_centres + wanted_sides / 2
    common = (torch.minimum(highs, wanted_highs) - torch.maximum(lows, wanted_lows)).clamp(min=0).prod(dim=1)
    iou = common / (sides.prod(dim=1) + wanted_sides.prod(dim=1) - common + _EPSILON)

    enclosing = torch.maximum(highs, wanted_highs) - torch.minimum(lows, wanted_lows)
    distance = (centres - wanted_centres).square().sum(dim=1) / (enclosing.square().sum(dim=1) + _EPSILON)
    # atan2(w, h) is atan(w / h) without the division.
    angles = torch.atan2(wanted_sides[:, 0], wanted_sides[:, 1]) - torch.atan2(sides[:, 0], sides[:, 1])
    aspect = 4 / math.pi**2 * angles.square()
    with torch.no_grad():
        aspect_weight = aspect / (1 - iou + aspect + _EPSILON)
    return iou - distance - aspect_weight * aspect
