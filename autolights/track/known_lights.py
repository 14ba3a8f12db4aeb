"""The lights that can come into view: those of the map around the vehicle, and those that only the images know."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from autolights.core import BoolArray, FloatArray, IntArray, TrafficLightMap
from autolights.core.light_box import RANGE_MARGIN, light_corners
from autolights.track.projection import ANY_TYPE, NameArray

_CELL_M = 10.0  # edge of the cells for which the map is searched: the part that is held ready reaches so much farther
_WINDOWS = 4  # are kept, for a vehicle that stands where cells meet
ANY_CODE = -1  # of a light whose type is still being voted on


@dataclass(frozen=True, eq=False)
class KnownLights:
    """n lights that stand still, ready to be projected.

    Attributes:
        rows: (n,) ascending rows of the map; unmapped lights count on from the map's length.
        on_map: (n,) whether the map holds them.
        types: (n,) names; `ANY_TYPE` matches all.
        type_codes: (n,) their places among the types; `ANY_CODE` matches all.
        origin: (3,) metres, map frame, near all of them.
        positions: (3, n) metres from the origin.
        housings: (3, 8, n) corners, metres from each light's own place.
        corners: (3, 8, n) metres from the origin: where the housings are looked for.
        faces: (2, n) the way they look, east and north.
    """

    rows: IntArray
    on_map: BoolArray
    types: NameArray
    type_codes: IntArray
    origin: FloatArray
    positions: FloatArray
    housings: FloatArray
    corners: FloatArray
    faces: FloatArray

    @classmethod
    def of(
        cls,
        lights: TrafficLightMap,
        indices: IntArray,
        type_names: Sequence[str],
        origin: FloatArray,
        *,
        first_row: int,
        on_map: bool,
    ) -> Self:
        """Some lights of a map, whose own rows count from `first_row`."""
        types = [lights.types[i] for i in indices.tolist()]
        headings_deg = lights.headings_deg[indices]
        heading = np.radians(headings_deg)
        places = np.ascontiguousarray((lights.positions[indices] - origin).T)
        housings = light_corners(np.zeros((len(indices), 3)), headings_deg, lights.sizes_m[indices])
        housings = np.ascontiguousarray(housings.T)
        code_of = {name: code for code, name in enumerate(type_names)} | {ANY_TYPE: ANY_CODE}
        return cls(
            rows=indices + first_row,
            on_map=np.full(len(indices), on_map),
            types=np.array(types, dtype=np.str_),
            type_codes=np.array([code_of[name] for name in types], dtype=np.int64),
            origin=origin,
            positions=places,
            housings=housings,
            corners=housings + places[:, None],
            faces=np.array([np.sin(heading), np.cos(heading)]),
        )

    def __len__(self) -> int:
        return len(self.rows)

    def moved(self, first: int, positions: FloatArray) -> "KnownLights":
        """The same lights, those from `first` on at (m, 3) other places of the map frame."""
        places, corners = self.positions.copy(), self.corners.copy()
        places[:, first:] = (positions - self.origin).T
        corners[:, :, first:] = self.housings[:, :, first:] + places[:, None, first:]
        return replace(self, positions=places, corners=corners)

    def looked_for_at(self, offsets_m: FloatArray) -> "KnownLights":
        """The same lights, whose housings are (3, n) metres beside their places."""
        return replace(self, corners=self.corners + offsets_m[:, None])

    def and_also(self, more: "KnownLights") -> "KnownLights":
        """These lights, then others with the same origin."""
        return KnownLights(
            rows=np.concatenate([self.rows, more.rows]),
            on_map=np.concatenate([self.on_map, more.on_map]),
            types=np.concatenate([self.types, more.types]),
            type_codes=np.concatenate([self.type_codes, more.type_codes]),
            origin=self.origin,
            positions=np.concatenate([self.positions, more.positions], axis=1),
            housings=np.concatenate([self.housings, more.housings], axis=2),
            corners=np.concatenate([self.corners, more.corners], axis=2),
            faces=np.concatenate([self.faces, more.faces], axis=1),
        )


class Surroundings:
    """Keeps the known lights around the vehicle ready; a search of the map is due only after some metres.

    Args:
        lights: The map.
        type_names: All types.
        range_m: Of the camera that sees farthest.
    """

    def __init__(self, lights: TrafficLightMap, type_names: Sequence[str], range_m: float) -> None:
        self._lights = lights
        self._type_names = tuple(type_names)
        self._reach_m = RANGE_MARGIN * range_m + _CELL_M
        self._windows: dict[tuple[int, ...], KnownLights] = {}
        self._cell: tuple[int, ...] | None = None
        self._unmapped: TrafficLightMap | None = None
        self._known: KnownLights | None = None

    def around(self, position: FloatArray, unmapped: TrafficLightMap) -> KnownLights:
        """The lights of the map within the cameras' reach of (3,) `position` and a little beyond, and all unmapped."""
        # By cells, so that what is computed depends on the place alone, not on the way there.
        cell = tuple(round(metres / _CELL_M) for metres in position.tolist())
        if cell != self._cell:
            self._cell, self._known = cell, None
        window = self._windows.get(cell)
        if window is None:
            if len(self._windows) >= _WINDOWS:
                del self._windows[next(iter(self._windows))]
            window = self._windows[cell] = self._cut_out(np.array(cell) * _CELL_M)
        if self._known is None or self._unmapped is not unmapped:
            self._known = self._joined(window, unmapped)
            self._unmapped = unmapped
        return self._known

    def _cut_out(self, centre: FloatArray) -> KnownLights:
        near = self._lights.within(centre, self._reach_m)
        return KnownLights.of(self._lights, near, self._type_names, centre, first_row=0, on_map=True)

    def _joined(self, window: KnownLights, unmapped: TrafficLightMap) -> KnownLights:
        if not len(unmapped):
            return window
        before, known = self._unmapped, self._known
        if known is not None and before is not None and before.ids is unmapped.ids:  # they have only moved
            return known.moved(len(window), unmapped.positions)
        more = KnownLights.of(
            unmapped,
            np.arange(len(unmapped)),
            self._type_names,
            window.origin,
            first_row=len(self._lights),
            on_map=False,
        )
        return window.and_also(more)
