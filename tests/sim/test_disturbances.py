"""Disturbances come, last and go as configured."""

from itertools import pairwise

import numpy as np

from autolights.sim.config import DisturbanceConfig
from autolights.sim.disturbances import HeadLook, look_at, plan_disturbances

CONFIG = DisturbanceConfig(rate_per_minute=20, duration_s=(0.3, 0.6), severity=(0.6, 1.0))
ORDINARY = HeadLook(washout=0.1)


def test_episodes_are_as_long_and_as_frequent_as_configured_and_never_overlap() -> None:
    planned = plan_disturbances(CONFIG, ORDINARY, 1_000.0, np.random.default_rng(0))
    lengths = [episode.end_s - episode.start_s for episode in planned]
    assert min(lengths) >= 0.3
    assert max(lengths) <= 0.6
    assert all(a.end_s <= b.start_s for a, b in pairwise(planned))
    # A cycle is a pause of 3 s and 0.45 s of disturbance, on average.
    assert 0.85 < len(planned) / (1_000 / 3.45) < 1.15


def test_a_look_lasts_from_start_to_end_and_then_recovers() -> None:
    episode = plan_disturbances(CONFIG, ORDINARY, 1_000.0, np.random.default_rng(1))[0]
    assert look_at(episode.start_s - 1e-6, ORDINARY, (episode,)) == ORDINARY
    assert look_at(episode.start_s, ORDINARY, (episode,)) == episode.look != ORDINARY
    assert look_at(episode.end_s, ORDINARY, (episode,)) == ORDINARY


def test_rate_zero_disturbs_nothing() -> None:
    quiet = DisturbanceConfig(rate_per_minute=0)
    assert plan_disturbances(quiet, ORDINARY, 100.0, np.random.default_rng(0)) == ()
