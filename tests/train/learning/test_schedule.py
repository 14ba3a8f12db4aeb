import itertools
import math

import pytest

from autolights.core import parse_config
from autolights.core.errors import ConfigError
from autolights.train.config import ScheduleConfig
from autolights.train.learning.schedule import Schedule


def schedule(steps=40, steps_per_epoch=4, **settings):
    settings = {"warmup_epochs": 0, **settings}
    return Schedule(ScheduleConfig(**settings), steps, steps_per_epoch, momentum=0.937)


def test_two_cycles_fall_from_maximum_to_minimum():
    rates = [schedule().annealed(step) for step in range(40)]

    assert rates[0] == rates[20] == pytest.approx(0.008)
    assert rates[19] == rates[39] == pytest.approx(0.00008)
    assert all(a > b for i, (a, b) in enumerate(itertools.pairwise(rates)) if i != 19)
    assert rates[5] == pytest.approx(0.00008 + 0.00396 * (1 + math.cos(math.pi * 5 / 19)))


@pytest.mark.parametrize(("steps", "cycles"), [(7, 3), (5, 5), (2, 3), (1, 1), (100, 7)])
def test_every_run_ends_on_the_minimum(steps, cycles):
    assert schedule(steps, cycles=cycles).annealed(steps - 1) == pytest.approx(0.00008)


def test_cosine_is_one_cycle():
    one = schedule(kind="cosine", max_rate=0.002, min_rate=0.0)

    assert one.annealed(0) == 0.002
    assert one.annealed(20) == pytest.approx(0.001 * (1 + math.cos(math.pi * 20 / 39)))


def test_linear_is_a_straight_line():
    line = schedule(kind="linear", max_rate=0.01, min_rate=0.0001)

    assert [line.annealed(step) for step in (0, 13, 39)] == pytest.approx([0.01, 0.01 - 0.0099 / 3, 0.0001])


def test_warmup_is_linear_in_rate_and_momentum():
    warm = schedule(warmup_epochs=2, warmup_steps=0, warmup_momentum=0.8, warmup_bias_rate=0.1)

    assert warm.warmup_steps == 8
    assert (warm.at(0).rate, warm.at(0).bias_rate, warm.at(0).momentum) == (0.0, 0.1, 0.8)
    assert warm.at(4).rate == pytest.approx(warm.annealed(4) / 2)
    assert warm.at(4).bias_rate == pytest.approx((0.1 + warm.annealed(4)) / 2)
    assert warm.at(4).momentum == pytest.approx((0.8 + 0.937) / 2)
    assert (warm.at(8).rate, warm.at(8).momentum) == (warm.annealed(8), 0.937)
    assert warm.at(8).bias_rate == pytest.approx(warm.annealed(8))


def test_warmup_takes_a_third_of_a_short_run_at_most():
    assert schedule(30, warmup_epochs=1, warmup_steps=100).warmup_steps == 10
    assert schedule(3000, warmup_epochs=1, warmup_steps=100).warmup_steps == 100


def test_the_minimum_must_not_exceed_the_maximum():
    with pytest.raises(ConfigError, match=r"min_rate must not exceed max_rate 0\.001"):
        parse_config({"max_rate": 0.001, "min_rate": 0.01}, ScheduleConfig, source="x.yaml")
