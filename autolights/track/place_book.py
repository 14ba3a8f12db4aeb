"""Which place belongs to which light: `LightPlaces` for the lights that images were paired with."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from autolights.core import FloatArray, IntArray, TrafficLightMap
from autolights.track.observation import CameraObservation
from autolights.track.places import LightPlaces, PlaceConfig

_MAX_LIGHTS = 1000  # beyond it those that were not seen for longest are forgotten


class PlaceBook:
    """Positions of map lights and of unmapped ones, as the images tell.

    Args:
        lights: The map.
        cameras: Names.
        config: Standard deviations.
    """

    def __init__(self, lights: TrafficLightMap, cameras: Iterable[str], config: PlaceConfig) -> None:
        self._lights = lights
        self._row_of_id = {light_id: row for row, light_id in enumerate(lights.ids)}
        self.places = LightPlaces(tuple(cameras), config)
        # Keys of the places' rows: rows of the map, or −1 − track id.
        self._keys: list[int] = []
        self._row_of_key: dict[int, int] = {}
        self._sizes_m: FloatArray = np.empty((0, 3))
        self._seen_ns: IntArray = np.empty(0, dtype=np.int64)

    def take_in(self, observations: Sequence[CameraObservation], unmapped: TrafficLightMap, stamp_ns: int) -> None:
        """Learn from the pairs of one set of frames.

        Args:
            observations: One per image.
            unmapped: The unmapped lights as the images were held against, track ids for names.
            stamp_ns: Latest stamp of the set.
        """
        for observation in sorted(observations, key=lambda observation: observation.camera.name):
            lights, detections = observation.association.matches.T
            known = observation.projected.indices[lights]
            if not len(known):
                continue
            rows = self._rows(known, unmapped)
            boxes_xyxy = observation.detections.boxes_xyxy[detections]
            self.places.observe(rows, boxes_xyxy, observation.camera, observation.pose)
            self._seen_ns[rows] = stamp_ns
        self.places.settle(stamp_ns)
        if len(self._keys) > _MAX_LIGHTS:
            self._keep(np.sort(np.argsort(-self._seen_ns, kind="stable")[: _MAX_LIGHTS // 2]))

    def place(self, map_id: str | None, track_id: int) -> tuple[FloatArray, FloatArray] | None:
        """(3,) metres and (3, 3) m² of a light, by its name in the map or by its track; None if nothing is known."""
        row = self._row_of_key.get(-1 - track_id if map_id is None else self._row_of_id[map_id])
        return None if row is None else (self.places.positions[row], self.places.covariances[row])

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values."""
        ids = [self._lights.ids[key] if key >= 0 else key for key in self._keys]
        return {
            "lights": ids,
            "sizes_m": self._sizes_m.tolist(),
            "seen_ns": self._seen_ns.tolist(),
            "places": self.places.to_json(),
        }

    def restore(self, values: dict[str, Any]) -> None:
        """Go on from where `to_json` left off, with the same track ids.

        Raises:
            KeyError: If a light is not on the map.
            ValueError: If it is of other cameras, or damaged.
        """
        keys = [self._row_of_id[light] if isinstance(light, str) else int(light) for light in values["lights"]]
        self.places.restore(values["places"])
        self._keys = keys
        self._row_of_key = {key: row for row, key in enumerate(keys)}
        self._sizes_m = np.array(values["sizes_m"], dtype=np.float64).reshape(-1, 3)
        self._seen_ns = np.array(values["seen_ns"], dtype=np.int64)

    def _rows(self, known: IntArray, unmapped: TrafficLightMap) -> IntArray:
        """Rows of lights, which begin where they are new; `known` counts map lights, then unmapped ones."""
        count = len(self._lights)
        keys = [row if row < count else -1 - int(unmapped.ids[row - count]) for row in known.tolist()]
        for key, row in zip(keys, known.tolist(), strict=True):
            on_map = row < count
            source, i = (self._lights, row) if on_map else (unmapped, row - count)
            if key not in self._row_of_key:
                self._row_of_key[key] = len(self._keys)
                self._keys.append(key)
                one = slice(i, i + 1)
                self.places.append(source.positions[one], source.headings_deg[one], source.sizes_m[one], on_map=on_map)
                self._sizes_m = np.concatenate([self._sizes_m, source.sizes_m[one]])
                self._seen_ns = np.append(self._seen_ns, 0)
            elif not on_map and not np.array_equal(self._sizes_m[self._row_of_key[key]], source.sizes_m[i]):
                place = self._row_of_key[key]
                self._sizes_m[place] = source.sizes_m[i]
                self.places.restart(place, float(source.headings_deg[i]), source.sizes_m[i])
        return np.array([self._row_of_key[key] for key in keys])

    def _keep(self, rows: IntArray) -> None:
        self.places.keep(rows)
        self._keys = [self._keys[row] for row in rows.tolist()]
        self._row_of_key = {key: row for row, key in enumerate(self._keys)}
        self._sizes_m, self._seen_ns = self._sizes_m[rows], self._seen_ns[rows]
