"""One light over time: its life, its memory, its place and the belief in its state."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from autolights.core import CameraView, FloatArray
from autolights.track.config import TrackConfig
from autolights.track.observation import Sighting


@dataclass(eq=False)
class Track:
    """A light that was detected at least once.

    Attributes:
        id: Unique for the life of the pipeline.
        map_row: Row of the map light that it is, or None.
        type: The map's, or the vote over all sightings.
        position: (3,) metres; the map's, or an average of localisations.
        information: (3, 3) 1/m² behind an unmapped position: the inverse of its covariance. None for a map light.
        heading_deg: The map's, or the way to the vehicle at the first sight.
        belief: (k,) over the type's states.
        last_seen_ns: Set in which it was detected last.
        last_set_ns: Latest set.
        hits: Consecutive sets with a detection, before birth.
        misses: Sets in which it was expected but not detected, since the last detection.
        missed_ns: The time that they cover.
        alive: Born and not dead: its state may be reported.
        known: Born at least once: an unmapped light keeps its place after death.
        history: Unfiltered sightings.
        type_votes: Sightings per type.
        views: Of the latest set.
    """

    id: int
    map_row: int | None
    type: str
    position: FloatArray
    information: FloatArray | None
    heading_deg: float
    belief: FloatArray
    last_seen_ns: int
    last_set_ns: int
    hits: int = 0
    misses: int = 0
    missed_ns: int = 0
    alive: bool = False
    known: bool = False
    history: deque[Sighting] = field(default_factory=deque)
    type_votes: dict[str, int] = field(default_factory=dict)
    views: list[CameraView] = field(default_factory=list)

    @property
    def detected(self) -> bool:
        """Whether any camera detected it in the latest set."""
        return any(view.box_xyxy is not None for view in self.views)

    @property
    def starts_anew(self) -> bool:
        """Whether nothing is remembered of its state: not born yet and not detected in the set before."""
        return not self.alive and self.hits == 0

    def end_set(self, set_ns: int, config: TrackConfig) -> None:
        """Count the set that ends as a hit, as a miss, or as neither where no camera covered the light."""
        if self.detected:
            self.hits += 1
            self.misses, self.missed_ns = 0, 0
            self.last_seen_ns = set_ns
            if self.hits >= config.birth_hits:
                self.alive = self.known = True
        elif self.views:
            self.misses += 1
            self.missed_ns += set_ns - self.last_set_ns
            if not self.alive or self._is_due(config):
                self.alive, self.hits = False, 0
                self.history.clear()
        self.last_set_ns = set_ns

    def is_stale(self, set_ns: int, config: TrackConfig) -> bool:
        """Whether its state is too old to act upon."""
        return not self.alive or (config.mode == "timed" and self.age_s(set_ns) > config.max_coast_s)

    def age_s(self, set_ns: int) -> float:
        """Seconds since the last detection."""
        return (set_ns - self.last_seen_ns) / 1e9

    def remember(self, sighting: Sighting, type_name: str, config: TrackConfig) -> None:
        """Add an unfiltered sighting and forget what is too old."""
        self.history.append(sighting)
        self.type_votes[type_name] = self.type_votes.get(type_name, 0) + 1
        oldest_ns = sighting.set_ns - config.history_s * 1e9
        while len(self.history) > config.history_size and self.history[0].set_ns < oldest_ns:
            self.history.popleft()

    def refine_position(self, position: FloatArray, information: FloatArray) -> None:
        """Average in one localisation of an unmapped light, each weighted by what it says (a static Kalman filter)."""
        assert self.information is not None
        self.information = self.information + information
        self.position = self.position + np.linalg.solve(self.information, information @ (position - self.position))

    def _is_due(self, config: TrackConfig) -> bool:
        if config.mode == "paper":
            return self.misses > config.death_sets
        return self.missed_ns > config.max_coast_s * 1e9
