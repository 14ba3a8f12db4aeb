"""The lights that an HD map knows, and the question which of them are near."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from autolights.core.arrays import FloatArray, IntArray, as_float_array
from autolights.core.errors import MapError


@dataclass(frozen=True, eq=False)
class TrafficLightMap:
    """Lights in columns, searchable by position.

    Attributes:
        ids: n unique names.
        types: n names of types of the signal description.
        positions: (n, 3) centre of the housing: east, north, up in metres.
        headings_deg: (n,) the way the face looks, clockwise from north.
        sizes_m: (n, 3) width, height, depth of the housing.
        intersections: n names, empty where the map gives none.
        groups: n names of signal groups, empty where the map gives none.
        lanes: n tuples of names of the lanes whose traffic each light governs, empty where the map gives none.
        lane_lines: By lane: (k, 2) east and north in metres along its middle, in the direction of travel.

    Raises:
        MapError: If ids repeat or a column does not fit.
    """

    ids: tuple[str, ...]
    types: tuple[str, ...]
    positions: FloatArray
    headings_deg: FloatArray
    sizes_m: FloatArray
    intersections: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()
    lanes: tuple[tuple[str, ...], ...] = ()
    lane_lines: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.ids)
        repeated = [light_id for light_id, count in Counter(self.ids).items() if count > 1]
        if repeated:
            raise MapError(f"light ids must be unique, got {repeated[0]!r} more than once")
        if len(self.types) != n:
            raise MapError(f"a map of {n} lights needs {n} types, got {len(self.types)}")
        try:
            for name, shape in (("positions", (n, 3)), ("headings_deg", (n,)), ("sizes_m", (n, 3))):
                object.__setattr__(self, name, as_float_array(getattr(self, name), shape, name))
        except ValueError as error:
            raise MapError(str(error)) from error
        for name in ("intersections", "groups"):
            column = getattr(self, name) or ("",) * n
            if len(column) != n:
                raise MapError(f"a map of {n} lights needs {n} {name}, got {len(column)}")
            object.__setattr__(self, name, tuple(column))
        lanes = self.lanes or ((),) * n
        if len(lanes) != n:
            raise MapError(f"a map of {n} lights needs {n} tuples of lanes, got {len(lanes)}")
        object.__setattr__(self, "lanes", lanes)
        for lane, line in self.lane_lines.items():
            if line.ndim != 2 or line.shape[1] != 2 or len(line) < 2 or not np.isfinite(line).all():
                raise MapError(f"lane '{lane}' needs a line of two points or more, got an array of shape {line.shape}")

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.positions)

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, indices: IntArray) -> "TrafficLightMap":
        """A map of the given rows only."""
        return TrafficLightMap(
            ids=tuple(self.ids[i] for i in indices),
            types=tuple(self.types[i] for i in indices),
            positions=self.positions[indices],
            headings_deg=self.headings_deg[indices],
            sizes_m=self.sizes_m[indices],
            intersections=tuple(self.intersections[i] for i in indices),
            groups=tuple(self.groups[i] for i in indices),
            lanes=tuple(self.lanes[i] for i in indices),
            lane_lines=self.lane_lines,
        )

    def within(self, position: FloatArray, radius_m: float) -> IntArray:
        """(k,) ascending indices of the lights at most `radius_m` from (3,) `position`."""
        if not len(self):
            return np.empty(0, dtype=np.int64)
        return np.sort(np.array(self._tree.query_ball_point(position, radius_m), dtype=np.int64))

    def at(self, positions: FloatArray) -> "TrafficLightMap":
        """The same lights at (n, 3) other places, which a filter made: they are not checked."""
        moved = object.__new__(TrafficLightMap)
        moved.__dict__.update({name: value for name, value in vars(self).items() if name != "_tree"})
        moved.__dict__["positions"] = positions
        return moved
