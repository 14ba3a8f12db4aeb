"""How vehicles move along the road: they keep their speed, stop at red and go on; and what localisation says of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from autolights.core import FloatArray, Pose
from autolights.core.transforms import rigid
from autolights.sim.config import PoseConfig
from autolights.sim.programme import Programme
from autolights.sim.rig import INS_HEIGHT_M, rotation_from_angles
from autolights.sim.town import Junction

STEP_S = 0.01
LEAD_S = 0.5  # motion is known this long before the first image and after the last
STOP_SHORT_M = 3.0  # the origin of a vehicle that waits is this far before the stop line
_ACCELERATION_MPS2 = 1.8
_BRAKING_MPS2 = 2.2
_HARDEST_BRAKING_MPS2 = 3.2
_PITCH_DEG_PER_MPS2 = 0.25


@dataclass(frozen=True, eq=False)
class Motion:
    """A vehicle's way along its lane, sampled every `STEP_S` from `-LEAD_S` on.

    Attributes:
        times_s: (n,).
        x_m: (n,) along the road.
        speeds_mps: (n,).
        accelerations_mps2: (n,) smoothed as springs do.
        lane_m: y of the lane.
    """

    times_s: FloatArray
    x_m: FloatArray
    speeds_mps: FloatArray
    accelerations_mps2: FloatArray
    lane_m: float

    def x_at(self, time_s: float) -> float:
        """Position along the road."""
        return float(np.interp(time_s, self.times_s, self.x_m))

    def speed_at(self, time_s: float) -> float:
        """Metres per second."""
        return float(np.interp(time_s, self.times_s, self.speeds_mps))

    def acceleration_at(self, time_s: float) -> float:
        """Metres per second squared."""
        return float(np.interp(time_s, self.times_s, self.accelerations_mps2))

    def town_from_ins(self, time_s: float) -> FloatArray:
        """(4, 4) true pose: the lane is kept with a slow sway, the nose dips under braking, the road is not smooth."""
        x, speed = self.x_at(time_s), self.speed_at(time_s)
        sway = 0.12 * np.sin(0.13 * x + 0.4)
        yaw = np.degrees(0.12 * 0.13 * np.cos(0.13 * x + 0.4))
        rough = min(speed / 5, 1.0)
        pitch = -_PITCH_DEG_PER_MPS2 * self.acceleration_at(time_s) + rough * 0.12 * np.sin(1.7 * x)
        roll = rough * 0.15 * np.sin(1.1 * x + 1.0)
        position = np.array([x, self.lane_m + sway, INS_HEIGHT_M + rough * 0.01 * np.sin(2.3 * x)])
        return rigid(rotation_from_angles(yaw, pitch, roll), position)


def drive_along(
    start_m: float,
    lane_m: float,
    cruise_mps: float,
    duration_s: float,
    junctions: Sequence[Junction],
    programmes: Sequence[Programme],
) -> Motion:
    """Drive through a town by its signals.

    At a red or, where it can still stop, a yellow through signal the vehicle brakes to a halt before the stop line.

    Args:
        start_m: x at the first sample.
        lane_m: y of the lane.
        cruise_mps: Speed on the open road, also at the start.
        duration_s: Of the drive.
        junctions: In the order in which they are reached.
        programmes: Of each junction.
    """
    times = np.arange(-LEAD_S, duration_s + LEAD_S + STEP_S, STEP_S)
    rows = np.empty((len(times), 3))
    x, speed, felt = start_m, cruise_mps, 0.0
    stops: dict[str, bool] = {}  # by junction: what the driver decided when its signal left green
    for i, time_s in enumerate(times):
        rows[i] = x, speed, felt
        allowed = cruise_mps
        for junction, programme in zip(junctions, programmes, strict=True):
            distance = junction.stop_line_m - STOP_SHORT_M - x
            if programme.phase_at(float(time_s))[0] == "through":
                stops.pop(junction.name, None)
            elif stops.setdefault(junction.name, speed**2 <= 2 * _HARDEST_BRAKING_MPS2 * distance):
                allowed = min(allowed, float(np.sqrt(2 * _BRAKING_MPS2 * max(distance, 0.0))))
        wanted = np.clip((allowed - speed) / 0.1, -1.4 * _HARDEST_BRAKING_MPS2, _ACCELERATION_MPS2)
        felt += (float(wanted) - felt) * STEP_S / 0.25
        speed = max(0.0, speed + float(wanted) * STEP_S)
        x += speed * STEP_S
    return Motion(times, rows[:, 0], rows[:, 1], rows[:, 2], lane_m)


def measure_poses(
    motion: Motion, utm_from_town: FloatArray, start_ns: int, config: PoseConfig, rng: np.random.Generator
) -> list[Pose]:
    """What the localisation reports along a motion: errors with a slow and a fast part.

    Args:
        motion: The truth.
        utm_from_town: (4, 4) where the town lies.
        start_ns: Stamp of time 0.
        config: Rates and errors.
        rng: Decides the errors.
    """
    times = np.arange(motion.times_s[0], motion.times_s[-1], 1 / config.rate_hz)
    moved = _wander(len(times), config.slow_position_m, config, rng)
    moved += rng.normal(0, config.fast_position_m, (len(times), 3))
    turned = _wander(len(times), config.slow_rotation_deg, config, rng)
    turned += rng.normal(0, config.fast_rotation_deg, (len(times), 3))
    utm_from_ins = np.array([utm_from_town @ motion.town_from_ins(float(time_s)) for time_s in times])
    rotations = Rotation.from_matrix(utm_from_ins[:, :3, :3]) * Rotation.from_rotvec(turned, degrees=True)
    return [
        Pose(start_ns + round(time_s * 1e9), position, quaternion)
        for time_s, position, quaternion in zip(times, utm_from_ins[:, :3, 3] + moved, rotations.as_quat(), strict=True)
    ]


def _wander(count: int, sigma: float, config: PoseConfig, rng: np.random.Generator) -> FloatArray:
    """(count, 3) Ornstein-Uhlenbeck process of the given standard deviation, stationary from its first sample."""
    keep = np.exp(-1 / (config.rate_hz * config.wander_s))
    kicks = rng.normal(0, sigma * np.sqrt(1 - keep**2), (count, 3))
    values = np.empty((count, 3))
    value = rng.normal(0, sigma, 3)
    for i in range(count):
        value = keep * value + kicks[i]
        values[i] = value
    return values
