"""How large a network is and how much it computes."""

from typing import Any

import torch
from torch import Tensor, nn

from autolights.train.network.model import YoloV5

_NORM_FLOPS = 8  # for each normalised number: four operations, doubled


def gflops(model: YoloV5, size_wh: tuple[int, int]) -> float:
    """Floating-point operations for one image, in thousand millions, as the public figures of YOLOv5 are counted.

    Two for each multiply-add of a convolution and eight for each number that a batch norm puts out; folding the norms
    into the convolutions saves those (2 % of the nano). Nothing is computed: a twin without memory of its own is asked.

    Args:
        model: On any device.
        size_wh: Of the input; multiples of 32 pixels.

    References:
        thop, the counter of operations that the public trainer asks: https://github.com/Lyken17/pytorch-OpCounter
    """
    width, height = size_wh
    with torch.device("meta"):
        twin = YoloV5(model.size, len(model.classes), strides=model.strides).eval()
        image = torch.empty(1, 3, height, width)
    flops = 0

    def count(module: nn.Module, _inputs: Any, output: Tensor) -> None:
        nonlocal flops
        if isinstance(module, nn.Conv2d):
            flops += 2 * output.numel() * module.weight[0].numel()
        elif isinstance(module, nn.BatchNorm2d):
            flops += _NORM_FLOPS * output.numel()

    for module in twin.modules():
        module.register_forward_hook(count)
    with torch.no_grad():
        twin.logits(image)
    return flops / 1e9


def parameter_count(model: nn.Module, *, fused: bool = False) -> int:
    """How many numbers training changes.

    Args:
        model: On any device.
        fused: With each batch norm folded into its convolution, so that a bias remains of its scale and shift.
    """
    count = sum(parameter.numel() for parameter in model.parameters())
    if fused:
        count -= sum(module.num_features for module in model.modules() if isinstance(module, nn.BatchNorm2d))
    return count
