"""The lights that an HD map knows, and the question which of them are near."""

from collections import Counter
from dataclasses import dataclass, field

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
    _tree: cKDTree | None = field(init=False, repr=False, default=None)

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
        object.__setattr__(self, "_tree", cKDTree(self.positions) if n else None)

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
        )

    def within(self, position: FloatArray, radius_m: float) -> IntArray:
        """(k,) ascending indices of the lights at most `radius_m` from (3,) `position`."""
        if self._tree is None:
            return np.empty(0, dtype=np.int64)
        return np.array(sorted(self._tree.query_ball_point(position, radius_m)), dtype=np.int64)
