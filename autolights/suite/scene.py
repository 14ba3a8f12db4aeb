"""Town, signals and motion of a drive as arrays over time: the truth behind images that nobody paints."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from autolights.core import BoolArray, CameraModel, FloatArray, IntArray, SignalSet, project_points
from autolights.core.transforms import invert_rigid, rigid
from autolights.sim.heads import SignalHead
from autolights.sim.programme import FLASHING, PHASES, SHOWN, Programme, draw_programme
from autolights.sim.rig import rotation_from_angles
from autolights.sim.town import HALF_WIDTH_M, LANE_CENTERS_M, Junction, JunctionPlan, Town, build_town
from autolights.sim.vehicle import Motion, drive_along
from autolights.suite.config import ScenarioConfig

_ROW_M = 1.9  # from one row of lights to the next above it
_CYCLE_S = 26.0  # about one cycle of a programme
_SWEEP_MPS = 14.0  # how fast the edge of a lorry passes over a row of lights
_EDGE_S = 0.1  # how long it takes over one light
_ORIGIN_M = (627_300.0, 4_848_900.0, 152.0)
_FACING_DEG = 75.0  # heads turned farther away show nothing


@dataclass(frozen=True, eq=False)
class Scene:
    """One drive as it really was.

    Attributes:
        signals: What lights can show.
        town: Lights and junctions.
        programmes: By junction name.
        motion: Our way.
        utm_from_town: (4, 4).
        lookalikes: Things that look like lights: heads that show one class, in no map.
        lookalike_classes: (k,) the class.
        occlusions: Of lights.
        programme_kind: As in `ScenarioConfig.programme`.
    """

    signals: SignalSet
    town: Town
    programmes: dict[str, Programme]
    motion: Motion
    utm_from_town: FloatArray
    lookalikes: tuple[SignalHead, ...]
    lookalike_classes: IntArray
    occlusions: "Occlusions"
    programme_kind: str

    @property
    def heads(self) -> tuple[SignalHead, ...]:
        """The lights."""
        return self.town.heads

    def shown(self, times_s: FloatArray) -> tuple[IntArray, IntArray, BoolArray]:
        """What each light shows at each instant.

        Returns:
            (t, n) class ids of what is lit, of what is to be reported, and whether it flashes.
        """
        lit = np.empty((len(times_s), len(self.heads)), dtype=np.int64)
        reported, flashing = np.empty_like(lit), np.zeros(lit.shape, dtype=bool)
        known: dict[tuple[str, str], tuple[IntArray, IntArray, BoolArray]] = {}
        for column, head in enumerate(self.heads):
            key = (head.intersection, head.type)
            if key not in known:
                known[key] = show(
                    self.programmes[head.intersection], head.type, times_s, self.signals, self.programme_kind
                )
            lit[:, column], reported[:, column], flashing[:, column] = known[key]
        return lit, reported, flashing

    def flash_ends_s(self, until_s: float) -> dict[str, FloatArray]:
        """By light: when its flashes end, to 10 ms, whether anybody sees it or not; from 2 s before the drive on."""
        times_s = np.arange(-2.0, until_s, 0.01)
        flashing = self.shown(times_s)[2]
        ended = flashing[:-1] & ~flashing[1:]
        return {head.id: times_s[1:][ended[:, column]] for column, head in enumerate(self.heads)}

    def poses(self, times_s: FloatArray) -> FloatArray:
        """(t, 4, 4) true pose of the vehicle in the town at each instant."""
        return np.array([self.motion.town_from_ins(float(time_s)) for time_s in times_s]).reshape(-1, 4, 4)


@dataclass(frozen=True, eq=False)
class Occlusions:
    """What hides lights: (m,) passages, each over some lights.

    Attributes:
        starts_s: (m, n) when the edge reaches each light; inf where it never does.
        durations_s: (m,) how long each stays hidden.
        depths: (m,) share of the box that is hidden at most.
    """

    starts_s: FloatArray
    durations_s: FloatArray
    depths: FloatArray

    def hidden(self, times_s: FloatArray) -> FloatArray:
        """(t, n) share of each light that is hidden."""
        share = np.zeros((len(times_s), self.starts_s.shape[1]))
        for starts_s, duration_s, depth in zip(self.starts_s, self.durations_s, self.depths, strict=True):
            since = times_s[:, None] - starts_s
            ramp = np.minimum(since, duration_s - since) / _EDGE_S
            share = np.maximum(share, depth * np.clip(ramp, 0, 1))
        return share


def build_scene(scenario: ScenarioConfig, signals: SignalSet, rng: np.random.Generator) -> Scene:
    """Decide a drive; depends on its arguments alone."""
    plans = []
    drawn = rng.integers(len(scenario.layouts), size=scenario.junctions)
    for i in drawn if scenario.junction_spacing_m is None else [drawn[0]] * len(drawn):
        layout = scenario.layouts[int(i)]
        side = sorted(signals.types)[0]
        plans.append(JunctionPlan(layout, right_mast=side, near_side=side))
    town = build_town(signals, plans, rng)
    if scenario.row_spacing_m is not None:
        town = replace(town, heads=tuple(_closer(town, head, scenario.row_spacing_m) for head in town.heads))
    town = replace(town, heads=tuple(copy for head in town.heads for copy in _stacked(head, scenario.rows)))
    if scenario.junction_spacing_m is not None:
        town = _spaced(town, scenario.junction_spacing_m)
    programmes = [draw_programme(float(rng.uniform(0, _CYCLE_S)), rng) for _ in town.junctions]
    motion = drive_along(
        scenario.start_m, LANE_CENTERS_M[1], scenario.cruise_mps, scenario.duration_s, town.junctions, programmes
    )
    heading = rotation_from_angles(float(rng.uniform(-180, 180)), 0, 0)
    lookalikes, classes = _draw_lookalikes(town, signals, scenario.lookalikes_per_junction, rng)
    return Scene(
        signals=signals,
        town=town,
        programmes={j.name: p for j, p in zip(town.junctions, programmes, strict=True)},
        motion=motion,
        utm_from_town=rigid(heading, np.array(_ORIGIN_M) + np.append(rng.uniform(-400, 400, 2), 0)),
        lookalikes=lookalikes,
        lookalike_classes=classes,
        occlusions=_plan_occlusions(town, scenario, rng),
        programme_kind=scenario.programme,
    )


def show(
    programme: Programme, type_name: str, times_s: FloatArray, signals: SignalSet, kind: str
) -> tuple[IntArray, IntArray, BoolArray]:
    """`Programme.show` for many instants, and for other kinds of programmes.

    Returns:
        (t,) class ids of what is lit, of what is to be reported, and whether it flashes.
    """
    durations = np.array(programme.durations_s)
    ends = np.cumsum(durations)
    elapsed = (times_s - programme.through_start_s + ends[PHASES.index("through") - 1]) % programme.cycle_s
    phases = np.searchsorted(ends, elapsed, side="right").clip(max=len(PHASES) - 1)
    in_phase = elapsed - (ends - durations)[phases]
    names = [SHOWN[type_name][phase] for phase in PHASES]
    if kind == "flashing_red":
        names = [FLASHING if phase == "crossing" else name for phase, name in zip(PHASES, names, strict=True)]
    if kind == "steady":
        names = [SHOWN[type_name]["left"] if name == FLASHING else name for name in names]
    if FLASHING not in names:
        ids = np.array([signals.class_ids[name] for name in names])[phases]
        return ids, ids, np.zeros(len(times_s), dtype=bool)
    pair = signals.types[type_name].flashing[0]
    on, off, reported = (signals.class_ids[name] for name in (pair.on, pair.off, pair.reported))
    steady = np.array([on if name == FLASHING else signals.class_ids[name] for name in names])[phases]
    flashes = np.array([name == FLASHING for name in names])[phases]
    dark = flashes & (in_phase % programme.flash_period_s >= programme.flash_on_s)
    return np.where(dark, off, steady), np.where(flashes, reported, steady), flashes


def image_boxes(corners: FloatArray, camera: CameraModel, town_from_ins: FloatArray) -> FloatArray:
    """Boxes of things at many instants.

    Args:
        corners: (n, 8, 3) metres in the town.
        camera: The camera.
        town_from_ins: (t, 4, 4).

    Returns:
        (t, n, 4) xyxy pixels; NaN where a corner does not project.
    """
    transforms = np.array([camera.cam_from_ins @ invert_rigid(pose) for pose in town_from_ins]).reshape(-1, 4, 4)
    n = len(corners)
    points = np.einsum("tij,pj->tpi", transforms[:, :3, :3], corners.reshape(-1, 3)) + transforms[:, None, :3, 3]
    pixels = project_points(points, camera).reshape(len(transforms), n, 8, 2) + 0.5
    return np.concatenate([pixels.min(axis=2), pixels.max(axis=2)], axis=-1)


def facing(heads: tuple[SignalHead, ...], positions: FloatArray) -> BoolArray:
    """(t, n) whether the heads show their faces to (t, 3) positions in the town."""
    normals = np.array([head.normal[:2] for head in heads]).reshape(-1, 2)
    places = np.array([head.position for head in heads]).reshape(-1, 3)
    towards = positions[:, None, :2] - places[None, :, :2]
    cosine = (towards * normals).sum(axis=-1) / np.maximum(np.linalg.norm(towards, axis=-1), 1e-9)
    return np.asarray(cosine > np.cos(np.radians(_FACING_DEG)))


def _closer(town: Town, head: SignalHead, spacing_m: float) -> SignalHead:
    """A head over our lanes at its place in a row that is `spacing_m` apart; all others stay."""
    row = [h for h in town.heads if h.intersection == head.intersection and _over_lanes(h)]
    if not _over_lanes(head):
        return head
    middle = LANE_CENTERS_M[1]
    across = middle + spacing_m * ((len(row) - 1) / 2 - [h.id for h in row].index(head.id))
    return replace(head, position=np.array([head.position[0], across, head.position[2]]))


def _stacked(head: SignalHead, rows: int) -> Iterator[SignalHead]:
    """A head, and copies above it if it hangs over our lanes."""
    yield head
    for row in range(1, rows if _over_lanes(head) else 1):
        position = head.position + np.array([0.0, 0.0, _ROW_M * row])
        yield replace(head, id=f"{head.id}-{row + 1}", position=position)


def _spaced(town: Town, spacing_m: float) -> Town:
    """A town with its junctions so far apart."""
    shift_m = {j.name: i * spacing_m - j.stop_line_m for i, j in enumerate(town.junctions)}
    return replace(
        town,
        junctions=tuple(
            Junction(
                j.name,
                j.stop_line_m + shift_m[j.name],
                j.heads_m + shift_m[j.name],
                (j.street_m[0] + shift_m[j.name], j.street_m[1] + shift_m[j.name]),
            )
            for j in town.junctions
        ),
        heads=tuple(
            replace(head, position=head.position + np.array([shift_m[head.intersection], 0.0, 0.0]))
            for head in town.heads
        ),
    )


def _over_lanes(head: SignalHead) -> bool:
    return head.group == "ours" and abs(head.position[1]) < HALF_WIDTH_M


def _draw_lookalikes(
    town: Town, signals: SignalSet, count: int, rng: np.random.Generator
) -> tuple[tuple[SignalHead, ...], IntArray]:
    """Neon signs, reflections and the like beside the road, near the lights where they harm most."""
    things, classes = [], []
    for junction in town.junctions:
        for i in range(count):
            class_id = int(rng.integers(len(signals.classes)))
            kind = signals.type_of[signals.classes[class_id]]
            side = float(rng.choice([-1, 1]))
            position = np.array(
                [
                    junction.heads_m + rng.uniform(-12, 6),
                    side * (HALF_WIDTH_M + rng.uniform(1.0, 6.0)),
                    rng.uniform(2.5, 5.5),
                ]
            )
            size_m = signals.types[kind].size_m
            name = f"{junction.name}-like-{i + 1}"
            things.append(SignalHead(name, kind, position, np.pi, junction.name, "none", "black", size_m))
            classes.append(class_id)
    return tuple(things), np.array(classes, dtype=np.int64)


def _plan_occlusions(town: Town, scenario: ScenarioConfig, rng: np.random.Generator) -> Occlusions:
    """Passages over the lights of one junction at a time, from either side."""
    starts, durations, depths = [], [], []
    places = np.array([head.position for head in town.heads])
    junctions = np.array([head.intersection for head in town.heads])
    for junction in town.junctions:
        own = junctions == junction.name
        time_s = 0.0
        while scenario.occlusions_per_minute > 0:
            time_s += float(rng.exponential(60 / scenario.occlusions_per_minute))
            if time_s >= scenario.duration_s:
                break
            direction = float(rng.choice([-1, 1]))
            reaches_s = time_s + direction * places[:, 1] / _SWEEP_MPS
            starts.append(np.where(own, reaches_s, np.inf))
            duration_s = float(rng.uniform(*scenario.occlusion_s))
            durations.append(duration_s)
            depths.append(float(rng.choice([1.0, 1.0, 1.0, 0.6])))
            time_s += duration_s + 2.0  # one lorry at a time
    return Occlusions(np.array(starts).reshape(-1, len(places)), np.array(durations), np.array(depths))
