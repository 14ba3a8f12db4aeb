"""All tracks in columns: life, place and type of each light; what is known of its state is kept elsewhere."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from autolights.core import BoolArray, FloatArray, IntArray
from autolights.track.config import TrackConfig


@dataclass(eq=False)
class TrackTable:
    """n lights that were detected at least once, a row for each.

    Attributes:
        ids: (n,) unique for the life of the pipeline, ascending.
        map_rows: (n,) row of the map light that it is, or −1.
        types: (n,) index of the map's type, or of the vote over all sightings.
        type_votes: (n, types) sightings of each type.
        positions: (n, 3) metres; the map's, an average of localisations, or what a `PlaceBook` made of all boxes.
        information: (n, 3, 3) 1/m² behind the average of an unmapped light. 0 for a map light.
        headings_deg: (n,) the map's, or the way to the vehicle at the first sight.
        last_seen_ns: (n,) set in which it was detected last.
        hits: (n,) consecutive sets with a detection, before birth.
        misses: (n,) sets in which it was expected but not detected, since the last detection.
        missed_ns: (n,) the time that they cover.
        alive: (n,) born and not dead: its state may be reported.
        known: (n,) born at least once: an unmapped light keeps its place after death.
    """

    ids: IntArray
    map_rows: IntArray
    types: IntArray
    type_votes: IntArray
    positions: FloatArray
    information: FloatArray
    headings_deg: FloatArray
    last_seen_ns: IntArray
    hits: IntArray
    misses: IntArray
    missed_ns: IntArray
    alive: BoolArray
    known: BoolArray

    @classmethod
    def empty(cls, type_count: int) -> Self:
        """No track."""
        shapes = {"type_votes": (0, type_count), "positions": (0, 3), "information": (0, 3, 3)}
        return cls(**{name: np.zeros(shapes.get(name, (0,)), dtype) for name, dtype in _DTYPES.items()})

    def __len__(self) -> int:
        return len(self.ids)

    def append(
        self,
        *,
        ids: IntArray,
        map_rows: IntArray,
        types: IntArray,
        positions: FloatArray,
        information: FloatArray,
        headings_deg: FloatArray,
        set_ns: int,
    ) -> IntArray:
        """Add lights that were just detected for the first time; returns their rows."""
        m = len(ids)
        zeros = np.zeros(m, dtype=np.int64)
        new = {
            "ids": ids,
            "map_rows": map_rows,
            "types": types,
            "type_votes": np.zeros((m, self.type_votes.shape[1]), dtype=np.int64),
            "positions": positions,
            "information": information,
            "headings_deg": headings_deg,
            "last_seen_ns": np.full(m, set_ns, dtype=np.int64),
            "hits": zeros,
            "misses": zeros,
            "missed_ns": zeros,
            "alive": zeros.astype(bool),
            "known": zeros.astype(bool),
        }
        for name, values in new.items():
            setattr(self, name, np.concatenate([getattr(self, name), values]))
        return np.arange(len(self) - m, len(self))

    def keep(self, rows: IntArray) -> None:
        """Forget all but these rows."""
        for name in _DTYPES:
            setattr(self, name, getattr(self, name)[rows])

    @property
    def starts_anew(self) -> BoolArray:
        """(n,) whether nothing is remembered of its state: not born yet and not detected in the set before."""
        return np.asarray(~self.alive & (self.hits == 0))

    def age_s(self, set_ns: int) -> FloatArray:
        """(n,) seconds since the last detection."""
        return np.asarray((set_ns - self.last_seen_ns) / 1e9)

    def let_go(self, set_ns: int, config: TrackConfig) -> None:
        """Let lights die that were out of sight for so long that nothing is known of their states any more."""
        if config.mode == "timed":
            gone = set_ns - self.last_seen_ns > config.state_memory_s * 1e9
            if np.count_nonzero(gone):
                self.alive, self.hits = self.alive & ~gone, np.where(gone, 0, self.hits)

    def end_set(
        self, detected: BoolArray, expected: BoolArray, set_ns: int, elapsed_ns: int, config: TrackConfig
    ) -> None:
        """Count a set as a hit, as a miss, or as neither where no camera covered the light.

        Args:
            detected: (n,) by any camera.
            expected: (n,) in view of a camera.
            set_ns: Stamp of the set.
            elapsed_ns: Since the set before.
            config: Birth and death.
        """
        unseen = ~detected
        missed = expected & unseen
        self.hits = self.hits + detected
        self.misses = (self.misses + missed) * unseen
        self.missed_ns = (self.missed_ns + missed * elapsed_ns) * unseen
        self.last_seen_ns = np.where(detected, set_ns, self.last_seen_ns)
        born = detected & (self.hits >= config.birth_hits)
        if config.mode == "paper":
            due = self.misses > config.death_sets
        else:
            due = self.missed_ns > config.max_coast_s * 1e9
        dead = missed & (~self.alive | due)
        self.alive = (self.alive | born) & ~dead
        self.known = self.known | born
        self.hits = self.hits * ~dead

    def stale(self, set_ns: int, config: TrackConfig) -> BoolArray:
        """(n,) whether a state is too old to act upon."""
        too_old = (self.age_s(set_ns) > config.max_coast_s) if config.mode == "timed" else False
        return np.asarray(~self.alive | too_old)

    def vote(self, rows: IntArray, seen_types: IntArray) -> IntArray:
        """Count what lights of one image were seen as; returns the rows that have another type now."""
        self.type_votes[rows, seen_types] += 1
        votes = self.type_votes[rows]
        outvoted = votes.max(axis=1) > votes[np.arange(len(rows)), self.types[rows]]
        changed: IntArray = rows[outvoted]
        self.types[changed] = np.argmax(votes[outvoted], axis=1)
        return changed

    def refine_positions(self, rows: IntArray, positions: FloatArray, information: FloatArray) -> None:
        """Average in localisations of unmapped lights, each weighted by what it says (a static Kalman filter).

        Args:
            rows: (m,); one that several cameras saw may come several times.
            positions: (m, 3) metres.
            information: (m, 3, 3) 1/m².
        """
        pulls = information @ (positions - self.positions.take(rows, axis=0))[:, :, None]
        slots: dict[int, int] = {}
        of_each = [slots.setdefault(row, len(slots)) for row in rows.tolist()]
        each = np.array(list(slots))
        terms = np.concatenate([information, pulls], axis=2).reshape(-1, 12)
        of_light = np.zeros((len(each), len(rows)))
        of_light[of_each, np.arange(len(rows))] = 1.0
        told = (of_light @ terms).reshape(-1, 3, 4)
        total = self.information.take(each, axis=0) + told[:, :, :3]
        self.information[each] = total
        self.positions[each] += np.linalg.solve(total, told[:, :, 3:])[..., 0]

    def absorb(self, row: int, other: int) -> None:
        """Two tracks are one light of one type: the first gets what is known of the second; nothing counts twice."""
        if self.map_rows[row] < 0 and self.map_rows[other] < 0:
            self.refine_positions(np.array([row]), self.positions[[other]], self.information[[other]])
        elif self.map_rows[row] < 0:
            self.information[row] = 0.0
            for name in ("map_rows", "positions", "headings_deg"):
                getattr(self, name)[row] = getattr(self, name)[other]
        if self.last_seen_ns[other] > self.last_seen_ns[row]:
            for name in ("misses", "missed_ns", "last_seen_ns"):
                getattr(self, name)[row] = getattr(self, name)[other]
        self.type_votes[row] += self.type_votes[other]
        self.hits[row] = max(self.hits[row], self.hits[other])
        self.alive[row] |= self.alive[other]
        self.known[row] |= self.known[other]

    def to_json(self) -> dict[str, Any]:
        """All columns as JSON-ready values."""
        return {name: getattr(self, name).tolist() for name in _DTYPES}

    @classmethod
    def from_json(cls, values: dict[str, Any], type_count: int) -> Self:
        """Read what `to_json` gave."""
        table = cls.empty(type_count)
        for name, dtype in _DTYPES.items():
            column: Any = np.array(values[name], dtype=dtype)
            setattr(table, name, column.reshape(-1, *getattr(table, name).shape[1:]))
        return table


_FLOATS, _BOOLS = ("positions", "information", "headings_deg"), ("alive", "known")
_DTYPES: dict[str, type] = {
    name: np.float64 if name in _FLOATS else np.bool_ if name in _BOOLS else np.int64
    for name in TrackTable.__annotations__
}
