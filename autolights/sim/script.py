"""The script of a drive: everything that happens in it, decided before the first image is painted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autolights.core import CameraModel, FloatArray, SignalSet
from autolights.core.transforms import rigid
from autolights.sim.config import DrivesConfig
from autolights.sim.disturbances import Disturbance, HeadLook, look_at, ordinary_look, plan_disturbances
from autolights.sim.ground import Ground, draw_ground
from autolights.sim.lighting import LIGHTINGS, Lighting
from autolights.sim.occluders import (
    Companion,
    Mover,
    Turner,
    plan_companions,
    plan_crossing,
    plan_oncoming,
    plan_turning,
)
from autolights.sim.programme import Indication, Programme, draw_programme
from autolights.sim.render import Scene, Shown
from autolights.sim.rig import build_cameras, rotation_from_angles
from autolights.sim.sensor import SensorState, draw_sensor
from autolights.sim.town import LANE_CENTERS_M, JunctionPlan, Town, build_town
from autolights.sim.vehicle import Motion, drive_along

START_M = -46.0  # of the vehicle; the first stop line is at 0
_EPOCH_NS = 1_690_000_000_000_000_000
_LANE_M = LANE_CENTERS_M[1]


@dataclass(frozen=True, eq=False)
class Script:
    """One drive, fully determined.

    Attributes:
        index: Of the drive in its configuration.
        signals: What lights can show.
        cameras: The rig.
        town: What stands still.
        ground: Its picture from above.
        lighting: Light of the drive.
        programmes: By junction name.
        motion: Our way.
        traffic: What crosses, comes and drives along.
        looks: By head id: the ordinary look and what disturbs it.
        sensors: Of each camera.
        utm_from_town: (4, 4).
        start_ns: Stamp of time 0.
    """

    index: int
    signals: SignalSet
    cameras: tuple[CameraModel, ...]
    town: Town
    ground: Ground
    lighting: Lighting
    programmes: dict[str, Programme]
    motion: Motion
    traffic: Sequence[Mover | Turner | Companion]
    looks: dict[str, tuple[HeadLook, tuple[Disturbance, ...]]]
    sensors: tuple[SensorState, ...]
    utm_from_town: FloatArray
    start_ns: int

    def indications(self, time_s: float) -> dict[str, Indication]:
        """What each head shows, by its id."""
        return {
            head.id: self.programmes[head.intersection].show(head.type, time_s, self.signals)
            for head in self.town.heads
        }

    def scene(self, time_s: float) -> Scene:
        """All that can be seen at an instant."""
        placed = [mover.placed_at(time_s) for mover in self.traffic]
        shown = {
            head_id: Shown(indication.lit_class, look_at(time_s, *self.looks[head_id]))
            for head_id, indication in self.indications(time_s).items()
        }
        return Scene(self.town, self.ground, self.lighting, [solid for solid in placed if solid], shown)


def write_script(config: DrivesConfig, index: int, signals: SignalSet) -> Script:
    """Decide a drive; depends on the configuration and the drive's index alone."""
    drive = config.drives[index]
    rng = np.random.default_rng([config.seed, index])
    lighting = LIGHTINGS[drive.lighting]
    plans = [
        JunctionPlan(drive.near_types, right_mast="3", near_side="3"),
        JunctionPlan(drive.far_types, right_mast="3"),
    ]
    town = build_town(signals, plans, rng)
    programmes = [draw_programme(drive.near_green_s, rng), draw_programme(drive.far_green_s, rng)]
    motion = drive_along(START_M, _LANE_M, drive.cruise_mps, drive.duration_s, town.junctions, programmes)
    traffic: list[Mover | Turner | Companion] = [*plan_oncoming(programmes[0], drive.duration_s, rng)]
    for junction, programme in zip(town.junctions, programmes, strict=True):
        traffic += plan_crossing(junction, programme, motion, drive.duration_s, config.traffic, rng)
        traffic += plan_turning(junction, programme, motion, drive.duration_s, config.traffic, rng)
    traffic += plan_companions(START_M, drive.cruise_mps, drive.duration_s, town.junctions, programmes, rng)
    looks = {}
    for head in town.heads:
        ordinary = ordinary_look(config.disturbance, rng)
        looks[head.id] = (ordinary, plan_disturbances(config.disturbance, ordinary, drive.duration_s, rng))
    heading = rotation_from_angles(float(rng.uniform(-180, 180)), 0, 0)
    return Script(
        index=index,
        signals=signals,
        cameras=build_cameras(config.cameras),
        town=town,
        ground=draw_ground(town.markings, START_M - 5, START_M + 240, lighting),
        lighting=lighting,
        programmes={j.name: p for j, p in zip(town.junctions, programmes, strict=True)},
        motion=motion,
        traffic=traffic,
        looks=looks,
        sensors=tuple(draw_sensor(config.sensor, lighting.noise_gain, rng) for _ in config.cameras),
        utm_from_town=rigid(heading, np.array(config.origin_utm_m) + np.append(rng.uniform(-400, 400, 2), 0)),
        start_ns=_EPOCH_NS + index * 3_600_000_000_000,
    )
