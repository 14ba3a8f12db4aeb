from types import SimpleNamespace

import numpy as np
import pytest

from autolights.core import Detections
from autolights.core.errors import AccuracyError
from autolights.train.deliver.sensitive_layers import choose_float_layers, disagreement

COSTS = {"stem": 0.1, "trunk": 0.5, "neck": 0.35, "head.0": 0.03, "head.1": 0.02}


class Losses:
    """A network whose layers' losses of AP50 add up."""

    def __init__(self, **losses):
        self.losses = {name.replace("_", "."): loss for name, loss in losses.items()}
        self.tried = []

    def evaluate(self, float_layers):
        self.tried.append(tuple(float_layers))
        lost = sum(self.losses.get(name, 0.0) for name in COSTS if name not in float_layers)
        return SimpleNamespace(ap50=0.9 - lost)

    def harm(self, layer):
        return 10 * self.losses.get(layer, 0.0)

    def choose(self, max_drop):
        return choose_float_layers(COSTS, self.evaluate, self.harm, float_ap50=0.9, max_drop=max_drop)


def test_nothing_stays_in_float_where_nothing_is_lost():
    choice = Losses(trunk=0.004).choose(0.01)

    assert (choice.float_layers, choice.harm, choice.metrics.ap50) == ((), {}, pytest.approx(0.896))
    assert choice.to_json()["ap50_by_float_layers"] == {"0": pytest.approx(0.896)}


def test_the_most_harmful_go_first_until_half_the_limit_is_kept():
    network = Losses(head_0=0.5, head_1=0.2, stem=0.012, neck=0.004)

    choice = network.choose(0.01)

    assert choice.float_layers == ("head.0", "head.1", "stem")
    assert network.tried == [(), ("head.0",), ("head.0", "head.1"), ("head.0", "head.1", "stem")]
    assert choice.metrics.ap50 == pytest.approx(0.896)
    assert choice.harm["head.0"] == 5
    assert list(choice.steps) == [0, 1, 2, 3]


def test_the_limit_itself_will_do_where_half_of_it_costs_the_network():
    network = Losses(head_0=0.1, trunk=0.008)

    choice = network.choose(0.01)

    # Leaving the trunk in float as well would keep half of the network from 8 bits.
    assert choice.float_layers == ("head.0",)
    assert choice.metrics.ap50 == pytest.approx(0.892)


def test_what_cannot_be_had_is_refused():
    with pytest.raises(
        AccuracyError,
        match=r"falls from 0\.9000 to 0\.8800, even with the 1 most sensitive of 5 layers in float; allowed is a loss "
        r"of 0\.01\. .* nothing was written",
    ):
        Losses(head_0=0.1, trunk=0.02).choose(0.01)


def lights(*rows):
    """Rows of left edge, objectness and two class probabilities; boxes are 10 x 10."""
    values = np.array(rows, dtype=float).reshape(-1, 4)
    left = values[:, :1]
    return Detections(np.hstack([left, 0 * left, left + 10, 0 * left + 10]), values[:, 1], values[:, 2:])


@pytest.mark.parametrize(
    ("got", "wanted"),
    [
        pytest.param(lights([0, 0.8, 1, 0], [50, 0.4, 0, 1]), 0.0, id="same"),
        pytest.param(lights(), 1.0, id="blind"),
        pytest.param(lights([0, 0.8, 0, 1], [50, 0.4, 1, 0]), 1.0, id="other-classes"),
        pytest.param(lights([0, 0.4, 1, 0], [50, 0.4, 0, 1]), 1 - 2 * 0.8 / 2.0, id="less-sure"),
        pytest.param(lights([2.5, 0.8, 1, 0], [50, 0.4, 0, 1]), 1 - 2 * (0.6 * 0.8 + 0.4) / 2.4, id="moved"),
        pytest.param(lights([0, 0.8, 1, 0], [50, 0.4, 0, 1], [90, 0.6, 1, 0]), 1 - 2 * 1.2 / 3.0, id="one-more"),
    ],
)
def test_disagreement(got, wanted):
    truth = lights([0, 0.8, 1, 0], [50, 0.4, 0, 1])

    assert disagreement([truth, lights()], [got, lights()]) == pytest.approx(wanted)


def test_two_that_see_nothing_agree():
    assert disagreement([lights()], [lights()]) == 0
