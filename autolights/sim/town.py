"""A town: one road with two signalised junctions in sight at once, and all that stands along it.

Town frame: x along the road the way we drive, y left, z up, metres; y = 0 is the middle of the road.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autolights.core import FloatArray, SignalSet
from autolights.sim.buildings import Building
from autolights.sim.faces import HousingColor
from autolights.sim.furniture import SIGN_KINDS, Beam, Sign, Tree
from autolights.sim.ground import Markings
from autolights.sim.heads import SignalHead

HALF_WIDTH_M = 10.4
LANE_CENTERS_M = (-1.8, -5.25, -8.7)  # ours: left turn, through, through
_LANE_LINES_M = (-7.0, -3.5, 3.5, 7.0)
_TOWARDS_US = np.pi
_AWAY = 0.0
# y of the heads that hang over our lanes, by their number.
_SLOTS_M: dict[int, tuple[float, ...]] = {
    1: (-4.0,),
    2: (-2.4, -6.6),
    3: (-1.5, -5.0, -8.4),
    4: (-1.0, -3.7, -6.4, -9.1),
}
_MAST_Y_M = HALF_WIDTH_M + 1.3


@dataclass(frozen=True)
class Junction:
    """A signalised junction.

    Attributes:
        name: Unique in the town.
        stop_line_m: x of our stop line.
        heads_m: x of the arm that carries our heads, beyond the crossing road.
        street_m: x of the crossing road's two kerbs.
    """

    name: str
    stop_line_m: float
    heads_m: float
    street_m: tuple[float, float]


@dataclass(frozen=True)
class JunctionPlan:
    """Which heads a junction has on our approach.

    Attributes:
        over_lanes: Types from left to right, one to four.
        right_mast: Type on the mast beside the road, or None.
        left_mast: Type beyond the oncoming lanes, or None.
        near_side: Type at the stop line's kerb, or None.
    """

    over_lanes: tuple[str, ...]
    right_mast: str | None = None
    left_mast: str | None = None
    near_side: str | None = None


@dataclass(frozen=True, eq=False)
class Town:
    """Everything that stands still; painted by `autolights.sim.render`."""

    junctions: tuple[Junction, ...]
    heads: tuple[SignalHead, ...]
    beams: tuple[Beam, ...]
    signs: tuple[Sign, ...]
    trees: tuple[Tree, ...]
    buildings: tuple[Building, ...]
    markings: Markings
    sun_azimuth: float
    clouds: int
    skyline: int


def build_town(signals: SignalSet, plans: Sequence[JunctionPlan], rng: np.random.Generator) -> Town:
    """Lay out a town whose first stop line is at x = 0.

    Args:
        signals: Sizes of the heads.
        plans: One for each junction, in the order in which they are reached; plans without heads make a town without
            signals.
        rng: Decides everything else.
    """
    junctions: list[Junction] = []
    heads: list[SignalHead] = []
    beams: list[Beam] = []
    signs: list[Sign] = []
    stop_line = 0.0
    for i, plan in enumerate(plans):
        name = f"junction-{i + 1}"
        width = float(rng.uniform(11, 14))
        street = (stop_line + 4.5, stop_line + 4.5 + width)
        junction = Junction(name, stop_line, street[1] + float(rng.uniform(0.8, 2.5)), street)
        junctions.append(junction)
        stop_line += float(rng.uniform(36, 44))
        if plan.over_lanes:
            _equip(junction, plan, signals, rng, heads, beams)
        _put_walk_signals(junction, rng, signs, beams)
    _put_street_signs(junctions, rng, signs, beams)
    return Town(
        junctions=tuple(junctions),
        heads=tuple(heads),
        beams=tuple(beams),
        signs=tuple(signs),
        trees=_plant_trees(junctions, rng),
        buildings=_build_blocks(junctions, rng),
        markings=_mark(junctions, rng),
        sun_azimuth=float(rng.uniform(-0.35, 0.35)),
        clouds=int(rng.integers(6)),
        skyline=int(rng.integers(40)),
    )


def _equip(
    junction: Junction,
    plan: JunctionPlan,
    signals: SignalSet,
    rng: np.random.Generator,
    heads: list[SignalHead],
    beams: list[Beam],
) -> None:
    housing: HousingColor = "yellow" if rng.uniform() < 0.45 else "black"
    steel = (118.0, 116.0, 112.0) if rng.uniform() < 0.7 else (64.0, 70.0, 66.0)
    count = 0

    def add(kind: str, x: float, y: float, z: float, yaw: float, group: str) -> None:
        nonlocal count
        count += 1
        turned = yaw + float(rng.normal(0, 0.05))
        position = np.array([x, y, z])
        light_id = f"{junction.name}-{count}"
        heads.append(
            SignalHead(light_id, kind, position, turned, junction.name, group, housing, signals.types[kind].size_m)
        )

    x, height = junction.heads_m, float(rng.uniform(5.3, 6.3))
    slots = _SLOTS_M[len(plan.over_lanes)]
    hung = rng.uniform() < 0.3  # on a span wire across the whole road, else on a mast arm
    beams.append(_mast(x, -_MAST_Y_M, height + 0.5, steel))
    if hung:
        beams.append(_mast(x, _MAST_Y_M, height + 1.2, steel))
        beams.append(
            _bar((x, -_MAST_Y_M, height + 0.9), (x, _MAST_Y_M, height + 0.9), (0.035, 0.035), (40.0, 40.0, 40.0))
        )
    else:
        beams.append(_bar((x, -_MAST_Y_M, height + 0.1), (x, slots[0] + 0.6, height + 0.25), (0.2, 0.1), steel))
    for kind, slot in zip(plan.over_lanes, slots, strict=True):
        y = slot + float(rng.uniform(-0.3, 0.3))
        add(kind, x - 0.28, y, height + float(rng.uniform(-0.05, 0.05)), _TOWARDS_US, "ours")
        if hung:
            top = height + signals.types[kind].height_m / 2
            beams.append(_bar((x - 0.1, y, top), (x - 0.1, y, height + 0.9), (0.05, 0.05), (50.0, 50.0, 50.0)))
    if plan.right_mast is not None:
        add(plan.right_mast, x - 0.3, -_MAST_Y_M, float(rng.uniform(3.0, 3.6)), _TOWARDS_US, "ours")
    if plan.left_mast is not None:
        if not hung:
            beams.append(_mast(x, _MAST_Y_M, 4.4, steel))
        add(plan.left_mast, x - 0.3, _MAST_Y_M, float(rng.uniform(3.0, 3.6)), _TOWARDS_US, "ours")
    if plan.near_side is not None:
        near = junction.stop_line_m + 1.0
        beams.append(_mast(near, -_MAST_Y_M, 3.7, steel))
        add(plan.near_side, near - 0.3, -_MAST_Y_M, float(rng.uniform(2.9, 3.2)), _TOWARDS_US, "ours-near-side")
    # The oncoming traffic's heads: we see their backs.
    far, tall = junction.stop_line_m + 2.6, float(rng.uniform(5.4, 6.2))
    beams.append(_mast(far, _MAST_Y_M, tall + 0.5, steel))
    beams.append(_bar((far, _MAST_Y_M, tall + 0.1), (far, 1.2, tall + 0.25), (0.2, 0.1), steel))
    kinds = rng.permutation(list(signals.types))
    for kind, y in zip((kinds[0], kinds[min(1, len(kinds) - 1)]), (2.2, 6.6), strict=True):
        add(str(kind), far + 0.28, y, tall, _AWAY, "oncoming")


def _put_walk_signals(junction: Junction, rng: np.random.Generator, signs: list[Sign], beams: list[Beam]) -> None:
    for y in (-_MAST_Y_M - 0.5, _MAST_Y_M + 0.5):
        if rng.uniform() < 0.75:
            x = junction.heads_m + 1.0
            kind = "walk" if rng.uniform() < 0.5 else "wait"
            beams.append(_mast(x, y, 2.9, (90.0, 90.0, 88.0), 0.1))
            signs.append(Sign(np.array([x - 0.2, y, 2.65]), _TOWARDS_US, (0.42, 0.42), kind))


def _put_street_signs(
    junctions: Sequence[Junction], rng: np.random.Generator, signs: list[Sign], beams: list[Beam]
) -> None:
    roadside = [kind for kind in SIGN_KINDS if kind in ("stop", "no_entry", "speed", "warning")]
    shops = [kind for kind in SIGN_KINDS if kind in ("cross", "disc_red", "disc_amber", "neon", "trio")]
    free = [x for x in np.arange(-70, 130, 9.0) if not _in_junction(x, junctions, 3)]
    for x in free:
        side = float(rng.choice([-1, 1]))
        draw = rng.uniform()
        if draw < 0.32:
            y, z = side * (HALF_WIDTH_M + 0.9), float(rng.uniform(2.2, 2.9))
            beams.append(_mast(x, y, z + 0.4, (120.0, 120.0, 118.0), 0.07))
            size = float(rng.uniform(0.6, 0.9))
            kind = str(rng.choice(roadside))
            signs.append(Sign(np.array([x - 0.08, y, z]), _TOWARDS_US, (size, size), kind))
        elif draw < 0.72:
            y, z = side * (HALF_WIDTH_M + 4.2), float(rng.uniform(3.2, 5.5))
            size = float(rng.uniform(0.5, 1.1))
            kind = str(rng.choice(shops))
            wide = 2.4 * size if kind in ("neon", "trio") else size
            signs.append(Sign(np.array([x, y, z]), _TOWARDS_US, (wide, size), kind))
    for x in free[::3]:  # street lamps
        y = float(rng.choice([-1, 1])) * (HALF_WIDTH_M + 0.8)
        inner = y - np.sign(y) * 2.0
        beams.append(_mast(x + 4, y, 8.5, (96.0, 96.0, 94.0)))
        beams.append(_bar((x + 4, y, 8.4), (x + 4, inner, 8.7), (0.1, 0.07), (96.0, 96.0, 94.0)))
        signs.append(Sign(np.array([x + 3.9, inner, 8.6]), _TOWARDS_US, (0.5, 0.16), "street_lamp"))


def _plant_trees(junctions: Sequence[Junction], rng: np.random.Generator) -> tuple[Tree, ...]:
    trees = []
    density = float(rng.uniform(0.1, 0.6))
    for x in np.arange(-70, 160, 8.0):
        for side in (-1, 1):
            if rng.uniform() < density and not _in_junction(x, junctions, 7):
                y = side * (HALF_WIDTH_M + float(rng.uniform(3.6, 5.5)))
                height = float(rng.uniform(5, 9.5))
                trees.append(Tree(np.array([x + rng.uniform(-2, 2), y, 0.0]), height, int(rng.integers(8))))
    return tuple(trees)


def _build_blocks(junctions: Sequence[Junction], rng: np.random.Generator) -> tuple[Building, ...]:
    blocks = []
    tallest = float(rng.uniform(8, 24))
    for side in (-1, 1):
        x = -80.0
        while x < 170:
            length = float(rng.uniform(8, 22))
            end = x + length
            street = next((j.street_m for j in junctions if j.street_m[0] - 3 < end and x < j.street_m[1] + 3), None)
            if street is not None:
                end = street[0] - 3
            if end - x > 5 and rng.uniform() < 0.85:
                tint = rng.uniform(0.85, 1.1, 3)
                blocks.append(
                    Building(
                        start_m=x,
                        end_m=end,
                        side=side,
                        setback_m=HALF_WIDTH_M + float(rng.uniform(4.5, 9)),
                        depth_m=float(rng.uniform(8, 14)),
                        height_m=float(rng.uniform(4, tallest)),
                        style=int(rng.integers(24)),
                        tint=(float(tint[0]), float(tint[1]), float(tint[2])),
                    )
                )
            x = street[1] + 3 if street is not None else end + float(rng.choice([0.0, 0.0, 4.0]))
    return tuple(blocks)


def _mark(junctions: Sequence[Junction], rng: np.random.Generator) -> Markings:
    verges = [(70.0, 112.0, 92.0), (74.0, 100.0, 104.0), (120.0, 126.0, 130.0)]
    grey = float(rng.uniform(68, 108))
    return Markings(
        half_width_m=HALF_WIDTH_M,
        lane_lines_m=_LANE_LINES_M,
        stop_lines_m=tuple(j.stop_line_m for j in junctions),
        crossings_m=tuple(j.stop_line_m + 2.4 for j in junctions),
        cross_streets_m=tuple(j.street_m for j in junctions),
        verge=verges[int(rng.integers(3))],
        asphalt=(grey * 1.02, grey, grey * 0.98),
        texture=int(rng.integers(6)),
    )


def _in_junction(x: float, junctions: Sequence[Junction], margin_m: float) -> bool:
    return any(j.stop_line_m - margin_m < x < j.heads_m + margin_m for j in junctions)


def _mast(x: float, y: float, height: float, color: tuple[float, float, float], diameter_m: float = 0.18) -> Beam:
    return _bar((x, y, 0.0), (x, y, height), (diameter_m, 0.75 * diameter_m), color)


def _bar(
    start: Sequence[float], end: Sequence[float], diameters_m: tuple[float, float], color: tuple[float, float, float]
) -> Beam:
    # Five pieces, so that the lens can bend it.
    points: FloatArray = np.linspace(start, end, 6)
    return Beam(points, diameters_m, color)
