"""The tracks of lights that the map does not hold, as lights to be projected and associated like those of the map."""

import numpy as np

from autolights.core import FloatArray, IntArray, TrafficLightMap
from autolights.track.place_book import PlaceBook
from autolights.track.projection import ANY_TYPE
from autolights.track.track_table import TrackTable

_MOVED_M = 0.01  # lights are placed anew once one of them is this far from where it stands here


class UnmappedLights:
    """Rows of a track table and the lights in them, in the same order; tentative ones too.

    Args:
        sizes_m: (t, 3) width, height, depth of the housings of each type.

    Attributes:
        rows: (u,) of the table.
        lights: Of any type, track ids for names; the same object as long as nothing changes.
    """

    rows: IntArray
    lights: TrafficLightMap

    def __init__(self, sizes_m: FloatArray) -> None:
        self._sizes_m = sizes_m
        self._taken_over: FloatArray | None = None  # the places' positions, which are other ones after each change
        self._take_up(TrackTable.empty(len(sizes_m)))

    def follow(self, table: TrackTable, places: PlaceBook | None = None) -> None:
        """Take over who there is now, of which type, and where.

        Args:
            table: All tracks. Lights that `places` knows are moved to where all images together have them.
            places: Where lights stand, as far as the images tell.
        """
        rows = self.rows = (table.map_rows < 0).nonzero()[0]
        if places is not None and places.places.positions is not self._taken_over:
            self._taken_over = places.places.positions
            known, positions = places.well_known(table.ids.take(rows))
            table.positions[rows.take(known)] = positions
        if len(rows) != len(self._ids) or np.count_nonzero(
            (table.ids.take(rows) != self._ids) | (table.types.take(rows) != self._types)
        ):
            self._take_up(table)
        elif len(rows):
            positions = table.positions.take(rows, axis=0)
            if np.count_nonzero(np.abs(positions - self.lights.positions) > _MOVED_M):
                self.lights = self.lights.at(positions)

    def restore(self, table: TrackTable, positions: FloatArray) -> None:
        """Follow a table, with the lights at (u, 3) positions, which may be a little behind the table's."""
        self._taken_over = None
        self._take_up(table)
        self.lights = self.lights.at(positions.reshape(self.lights.positions.shape))

    def _take_up(self, table: TrackTable) -> None:
        self.rows = (table.map_rows < 0).nonzero()[0]
        self._ids, self._types = table.ids[self.rows], table.types[self.rows]
        self.lights = TrafficLightMap(
            ids=tuple(map(str, self._ids.tolist())),
            types=(ANY_TYPE,) * len(self.rows),
            positions=table.positions[self.rows],
            headings_deg=table.headings_deg[self.rows],
            sizes_m=self._sizes_m.take(self._types, axis=0),
        )
