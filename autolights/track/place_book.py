"""Which place belongs to which light: `LightPlaces` for the lights that images were paired with."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from autolights.core import BoolArray, FloatArray, IntArray, TrafficLightMap
from autolights.track.camera_health import CameraHealth
from autolights.track.observation import SetObservation
from autolights.track.place_config import PlaceConfig
from autolights.track.places import LightPlaces

_MAX_LIGHTS = 1000  # beyond it half of the room is made free


class PlaceBook:
    """Positions of map lights and of unmapped ones, as the images tell.

    Args:
        lights: The map.
        cameras: Names.
        config: Standard deviations.
    """

    def __init__(self, lights: TrafficLightMap, cameras: Iterable[str], config: PlaceConfig) -> None:
        self._lights = lights
        self.places = LightPlaces(tuple(cameras), config)
        self._trusted_m = config.projected_sigmas * config.map_m
        self._alarm_delay_s = config.alarm_delay_s
        # Keys of the places' rows: rows of the map, or −1 − track id.
        self._keys: list[int] = []
        self._row_of_light: IntArray = np.full(len(lights) + 1, -1, dtype=np.int64)  # the last stands for no light
        self._row_of_track: dict[int, int] = {}
        self._sizes_m: FloatArray = np.empty((0, 3))
        self._seen_ns: IntArray = np.empty(0, dtype=np.int64)
        self._known: tuple[TrafficLightMap, FloatArray, BoolArray] | None = None  # of whom `knows` was asked last

    def take_in(self, observations: SetObservation, unmapped: TrafficLightMap, stamp_ns: int) -> None:
        """Learn from the pairs of one set of frames.

        Args:
            observations: The images.
            unmapped: The unmapped lights as the images were held against, track ids for names.
            stamp_ns: Latest stamp of the set.
        """
        lights, detections = observations.association.matches.T
        if len(lights):
            rows = self._rows(observations.projected.indices[lights], unmapped)
            boxes_xyxy = observations.detections.boxes_xyxy[detections]
            images = observations.known_in.take(lights)
            self.places.observe_set(rows, boxes_xyxy, observations.shots, images)
            self._seen_ns[rows] = stamp_ns
        self.places.settle(stamp_ns)
        if len(self._keys) > _MAX_LIGHTS:
            self._forget(unmapped)

    def with_delays(self, health: Mapping[str, CameraHealth]) -> dict[str, CameraHealth]:
        """What is known of each camera, and how late its images are."""
        told = {}
        for name, own in health.items():
            delay_s, sigma_s = self.places.delay_s(name)
            alarm = abs(delay_s) - 2 * sigma_s > self._alarm_delay_s
            told[name] = replace(own, delay_s=delay_s, delay_sigma_s=sigma_s, delay_alarm=alarm)
        return told

    def place(self, map_id: str | None, track_id: int) -> tuple[FloatArray, FloatArray] | None:
        """(3,) metres and (3, 3) m² of a light, by its name in the map or by its track; None if nothing is known."""
        return self.place_of(-1 - track_id if map_id is None else self._lights.ids.index(map_id))

    def place_of(self, key: int) -> tuple[FloatArray, FloatArray] | None:
        """The same by key: the row of the map, or −1 − track id."""
        row = int(self._row_of_light[key]) if key >= 0 else self._row_of_track.get(-1 - key, -1)
        return None if row < 0 else (self.places.positions[row], self.places.covariances[row])

    def offsets_m(self, known: IntArray) -> FloatArray:
        """(n, 3) metres from where lights of the map stand there to where they are to be looked for.

        That is where the images show them, but no farther off than `projected_sigmas` of the map: what was paired
        wrongly for a while must not draw a light over to its neighbour.

        Args:
            known: (n,) rows of the map; what counts on from its end are unmapped lights, which have no offset.
        """
        offsets = np.zeros((len(known), 3))
        rows = self._row_of_light[np.minimum(known, len(self._lights))]
        told = np.flatnonzero(rows >= 0)
        offsets[told] = self.places.positions[rows[told]] - self._lights.positions[known[told]]
        lengths = np.sqrt((offsets * offsets).sum(axis=1))
        offsets *= np.minimum(1.0, self._trusted_m / np.maximum(lengths, 1e-9))[:, None]
        return offsets

    def merge(self, unmapped: int, other: int, key: int) -> None:
        """Two lights are one.

        Args:
            unmapped: Key of an unmapped one, whose evidence goes to the other.
            other: Key of the other one.
            key: Of both from now on.
        """
        row, into = self._keys.index(unmapped), self._keys.index(other)
        self.places.merge(into, row)
        self._seen_ns[into] = max(self._seen_ns[into], self._seen_ns[row])
        keys = [key if i == into else old for i, old in enumerate(self._keys)]
        self._index(keys)
        self._keep(np.delete(np.arange(len(keys)), row))

    def rows_of(self, map_rows: IntArray, track_ids: IntArray) -> IntArray:
        """(n,) rows of `places`, −1 where nothing is known, by (n,) rows of the map; where negative by (n,) tracks."""
        rows, unmapped = self._row_of_light[map_rows], map_rows < 0
        rows[unmapped] = self._rows_of_tracks(track_ids[unmapped].tolist())
        return rows

    def knows(self, unmapped: TrafficLightMap) -> BoolArray:
        """(u,) of which unmapped lights the place is known well; track ids for names."""
        before, covariances, known = self._known or (None, None, None)
        if known is None or before is not unmapped or covariances is not self.places.covariances:
            known = self._well(self._rows_of_tracks(map(int, unmapped.ids)))
            self._known = unmapped, self.places.covariances, known
        return known

    def well_known(self, track_ids: IntArray) -> tuple[IntArray, FloatArray]:
        """Which of (n,) unmapped tracks have a place that is known well, and (k, 3) metres of these."""
        rows = self._rows_of_tracks(track_ids.tolist())
        which = self._well(rows).nonzero()[0]
        return which, self.places.positions.take(rows.take(which), axis=0)

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
        row_of_id = {light_id: row for row, light_id in enumerate(self._lights.ids)}
        keys = [row_of_id[light] if isinstance(light, str) else int(light) for light in values["lights"]]
        self.places.restore(values["places"])
        self._index(keys)
        self._sizes_m = np.array(values["sizes_m"], dtype=np.float64).reshape(-1, 3)
        self._seen_ns = np.array(values["seen_ns"], dtype=np.int64)

    def _rows(self, known: IntArray, unmapped: TrafficLightMap) -> IntArray:
        """Rows of lights, which begin where they are new; `known` counts map lights, then unmapped ones."""
        count = len(self._lights)
        rows = self._row_of_light.take(np.minimum(known, count))
        for i in (known >= count).nonzero()[0].tolist():
            rows[i] = self._row_of_unmapped(unmapped, int(known[i]) - count)
        new = (rows < 0).nonzero()[0]
        if not len(new):
            return rows
        lights = np.unique(known.take(new))
        mapped = int(lights.searchsorted(count))
        self._append(lights[:mapped].tolist(), self._lights, lights[:mapped])
        unmapped_lights = lights[mapped:] - count
        self._append([-1 - int(unmapped.ids[light]) for light in unmapped_lights.tolist()], unmapped, unmapped_lights)
        return self._rows(known, unmapped)

    def _row_of_unmapped(self, unmapped: TrafficLightMap, light: int) -> int:
        """−1 if there is none yet."""
        row = self._row_of_track.get(int(unmapped.ids[light]), -1)
        if row >= 0 and self._sizes_m[row].tolist() != unmapped.sizes_m[light].tolist():
            self._sizes_m[row] = unmapped.sizes_m[light]
            self.places.restart(row, float(unmapped.headings_deg[light]), unmapped.sizes_m[light])
        return row

    def _append(self, keys: list[int], source: TrafficLightMap, lights: IntArray) -> None:
        """Begin with some lights of a map, all of them mapped or none."""
        if not keys:
            return
        for row, key in enumerate(keys, start=len(self._keys)):
            if key >= 0:
                self._row_of_light[key] = row
            else:
                self._row_of_track[-1 - key] = row
        self._keys += keys
        sizes_m = source.sizes_m[lights]
        self.places.append(source.positions[lights], source.headings_deg[lights], sizes_m, on_map=keys[0] >= 0)
        self._sizes_m = np.concatenate([self._sizes_m, sizes_m])
        self._seen_ns = np.concatenate([self._seen_ns, np.zeros(len(keys), dtype=np.int64)])

    def _rows_of_tracks(self, tracks: Iterable[int]) -> IntArray:
        return np.array([self._row_of_track.get(track, -1) for track in tracks], dtype=np.int64)

    def _well(self, rows: IntArray) -> BoolArray:
        """(n,) of rows of `places`, −1 for none."""
        well = np.append(self.places.known(), False)
        return np.asarray(well.take(rows))

    def _index(self, keys: list[int]) -> None:
        """Note which row belongs to which key."""
        self._row_of_light[[key for key in self._keys if key >= 0]] = -1
        self._keys = keys
        self._row_of_track = {-1 - key: row for row, key in enumerate(keys) if key < 0}
        for row, key in enumerate(keys):
            if key >= 0:
                self._row_of_light[key] = row

    def _forget(self, unmapped: TrafficLightMap) -> None:
        """Make room: tracks that are no more go, then whoever was not seen for longest."""
        living = {-1 - int(track) for track in unmapped.ids}
        rows = np.array([row for row, key in enumerate(self._keys) if key >= 0 or key in living], dtype=np.int64)
        latest = np.argsort(-self._seen_ns[rows], kind="stable")[: _MAX_LIGHTS // 2]
        self._keep(np.sort(rows[latest]))

    def _keep(self, rows: IntArray) -> None:
        self.places.keep(rows)
        self._index([self._keys[row] for row in rows.tolist()])
        self._sizes_m, self._seen_ns = self._sizes_m[rows], self._seen_ns[rows]
