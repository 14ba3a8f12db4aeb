"""Which lights matter now: how far ahead, of which intersection, and whether they govern the vehicle's approach.

A light governs the approach if it hangs ahead and the map links it to the lane that the vehicle is on. Where the map
has no such link, or the vehicle is on none of its lanes, a light governs if it hangs ahead, not too far aside, and its
face looks against the way the vehicle heads.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from autolights.core import Config, FloatArray, IntArray, LightEstimate, Pose, TrafficLightMap

_PIECE_M = 10.0  # lanes are searched in pieces no longer than this
_EQUALLY_NEAR_M = 0.5  # where lanes part or cross, the vehicle is on all of them
_LANE_COSINE = np.cos(np.radians(45.0))  # a lane that leads elsewhere is only crossed


class RelevanceConfig(Config):
    """What belongs together, and what counts as ahead.

    Attributes:
        cluster_m: Lights within so far of each other belong to one intersection, if the map does not say otherwise.
        facing_deg: How far a light's face may look past the vehicle's way and still be meant for it.
        max_aside_m: How far aside of that way it may hang.
        lane_half_width_m: The vehicle is on a lane if it is no farther from its middle.
    """

    cluster_m: float = Field(default=25.0, gt=0)
    facing_deg: float = Field(default=45.0, gt=0, le=90)
    max_aside_m: float = Field(default=25.0, gt=0)
    lane_half_width_m: float = Field(default=2.0, gt=0)


class _Known(NamedTuple):
    """What stays of a light while it stays where it is: its intersection, the way its face looks, and its lanes."""

    intersection: str
    face: tuple[float, float] | None  # east and north
    lanes: tuple[str, ...]


class Relevance:
    """Tells of lights what they mean to the vehicle; all that depends on the map alone is computed once.

    Args:
        lights: The map.
        config: Limits.
    """

    def __init__(self, lights: TrafficLightMap, config: RelevanceConfig) -> None:
        self._config = config
        self._row_of_id = {light_id: row for row, light_id in enumerate(lights.ids)}
        self._names, numbers = intersections(lights, config.cluster_m)
        self._numbers = numbers
        self._faces = _directions(lights.headings_deg)
        self._lanes_of = lights.lanes
        linked = lights.lane_lines and any(lights.lanes)
        self._lanes = _Lanes(lights, config.lane_half_width_m) if linked else None
        self._tree = cKDTree(lights.positions[:, :2]) if len(lights) else None
        self._least_facing = float(np.cos(np.radians(config.facing_deg)))
        self._unmapped: TrafficLightMap | None = None
        self._looked_up: tuple[tuple[str, ...], bytes] = ((), b"")
        self._of_track: dict[str, _Known] = {}
        self._of_light: dict[str, _Known] = {}  # of those that were seen
        self._on_lanes: frozenset[str] = frozenset()

    def tell(
        self,
        estimates: Sequence[LightEstimate],
        unmapped: TrafficLightMap,
        pose: Pose,
        lanes: Iterable[str] | None = None,
    ) -> list[LightEstimate]:
        """Complete estimates by `ahead_m`, `intersection` and `governs`, and order them.

        Args:
            estimates: Made for this set of frames; they are completed in place.
            unmapped: Lights that the map does not hold, track ids for names.
            pose: The vehicle's.
            lanes: On which it is, if that is known; else the map's lanes are searched.

        Returns:
            First those of intersections with a light for us, the nearest first; then of other intersections ahead, then
            of those behind. Within an intersection those that govern come first, else the order given stays.
        """
        if not estimates:
            return []
        if lanes is None and self._lanes is not None:
            lanes = self._lanes.under(pose)
        self._on_lanes = on_lanes = frozenset(lanes or ())
        if unmapped is not self._unmapped:
            self._unmapped = unmapped
            # Filters move lights a little all the time: to the metre they stay, and so does what is known of them.
            places = unmapped.positions[:, :2].round()
            looked_up = unmapped.ids, places.tobytes()
            if looked_up != self._looked_up:
                self._looked_up, self._of_track = looked_up, self._look_up(unmapped, places)

        x, y = pose.utm_from_ins[:2, 0].tolist()
        length = math.hypot(x, y) or 1.0
        x, y = x / length, y / length
        east, north, _ = pose.position.tolist()
        max_aside_m, least_facing = self._config.max_aside_m, self._least_facing
        by_rank: dict[str, tuple[list[LightEstimate], ...]] = {}  # of each intersection
        nearest: dict[str, tuple[int, float]] = {}
        # Numbers of a light are too few for arrays to be worth their calls.
        for light in estimates:
            if light.map_id is not None:
                known = self._of_light.get(light.map_id) or self._look_up_mapped(light.map_id)
            else:
                known = self._of_track.get(str(light.track_id)) or _Known(f"near track {light.track_id}", None, ())
            light_east, light_north, _ = light.position.tolist()
            right, up = light_east - east, light_north - north
            ahead_m = x * right + y * up
            governs: bool | None
            if known.lanes and on_lanes:
                governs = ahead_m > 0 and not on_lanes.isdisjoint(known.lanes)
            elif known.face is None:
                governs = None
            else:
                against = -(known.face[0] * x + known.face[1] * y)
                governs = ahead_m > 0 and against >= least_facing and abs(y * right - x * up) <= max_aside_m
            name = known.intersection
            vars(light).update(ahead_m=ahead_m, intersection=name, governs=governs)
            rank = 0 if governs else 1 if ahead_m > 0 else 2
            key = rank, abs(ahead_m)
            if name not in nearest:
                nearest[name], by_rank[name] = key, ([], [], [])
            elif key < nearest[name]:
                nearest[name] = key
            by_rank[name][rank].append(light)
        order = sorted(nearest, key=lambda name: (nearest[name], name))
        return [light for name in order for lights in by_rank[name] for light in lights]

    def explain(self) -> dict[str, Any]:
        """What the latest estimates were judged by, as JSON-ready values: the lanes that the vehicle is on."""
        return {"lanes": sorted(self._on_lanes)}

    def _look_up_mapped(self, map_id: str) -> _Known:
        row = self._row_of_id[map_id]
        east, north = self._faces[row].tolist()
        known = _Known(self._names[self._numbers[row]], (east, north), self._lanes_of[row])
        self._of_light[map_id] = known
        return known

    def _look_up(self, unmapped: TrafficLightMap, places: FloatArray) -> dict[str, _Known]:
        """By track; the intersection is that of the nearest light of the map, or one of unmapped lights alone."""
        n, limit_m = len(unmapped), self._config.cluster_m
        names = [""] * n
        if self._tree is not None and n:
            distances_m, rows = self._tree.query(places, distance_upper_bound=limit_m)
            for i in np.flatnonzero(np.isfinite(distances_m)).tolist():
                names[i] = self._names[self._numbers[rows[i]]]
        alone = np.array([i for i in range(n) if not names[i]], dtype=np.int64)
        for number, group in enumerate(_clusters(places[alone], limit_m).tolist()):
            names[alone[number]] = f"near track {unmapped.ids[alone[group]]}"
        return {
            track: _Known(name, (face[0], face[1]), ())
            for track, name, face in zip(unmapped.ids, names, _directions(unmapped.headings_deg).tolist(), strict=True)
        }


def intersections(lights: TrafficLightMap, cluster_m: float) -> tuple[tuple[str, ...], IntArray]:
    """The intersections of a map: those that it names, and clusters of lights that it does not assign.

    A light without a name belongs to the named light that is nearest, if that is within `cluster_m`; what is left falls
    into clusters of lights that are linked by steps of at most `cluster_m`.

    Returns:
        Names, derived ones are ``near ID`` after the first light of the cluster, and (n,) their numbers for each light.
    """
    names = list(dict.fromkeys(name for name in lights.intersections if name))
    number_of = {name: number for number, name in enumerate(names)}
    numbers = np.array([number_of.get(name, -1) for name in lights.intersections], dtype=np.int64)
    places = lights.positions[:, :2]
    named, open_rows = np.flatnonzero(numbers >= 0), np.flatnonzero(numbers < 0)
    if len(named) and len(open_rows):
        distances_m, nearest = cKDTree(places[named]).query(places[open_rows], distance_upper_bound=cluster_m)
        near = np.isfinite(distances_m)
        numbers[open_rows[near]] = numbers[named[nearest[near]]]
        open_rows = open_rows[~near]
    firsts, labels = np.unique(_clusters(places[open_rows], cluster_m), return_inverse=True)
    numbers[open_rows] = len(names) + labels
    names += [f"near {lights.ids[row]}" for row in open_rows[firsts].tolist()]
    return tuple(names), numbers


def _clusters(places: FloatArray, step_m: float) -> IntArray:
    """(n,) of (n, 2) places: the first row of the cluster of each, linked by steps of at most `step_m`."""
    n = len(places)
    if n < 2:
        return np.arange(n)
    pairs = cKDTree(places).query_pairs(step_m, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, labels = connected_components(links, directed=False)
    _, firsts, labels = np.unique(labels, return_index=True, return_inverse=True)
    return np.asarray(firsts[labels])


class _Lanes:
    """The lanes of a map in pieces, searchable by place."""

    def __init__(self, lights: TrafficLightMap, half_width_m: float) -> None:
        starts, ends, self._names = [], [], []
        for name, line in lights.lane_lines.items():
            for start, end in pairwise(line):
                count = max(1, int(np.ceil(np.linalg.norm(end - start) / _PIECE_M)))
                points = start + (end - start) * np.linspace(0, 1, count + 1)[:, None]
                starts.append(points[:-1])
                ends.append(points[1:])
                self._names += [name] * count
        self._starts = np.concatenate(starts)
        ways = np.concatenate(ends) - self._starts
        self._lengths_m = np.maximum(np.linalg.norm(ways, axis=1), 1e-9)
        self._ways = ways / self._lengths_m[:, None]
        self._tree = cKDTree(self._starts + ways / 2)
        self._half_width_m = half_width_m

    def under(self, pose: Pose) -> frozenset[str]:
        """Names of the lanes that the vehicle is on and follows."""
        place, way = pose.position[:2], pose.utm_from_ins[:2, 0]
        pieces = np.array(self._tree.query_ball_point(place, self._half_width_m + _PIECE_M / 2), dtype=np.int64)
        pieces = pieces[self._ways[pieces] @ way >= _LANE_COSINE * np.hypot(way[0], way[1])]
        if not len(pieces):
            return frozenset()
        offsets = place - self._starts[pieces]
        along_m = np.clip((offsets * self._ways[pieces]).sum(axis=1), 0, self._lengths_m[pieces])
        aside = offsets - along_m[:, None] * self._ways[pieces]
        aside_m = np.hypot(aside[:, 0], aside[:, 1])
        limit_m = min(self._half_width_m, float(aside_m.min()) + _EQUALLY_NEAR_M)
        return frozenset(self._names[piece] for piece in pieces[aside_m <= limit_m].tolist())


def _directions(headings_deg: FloatArray) -> FloatArray:
    heading = np.radians(headings_deg)
    return np.stack([np.sin(heading), np.cos(heading)], axis=-1)
