import pytest
import torch

from autolights.train.network.complexity import gflops, parameter_count
from autolights.train.network.model import FINE_STRIDES, YoloV5


@pytest.mark.parametrize(
    ("size", "parameters", "fused", "operations"),
    [
        ("n", 1_872_157, 1_867_405, 4.56),
        ("s", 7_235_389, 7_225_885, 16.62),
        ("m", 21_190_557, 21_172_173, 49.23),
        ("l", 46_563_709, 46_533_693, 109.58),
        ("x", 86_749_405, 86_705_005, 206.31),
    ],
)
def test_figures_are_the_published_ones(size, parameters, fused, operations):
    with torch.device("meta"):
        model = YoloV5(size, 80)

    assert (parameter_count(model), parameter_count(model, fused=True)) == (parameters, fused)
    assert gflops(model, (640, 640)) == pytest.approx(operations, abs=0.005)


def test_operations_follow_the_pixels_and_the_levels():
    model, fine = YoloV5("n", 13), YoloV5("n", 13, strides=FINE_STRIDES)

    assert gflops(model, (320, 160)) == pytest.approx(gflops(model, (640, 640)) / 8)
    assert 1.05 < gflops(fine, (64, 64)) / gflops(model, (64, 64)) < 1.2
