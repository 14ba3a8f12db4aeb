"""Traffic of a drive: what crosses before us and hides lights, what comes and what drives along."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autolights.core import FloatArray
from autolights.sim.actors import VehicleKind, car, pedestrian, vehicle
from autolights.sim.config import TrafficConfig
from autolights.sim.lighting import Bgr
from autolights.sim.programme import Programme
from autolights.sim.solids import Solid
from autolights.sim.town import HALF_WIDTH_M, LANE_CENTERS_M, Junction
from autolights.sim.vehicle import Motion, drive_along

_REACH_M = 40.0  # crossing vehicles appear and vanish this far beside the road
_PAINTS: tuple[Bgr, ...] = (
    (44.0, 42.0, 40.0),
    (226.0, 226.0, 226.0),
    (150.0, 152.0, 154.0),
    (44.0, 40.0, 172.0),
    (146.0, 88.0, 46.0),
    (72.0, 142.0, 196.0),
)


@dataclass(frozen=True, eq=False)
class Mover:
    """Something that moves straight on at a constant speed.

    Attributes:
        solid: Around its origin.
        start_s: When it appears.
        end_s: When it vanishes.
        position: (3,) at `start_s`.
        velocity: (3,) metres per second.
        yaw: The way it looks.
    """

    solid: Solid
    start_s: float
    end_s: float
    position: FloatArray
    velocity: FloatArray
    yaw: float

    def placed_at(self, time_s: float) -> Solid | None:
        """Where it is at an instant; None before it appears and after it has vanished."""
        if not self.start_s <= time_s < self.end_s:
            return None
        return self.solid.placed(self.position + (time_s - self.start_s) * self.velocity, self.yaw)


@dataclass(frozen=True, eq=False)
class Companion:
    """A car that drives our way in another lane, by the same signals."""

    motion: Motion
    cruising: Solid
    braking: Solid

    def placed_at(self, time_s: float) -> Solid:
        """Where it is, its brake lights on while it slows or waits."""
        slow = self.motion.acceleration_at(time_s) < -0.3 or self.motion.speed_at(time_s) < 0.2
        position = np.array([self.motion.x_at(time_s), self.motion.lane_m, 0.0])
        return (self.braking if slow else self.cruising).placed(position, 0.0)


def plan_crossing(
    junction: Junction,
    programme: Programme,
    own: Motion,
    duration_s: float,
    config: TrafficConfig,
    rng: np.random.Generator,
) -> list[Mover]:
    """Vehicles on the crossing road and pedestrians before our stop line, while our through signal is red for them.

    Nothing crosses once we are in the junction; people walk only where they see us wait.
    """
    middle = (junction.street_m[0] + junction.street_m[1]) / 2
    quarter = (junction.street_m[1] - junction.street_m[0]) / 4
    # Right-hand traffic: the near lane goes to our right, the far lane to our left.
    lanes = ((middle - quarter, -1.0), (middle + quarter, 1.0))
    movers: list[Mover] = []
    for lane_x, direction in lanes:
        time_s = float(rng.uniform(*config.headway_s)) - 3
        while time_s < duration_s:
            if _may_cross(junction, programme, own, time_s):
                movers.append(_crossing_vehicle(lane_x, direction, time_s, config, rng))
            time_s += float(rng.uniform(*config.headway_s))
    time_s = float(rng.uniform(*config.walker_gap_s)) - 3
    while time_s < duration_s:
        waiting = own.speed_at(time_s) < 0.3 and abs(junction.stop_line_m - own.x_at(time_s)) < 6
        if waiting and _may_cross(junction, programme, own, time_s):
            movers.append(_walker(own.x_at(time_s) + float(rng.uniform(3.4, 5.2)), own.lane_m, time_s, config, rng))
        time_s += float(rng.uniform(*config.walker_gap_s))
    return movers


@dataclass(frozen=True, eq=False)
class Turner:
    """An oncoming vehicle that turns left before us: straight on, a quarter circle, straight on.

    Attributes:
        solid: Around its origin.
        passes_s: When its turn begins.
        speed_mps: Constant.
        turn_m: (2,) x, y where its turn begins.
        radius_m: Of the turn.
    """

    solid: Solid
    passes_s: float
    speed_mps: float
    turn_m: tuple[float, float]
    radius_m: float

    def placed_at(self, time_s: float) -> Solid | None:
        """Where it is at an instant; None when it is far."""
        way_m = (time_s - self.passes_s) * self.speed_mps
        if not -_REACH_M <= way_m < _REACH_M + self.radius_m * np.pi / 2:
            return None
        angle = float(np.clip(way_m / self.radius_m, 0, np.pi / 2))
        (x, y), radius = self.turn_m, self.radius_m
        before, after = min(way_m, 0.0), max(way_m - radius * np.pi / 2, 0.0)
        position = np.array([x - before - radius * np.sin(angle), y - radius * (1 - np.cos(angle)) - after, 0.0])
        return self.solid.placed(position, np.pi + angle)


def plan_turning(
    junction: Junction,
    programme: Programme,
    own: Motion,
    duration_s: float,
    config: TrafficConfig,
    rng: np.random.Generator,
) -> list[Turner]:
    """Oncoming vehicles that turn left while they have the arrow and we wait."""
    lane_x = junction.street_m[0] + (junction.street_m[1] - junction.street_m[0]) / 4
    turners = []
    time_s = 0.0
    while time_s < duration_s:
        time_s += float(rng.uniform(*config.headway_s))
        phase, elapsed, _ = programme.phase_at(time_s)
        if phase != "left" or elapsed < 0.8 or own.x_at(time_s + 4) > junction.stop_line_m:
            continue
        solid = _draw_vehicle(config, rng)
        turners.append(Turner(solid, time_s, 6.5, (lane_x + 7.0, 1.8), 7.0))
    return turners


def plan_oncoming(programme: Programme, duration_s: float, rng: np.random.Generator) -> list[Mover]:
    """Cars that come towards us while the near junction lets them through."""
    movers = []
    time_s = 0.0
    while time_s < duration_s:
        time_s += float(rng.uniform(1.0, 2.5))
        if programme.phase_at(time_s)[0] != "through":
            continue
        speed, lane = float(rng.uniform(8, 11)), float(rng.choice([1.8, 5.25]))
        start_s = time_s - 100 / speed
        solid = car(_PAINTS[int(rng.integers(len(_PAINTS)))], braking=False)
        position, velocity = np.array([110.0, lane, 0.0]), np.array([-speed, 0.0, 0.0])
        movers.append(Mover(solid, start_s, start_s + 180 / speed, position, velocity, float(np.pi)))
    return movers


def plan_companions(
    start_m: float,
    cruise_mps: float,
    duration_s: float,
    junctions: Sequence[Junction],
    programmes: Sequence[Programme],
    rng: np.random.Generator,
) -> list[Companion]:
    """A few cars in the lanes beside ours."""
    companions = []
    for lane in (LANE_CENTERS_M[0], LANE_CENTERS_M[2]):
        if rng.uniform() < 0.8:
            ahead = float(rng.uniform(8, 22))
            motion = drive_along(
                start_m + ahead, lane, cruise_mps * float(rng.uniform(0.95, 1.1)), duration_s, junctions, programmes
            )
            paint = _PAINTS[int(rng.integers(len(_PAINTS)))]
            companions.append(Companion(motion, car(paint, braking=False), car(paint, braking=True)))
    return companions


def _may_cross(junction: Junction, programme: Programme, own: Motion, time_s: float) -> bool:
    """The crossing road has green for another second, and we are before the stop line."""
    phase, _, left_s = programme.phase_at(time_s)
    return phase == "crossing" and left_s > 1.0 and own.x_at(time_s) < junction.stop_line_m - 1


def _crossing_vehicle(
    lane_x: float, direction: float, passes_s: float, config: TrafficConfig, rng: np.random.Generator
) -> Mover:
    """A vehicle that is in the middle of our road at `passes_s`."""
    speed = float(rng.uniform(*config.speed_mps))
    solid = _draw_vehicle(config, rng)
    reach_s = _REACH_M / speed
    return Mover(
        solid,
        passes_s - reach_s,
        passes_s + reach_s,
        np.array([lane_x, -direction * _REACH_M, 0.0]),
        np.array([0.0, direction * speed, 0.0]),
        float(direction * np.pi / 2),
    )


def _draw_vehicle(config: TrafficConfig, rng: np.random.Generator) -> Solid:
    draw = rng.uniform()
    lorry, van = config.lorry_share, config.lorry_share + config.van_share
    kind: VehicleKind = "lorry" if draw < lorry else "van" if draw < van else "car"
    return vehicle(kind, _PAINTS[int(rng.integers(len(_PAINTS)))], braking=False)


def _walker(x: float, lane_m: float, passes_s: float, config: TrafficConfig, rng: np.random.Generator) -> Mover:
    """A pedestrian with an umbrella who is straight before us at `passes_s`."""
    direction = float(rng.choice([-1, 1]))
    speed = float(rng.uniform(*config.walk_mps))
    start_y = -direction * (HALF_WIDTH_M + 1.0)
    before_s = abs(lane_m - start_y) / speed
    paints = rng.integers(len(_PAINTS), size=2)
    return Mover(
        pedestrian(_PAINTS[int(paints[0])], umbrella=_PAINTS[int(paints[1])]),
        passes_s - before_s,
        passes_s - before_s + 2 * (HALF_WIDTH_M + 1.0) / speed,
        np.array([x, start_y, 0.0]),
        np.array([0.0, direction * speed, 0.0]),
        float(direction * np.pi / 2),
    )
