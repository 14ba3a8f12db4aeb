"""The vehicle obeys its signals; its localisation errs as configured."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autolights.core import PoseBuffer, load_signals
from autolights.core.transforms import rigid
from autolights.sim.config import PoseConfig
from autolights.sim.programme import draw_programme
from autolights.sim.rig import rotation_from_angles
from autolights.sim.town import JunctionPlan, build_town
from autolights.sim.vehicle import STOP_SHORT_M, Motion, drive_along, measure_poses

DURATION_S = 24.0


def drive(seed: int, near_s: float, far_s: float) -> tuple[Motion, list[float], list[object]]:
    rng = np.random.default_rng(seed)
    town = build_town(load_signals(), [JunctionPlan(("3",)), JunctionPlan(("3",))], rng)
    programmes = [draw_programme(near_s, rng), draw_programme(far_s, rng)]
    motion = drive_along(-46.0, -5.25, 9.0, DURATION_S, town.junctions, programmes)
    return motion, [j.stop_line_m for j in town.junctions], list(programmes)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1_000), near_s=st.floats(-30, 30), far_s=st.floats(-30, 30))
def test_nobody_enters_a_junction_on_red(seed: int, near_s: float, far_s: float) -> None:
    motion, lines, programmes = drive(seed, near_s, far_s)
    assert (np.diff(motion.x_m) >= 0).all()
    for line, programme in zip(lines, programmes, strict=True):
        enters = np.flatnonzero((motion.x_m[:-1] < line) & (motion.x_m[1:] >= line))
        for i in enters:
            phase = programme.phase_at(float(motion.times_s[i]))[0]  # type: ignore[attr-defined]
            assert phase in ("through", "through_clearance")


def test_stop_at_the_red_and_go_on_at_the_green() -> None:
    motion, lines, _ = drive(0, near_s=16.5, far_s=0.0)
    waiting = motion.speeds_mps < 0.05
    assert waiting.any()
    np.testing.assert_allclose(motion.x_m[waiting], lines[0] - STOP_SHORT_M, atol=0.4)
    assert motion.x_at(16.0) < lines[0] < motion.x_at(22.0)


def test_measured_poses_err_by_what_the_configuration_says() -> None:
    motion, _, _ = drive(1, near_s=0.0, far_s=0.0)
    config = PoseConfig(
        slow_position_m=0.04, fast_position_m=0.03, wander_s=0.2, slow_rotation_deg=0, fast_rotation_deg=0
    )
    utm_from_town = rigid(rotation_from_angles(30, 0, 0), np.array([5e5, 4.8e6, 100.0]))
    poses = measure_poses(motion, utm_from_town, 10**18, config, np.random.default_rng(2))
    errors, turns = [], []
    for pose in poses:
        truth = utm_from_town @ motion.town_from_ins((pose.stamp_ns - 10**18) / 1e9)
        errors.append(pose.position - truth[:3, 3])
        turns.append(np.abs(pose.utm_from_ins[:3, :3] - truth[:3, :3]).max())
    assert np.std(errors) == pytest.approx(0.05, rel=0.15)
    assert max(turns) < 1e-9
    steps = np.diff([pose.stamp_ns for pose in poses])
    np.testing.assert_allclose(steps, 1e9 / config.rate_hz, atol=1)


def test_poses_reach_beyond_the_first_and_the_last_image() -> None:
    motion, _, _ = drive(1, near_s=0.0, far_s=0.0)
    poses = PoseBuffer(measure_poses(motion, np.eye(4), 0, PoseConfig(), np.random.default_rng(0)))
    for time_s in (0.0, DURATION_S):
        np.testing.assert_allclose(
            poses.at(round(time_s * 1e9)).position, motion.town_from_ins(time_s)[:3, 3], atol=0.3
        )
