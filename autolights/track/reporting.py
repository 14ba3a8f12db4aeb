"""From the table of tracks to what a user of the runtime reads: estimates, and the rule behind each."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from autolights.core import CameraView, FloatArray, IntArray, LightEstimate, SignalSet, TrafficLightMap
from autolights.track.config import TrackConfig
from autolights.track.place_book import PlaceBook
from autolights.track.states import Reports
from autolights.track.track_table import TrackTable


class Reporter:
    """Writes estimates.

    Args:
        lights: The map.
        signals: The signal description.
        config: Of tracking.
    """

    def __init__(self, lights: TrafficLightMap, signals: SignalSet, config: TrackConfig) -> None:
        self._map_ids = lights.ids
        self._types = tuple(signals.types)
        self._classes = signals.classes
        self._config = config

    def estimates(
        self,
        table: TrackTable,
        reports: Reports,
        views: Mapping[int, Sequence[CameraView]],
        vehicle: FloatArray,
        set_ns: int,
        places: PlaceBook | None = None,
    ) -> list[LightEstimate]:
        """Estimates of the lights that were born and are in view or were seen lately, in the order of their ids.

        Args:
            table: n tracks.
            reports: What is said of their states.
            views: By row: where cameras saw it, or should have.
            vehicle: (3,) metres: where the vehicle is.
            set_ns: Stamp of the set.
            places: Where lights stand, as far as it knows better.
        """
        in_view = np.zeros(len(table), dtype=bool)
        in_view[list(views)] = True
        rows = (table.known & (in_view | (table.age_s(set_ns) <= self._config.max_coast_s))).nonzero()[0]
        withheld = table.stale(set_ns, self._config) | reports.doubtful
        positions, covariances = self._places(table, rows, places)
        offsets = positions - vehicle
        columns = zip(
            rows.tolist(),
            table.ids.take(rows).tolist(),
            table.map_rows.take(rows).tolist(),
            table.types.take(rows).tolist(),
            reports.class_ids.take(rows).tolist(),
            reports.probability.take(rows).tolist(),
            reports.flashing.take(rows).tolist(),
            withheld.take(rows).tolist(),
            positions,
            covariances,
            np.sqrt((offsets * offsets).sum(axis=1)).tolist(),
            table.last_seen_ns.take(rows).tolist(),
            strict=True,
        )
        return [
            LightEstimate.of_filter(
                stamp_ns=set_ns,
                track_id=track_id,
                map_id=None if map_row < 0 else self._map_ids[map_row],
                type=self._types[type_index],
                class_name=self._classes[class_id],
                probability=probability,
                flashing=flashing,
                withheld=hold,
                position=position,
                covariance=covariance,
                distance_m=distance_m,
                last_seen_ns=seen_ns,
                views=tuple(views.get(row, ())),
            )
            for (
                row,
                track_id,
                map_row,
                type_index,
                class_id,
                probability,
                flashing,
                hold,
                position,
                covariance,
                distance_m,
                seen_ns,
            ) in columns
        ]

    def _places(
        self, table: TrackTable, rows: IntArray, places: PlaceBook | None
    ) -> tuple[FloatArray, list[FloatArray | None]]:
        """(k, 3) metres of these tracks, and (3, 3) m² of each; None where nothing is known of a surveyed place."""
        positions, map_rows = table.positions.take(rows, axis=0), table.map_rows.take(rows)
        covariances: list[FloatArray | None] = [None] * len(rows)
        unknown = np.arange(len(rows))
        if places is not None:
            found = places.rows_of(map_rows, table.ids.take(rows))
            known, unknown = (found >= 0).nonzero()[0], (found < 0).nonzero()[0]
            found = found.take(known)
            if not len(unknown):
                return places.places.positions.take(found, axis=0), list(places.places.covariances.take(found, axis=0))
            positions[known] = places.places.positions.take(found, axis=0)
            for i, covariance in zip(known.tolist(), places.places.covariances.take(found, axis=0), strict=True):
                covariances[i] = covariance
        unmapped = unknown[map_rows.take(unknown) < 0]
        if len(unmapped):
            for i, covariance in zip(unmapped.tolist(), np.linalg.inv(table.information[rows[unmapped]]), strict=True):
                covariances[i] = covariance
        return positions, covariances

    def explain(self, table: TrackTable, reports: Reports | None, set_ns: int) -> list[dict[str, Any]]:
        """Life and rule of each track, as JSON-ready values."""
        ages_s, stale = table.age_s(set_ns).tolist(), table.stale(set_ns, self._config).tolist()
        return [
            {
                "track_id": int(table.ids[row]),
                "map_id": None if map_row < 0 else self._map_ids[map_row],
                "alive": bool(table.alive[row]),
                "hits": int(table.hits[row]),
                "misses": int(table.misses[row]),
                "rule": self._rule(table, row, ages_s[row], stale[row], reports),
            }
            for row, map_row in enumerate(table.map_rows.tolist())
        ]

    def _rule(self, table: TrackTable, row: int, age_s: float, stale: bool, reports: Reports | None) -> str:
        """What decided over the latest report of a light."""
        if not table.known[row]:
            return f"not born: {table.hits[row]} of {self._config.birth_hits} detections in a row"
        if stale:
            return f"withheld: not seen for {age_s:.2f} s"
        if reports is None:
            return "restored, nothing was said since"
        said = "flash" if reports.flashing[row] else "belief"
        if reports.doubtful[row]:
            said = "withheld: nothing is certain enough to act upon"
        elif reports.go_held[row]:
            said = "go held back: stop is not excluded"
        if reports.disputed[row]:
            said += "; at odds with its signal group"
        elif reports.shares[row]:
            said += "; shared with its signal group"
        return said if age_s == 0 else f"{said}; coasting for {age_s:.2f} s"
