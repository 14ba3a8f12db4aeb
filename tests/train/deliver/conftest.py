import cv2
import numpy as np
import pytest
import torch
from torch import nn

from autolights.train.network.model import FINE_STRIDES, YoloV5
from autolights.train.network.weights import load_checkpoint, weights_path

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


@pytest.fixture(scope="session")
def base():
    """The shipped network: one that knows lights."""
    return load_checkpoint(weights_path("base")).eval()


@pytest.fixture(scope="session")
def street():
    """Eight heads before a grey sky."""
    image = np.full((192, 320, 3), (190, 175, 160), dtype=np.uint8)
    for i, (x, y) in enumerate((x, y) for y in (20, 110) for x in (30, 110, 190, 270)):
        width = 12 + i
        cv2.rectangle(image, (x, y), (x + width, y + 3 * width), (20, 25, 25), -1)
        for lamp in range(3):
            color = ((40, 40, 230), (40, 200, 230), (140, 230, 40))[lamp] if lamp == i % 3 else (30, 30, 35)
            centre = (x + width // 2, y + width // 2 + lamp * width)
            cv2.circle(image, centre, int(0.4 * width), color, -1, cv2.LINE_AA)
    return image


@pytest.fixture
def photo():
    return np.random.default_rng(1).integers(0, 256, (80, 140, 3), dtype=np.uint8)


def _lively(network):
    for convolution in network.detect.m:
        nn.init.normal_(convolution.weight, std=0.5)
        nn.init.normal_(convolution.bias, std=0.5)
    return network.eval()
