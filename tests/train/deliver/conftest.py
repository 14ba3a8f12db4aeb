import numpy as np
import pytest
import torch
from torch import nn

from autolights.train.network.model import FINE_STRIDES, YoloV5

CLASSES = ("3-red", "3-green", "3-yellow")


@pytest.fixture(scope="session")
def model():
    """A nano whose weights and statistics are anything but zero, and that finds something everywhere."""
    torch.manual_seed(0)
    network = YoloV5("n", len(CLASSES), CLASSES)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.1)
            module.running_var.uniform_(0.5, 1.5)
    return _lively(network)


@pytest.fixture(scope="session")
def fine_model():
    """One with a level of stride 4 and anchors of its own."""
    torch.manual_seed(1)
    network = _lively(YoloV5("n", 2, strides=FINE_STRIDES))
    network.set_anchors(torch.arange(4.0, 28.0).view(4, 3, 2))
    return network


@pytest.fixture
def photo():
    return np.random.default_rng(1).integers(0, 256, (80, 140, 3), dtype=np.uint8)


def _lively(network):
    for convolution in network.detect.m:
        nn.init.normal_(convolution.weight, std=0.5)
        nn.init.normal_(convolution.bias, std=0.5)
    return network.eval()
