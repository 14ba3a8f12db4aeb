import math

import pytest
import torch

from autolights.train.config import OptimizerConfig
from autolights.train.learning.ema import WeightAverage
from autolights.train.learning.optimizer import build_optimizer, set_rates
from autolights.train.learning.schedule import Rates
from autolights.train.network.model import YoloV5


@pytest.mark.parametrize("kind", ["sgd", "adamw"])
def test_only_convolution_weights_decay(kind):
    model = YoloV5("n", 3)
    optimizer = build_optimizer(model, OptimizerConfig(kind=kind), weight_decay=0.1)

    groups = {group["name"]: group for group in optimizer.param_groups}
    assert {name: group["weight_decay"] for name, group in groups.items()} == {"decayed": 0.1, "norms": 0, "biases": 0}
    assert all(p.ndim == 4 for p in groups["decayed"]["params"])
    assert sum(len(group["params"]) for group in groups.values()) == len(list(model.parameters()))
    assert len({id(p) for group in groups.values() for p in group["params"]}) == len(list(model.parameters()))
    assert len(groups["norms"]["params"]) == 57
    assert len(groups["biases"]["params"]) == 57 + 3


def test_rates_reach_their_groups():
    for kind, momentum in (("sgd", lambda group: group["momentum"]), ("adamw", lambda group: group["betas"][0])):
        optimizer = build_optimizer(YoloV5("n", 1), OptimizerConfig(kind=kind), weight_decay=0)

        set_rates(optimizer, Rates(rate=0.01, bias_rate=0.1, momentum=0.85))

        assert [group["lr"] for group in optimizer.param_groups] == [0.01, 0.01, 0.1]
        assert [momentum(group) for group in optimizer.param_groups] == [0.85] * 3


def test_average_in_closed_form():
    model = YoloV5("n", 1)
    average = WeightAverage(model, decay=0.9, ramp_steps=2.0)
    start = model.model[0].conv.weight.detach().clone()

    expected = start
    for step in (1, 2):
        with torch.no_grad():
            model.model[0].conv.weight.copy_(start + step)
            model.model[0].bn.num_batches_tracked.fill_(step)
        average.update(model)
        decay = 0.9 * (1 - math.exp(-step / 2))
        expected = decay * expected + (1 - decay) * (start + step)

    torch.testing.assert_close(average.model.model[0].conv.weight, expected)
    assert average.model.model[0].bn.num_batches_tracked == 2
    assert not average.model.training
    assert model.model[0].conv.weight.requires_grad
