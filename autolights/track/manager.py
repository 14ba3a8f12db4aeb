"""All tracks: observations of several cameras in, one estimate per light out (Wu et al. 2023, Sec. III-C)."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from autolights.core import (
    CameraView,
    FloatArray,
    HmmParameters,
    IntArray,
    LightEstimate,
    SignalSet,
    TrafficLightMap,
)
from autolights.core.errors import DataError
from autolights.track.camera_views import note_views
from autolights.track.config import TrackConfig
from autolights.track.linking import link_across_cameras
from autolights.track.localization import information_along
from autolights.track.misses import in_plain_view
from autolights.track.observation import CameraObservation, SetObservation
from autolights.track.paper_states import PaperStates
from autolights.track.place_book import PlaceBook
from autolights.track.reporting import Reporter
from autolights.track.saved_state import STATE_FORMAT, refuse_other
from autolights.track.signal_groups import group_numbers
from autolights.track.states import LightStates, Looks, Reports
from autolights.track.timed_states import TimedStates
from autolights.track.track_table import TrackTable
from autolights.track.unmapped_lights import UnmappedLights


class _Seen(NamedTuple):
    """What images told: detections of tracks, image by image, and tracks that they should have shown but did not."""

    rows: IntArray
    detections: IntArray
    missed: IntArray


class TrackManager:
    """Tracks of mapped and unmapped lights.

    Args:
        lights: The map.
        signals: The signal description.
        hmm: One model per type.
        config: Birth, death and memory.
        last_id: Track ids begin after it.
    """

    def __init__(
        self,
        lights: TrafficLightMap,
        signals: SignalSet,
        hmm: Mapping[str, HmmParameters],
        config: TrackConfig,
        *,
        last_id: int = 0,
    ) -> None:
        self._lights = lights
        self._signals = signals
        self._config = config
        self._type_names = list(signals.types)
        self._class_types = np.array([self._type_names.index(signals.type_of[name]) for name in signals.classes])
        sizes_m = signals.sizes_m(self._type_names)
        self._heights_m = sizes_m[:, 1]
        self._map_types = np.array([self._type_names.index(name) for name in lights.types], dtype=np.int64)
        self._map_groups = group_numbers(lights)
        self._reporter = Reporter(lights, signals, config)
        self._table = TrackTable.empty(len(self._type_names))
        nobody: IntArray = np.empty(0, dtype=np.int64)
        self._no_looks = Looks(nobody, np.empty((0, len(signals.classes))), np.empty(0), nobody)
        make = TimedStates if config.mode == "timed" else PaperStates
        self._states: LightStates = make(signals, hmm, config)
        self._row_of_light = np.full(len(lights) + 1, -1, dtype=np.int64)  # the last stands for no light of the map
        self._unmapped = UnmappedLights(sizes_m)
        self._touched = np.empty(0, dtype=bool)
        self._views: dict[int, list[CameraView]] = {}
        self._last_set_ns: int | None = None
        self.last_id = last_id
        self._reports: Reports | None = None

    @property
    def unmapped(self) -> TrafficLightMap:
        """Lights that the map does not hold, tentative ones too: projected and associated exactly like map lights."""
        return self._unmapped.lights

    def __len__(self) -> int:
        """How many lights are remembered."""
        return len(self._table)

    def update(
        self,
        observations: SetObservation | Sequence[CameraObservation],
        stamp_ns: int,
        places: PlaceBook | None = None,
    ) -> list[LightEstimate]:
        """Take in one set of frames.

        Args:
            observations: One per image, held against the map and `unmapped` as they are now, in any order.
            stamp_ns: Latest stamp of the set; no earlier than the last set's.
            places: Where lights stand, as far as that is known better than by the map and by these tracks; unmapped
                ones are moved there.

        Returns:
            Estimates of all lights that were born, in the order of their track ids. A light whose state is too old is
            withheld; one that is out of sight for long is not mentioned.

        Raises:
            ValueError: If `stamp_ns` is earlier than the last set's.
        """
        if self._last_set_ns is not None and stamp_ns < self._last_set_ns:
            raise ValueError(f"sets must come in the order of time, got {stamp_ns} after {self._last_set_ns}")
        elapsed_ns = 0 if self._last_set_ns is None else stamp_ns - self._last_set_ns
        self._last_set_ns = stamp_ns
        self._views = {}
        self._table.let_go(stamp_ns, self._config)
        self._states.let_time_pass(stamp_ns)
        self._touched = np.zeros(len(self._table), dtype=bool)
        seen: list[_Seen] = []
        looks = self._no_looks
        if observations:
            if not isinstance(observations, SetObservation):
                observations = SetObservation.of(observations)
            seen = [self._match(observations, stamp_ns), *self._start_tracks(observations, stamp_ns)]
            looks = self._looks(observations, seen)
        self._states.take_in(looks)
        self._count_set(seen, stamp_ns, elapsed_ns)
        self._reports = self._states.report()
        estimates: list[LightEstimate] = []
        if isinstance(observations, SetObservation):
            vehicle = observations.shots.vehicle[-1]
            estimates = self._reporter.estimates(self._table, self._reports, self._views, vehicle, stamp_ns, places)
        self._forget(stamp_ns, places)
        return estimates

    def merge(self, unmapped: int, other: int) -> int | None:
        """Take two tracks of one type for one light; the older id stays, evidence counts once.

        Args:
            unmapped: Key of a light that the map does not hold: −1 − track id.
            other: Of another one, or the row of the map.

        Returns:
            Key of the light from now on; None if they are of different types, or the map's light has no track.
        """
        table = self._table
        second = self._row_of_light[other] if other >= 0 else np.searchsorted(table.ids, -1 - other)
        ordered = sorted((int(np.searchsorted(table.ids, -1 - unmapped)), int(second)))
        if ordered[0] < 0 or table.types[ordered[0]] != table.types[ordered[1]]:
            return None
        first, last = ordered
        # A light of the map keeps its own belief, which its group may share; else the latest is heard.
        mapped = [row for row in ordered if table.map_rows[row] >= 0]
        source = mapped[0] if mapped else max(ordered, key=lambda row: int(table.last_seen_ns[row]))
        self._states.merge(first, last, source)
        table.absorb(first, last)
        self._keep(np.delete(np.arange(len(table)), last))
        self._unmapped.follow(table)
        return other if other >= 0 else -1 - int(table.ids[first])

    def take_over(self, places: PlaceBook) -> None:
        """Let unmapped lights stand where `places` has them, after two of them turned out to be one."""
        self._unmapped.follow(self._table, places)

    def explain(self) -> list[dict[str, Any]]:
        """What is known of each light and which rule made its report, as JSON-ready values."""
        told = self._reporter.explain(self._table, self._reports, self._last_set_ns or 0)
        return [{**entry, **self._states.explain(row)} for row, entry in enumerate(told)]

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values; `restore` goes on from there with equal estimates."""
        map_rows = self._table.map_rows.tolist()
        return {
            "format": STATE_FORMAT,
            "signals": self._signals.name,
            "config": self._config.model_dump(mode="json"),
            "last_set_ns": self._last_set_ns,
            "next_id": self.last_id,
            "map_ids": [None if row < 0 else self._lights.ids[row] for row in map_rows],
            "tracks": self._table.to_json(),
            "unmapped": self._unmapped.lights.positions.tolist(),
            "states": self._states.to_json(),
        }

    def restore(self, values: dict[str, Any]) -> None:
        """Go on from where `to_json` left off.

        Raises:
            DataError: If the state is of another format, signal description, map or setting, or is damaged.
        """
        try:
            refuse_other(values, self._signals.name, self._config)
            row_of_id = {light_id: row for row, light_id in enumerate(self._lights.ids)}
            unknown = [light_id for light_id in values["map_ids"] if light_id is not None and light_id not in row_of_id]
            if unknown:
                raise DataError(f"tracking state: light '{unknown[0]}' is not on the map; start without the state")
            table = TrackTable.from_json(values["tracks"], len(self._type_names))
            table.map_rows = np.array(
                [-1 if light_id is None else row_of_id[light_id] for light_id in values["map_ids"]], dtype=np.int64
            )
            self._states.restore(values["states"], table.types.copy())
            self._unmapped.restore(table, np.array(values["unmapped"], dtype=np.float64))
            self._table = table
            self._last_set_ns, self.last_id = values["last_set_ns"], int(values["next_id"])
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(f"tracking state: damaged ({type(error).__name__}: {error}); start without it") from error
        self._row_of_light[:] = -1
        self._place_map_lights()
        self._views, self._reports = {}, None

    def _match(self, observation: SetObservation, set_ns: int) -> _Seen:
        """Give each detection that was matched to its track; note who was expected in vain."""
        projected, association = observation.projected, observation.association
        lights, detections = association.matches.T
        known = projected.indices.take(lights)
        rows = self._rows_of(known)
        unknown = known[rows < 0]
        if len(unknown):
            _, first = np.unique(unknown, return_index=True)
            self._start_map_tracks(unknown[np.sort(first)], set_ns)
            rows = self._rows_of(known)
        left = association.unmatched_lights
        left = left[projected.expected.take(left)]
        missed = self._rows_of(projected.indices.take(left))
        left, missed = left[missed >= 0], missed[missed >= 0]
        images, missed_in = observation.known_in.take(lights), observation.known_in.take(left)
        boxes = observation.detections.boxes_xyxy
        seen_at = boxes.take(detections, axis=0)
        note_views(self._views, observation.shots, rows, images, seen_at, missed, missed_in)
        if len(missed):
            in_view = in_plain_view(
                projected.boxes_xyxy[left],
                boxes,
                min_height_px=self._config.min_missed_px,
                together=missed_in[:, None] == observation.seen_in,
            )
            missed = missed[in_view]
        self._remember(rows, observation, detections, images)
        return _Seen(rows, detections, missed)

    def _rows_of(self, known: IntArray) -> IntArray:
        """Rows of the table for rows of map and index; −1 for a map light that has no track."""
        count = len(self._lights)
        rows = self._row_of_light.take(np.minimum(known, count))
        off_map = (known >= count).nonzero()[0]
        if len(off_map):
            rows[off_map] = self._unmapped.rows.take(known.take(off_map) - count)
        return rows

    def _start_map_tracks(self, map_rows: IntArray, set_ns: int) -> None:
        m = len(map_rows)
        self._append(
            map_rows=map_rows,
            types=self._map_types[map_rows],
            positions=self._lights.positions[map_rows],
            information=np.zeros((m, 3, 3)),
            headings_deg=self._lights.headings_deg[map_rows],
            set_ns=set_ns,
        )

    def _append(self, *, map_rows: IntArray, types: IntArray, set_ns: int, **columns: FloatArray) -> IntArray:
        ids = self.last_id + 1 + np.arange(len(map_rows))
        self.last_id += len(map_rows)
        rows = self._table.append(ids=ids, map_rows=map_rows, types=types, set_ns=set_ns, **columns)
        groups = np.full(len(rows), -1, dtype=np.int64)
        on_map = map_rows >= 0
        groups[on_map] = self._map_groups[map_rows[on_map]]
        self._row_of_light[map_rows[on_map]] = rows[on_map]
        self._states.append(types, groups)
        self._touched = np.concatenate([self._touched, np.ones(len(rows), dtype=bool)])
        return rows

    def _remember(self, rows: IntArray, observation: SetObservation, detections: IntArray, images: IntArray) -> None:
        """Let lights that come back start anew; let unmapped ones be placed and typed by what was seen."""
        table = self._table
        anew = rows[(table.starts_anew & ~self._touched).take(rows)]
        if len(anew):
            anew = np.unique(anew)
            self._states.start_anew(anew, table.types[anew])
        self._touched[rows] = True
        unmapped = (table.map_rows.take(rows) < 0).nonzero()[0]
        if len(unmapped):
            self._learn(rows.take(unmapped), observation, detections.take(unmapped), images.take(unmapped))

    def _learn(self, rows: IntArray, observation: SetObservation, detections: IntArray, images: IntArray) -> None:
        """Let unmapped lights be typed by what was seen, and placed as long as no other images know their places."""
        table = self._table
        seen_types = self._class_types.take(observation.detections.class_ids.take(detections))
        if not np.count_nonzero(seen_types != table.types.take(rows)):
            np.add.at(table.type_votes, (rows, seen_types), 1)
        else:  # another type may win, and then lose again: one image after the other
            for image in np.unique(images):
                here = images == image
                changed = table.vote(rows[here], seen_types[here])
                if len(changed):
                    self._states.start_anew(changed, table.types[changed])
        localized = (~np.isnan(observation.positions[:, 0].take(detections))).nonzero()[0]
        if len(localized):
            detections = detections.take(localized)
            information = self._information(observation, detections)
            positions = observation.positions.take(detections, axis=0)
            table.refine_positions(rows.take(localized), positions, information)

    def _start_tracks(self, observation: SetObservation, set_ns: int) -> list[_Seen]:
        """Make tentative tracks of the detections that nobody knew; what two cameras see twice becomes one."""
        if not len(observation.new_lights):
            return []
        fresh: IntArray = np.empty(0, dtype=np.int64)
        seen = []
        found_in = observation.seen_in[observation.new_lights]
        for image in np.unique(found_in).tolist():
            detections = observation.new_lights[found_in == image]
            images = np.full(len(detections), image)
            vehicle = observation.shots.vehicle[image]
            linked = link_across_cameras(self._table.positions[fresh], observation.positions[detections], vehicle)
            rows = np.array([fresh[linked[i]] if i in linked else -1 for i in range(len(detections))])
            again = rows >= 0
            self._remember(rows[again], observation, detections[again], images[again])
            rows[~again] = self._new_tracks(observation, detections[~again], vehicle, set_ns)
            fresh = np.concatenate([fresh, rows[~again]])
            boxes_xyxy = observation.detections.boxes_xyxy[detections]
            note_views(self._views, observation.shots, rows, images, boxes_xyxy, rows[:0], rows[:0])
            seen.append(_Seen(rows, detections, rows[:0]))
        return seen

    def _new_tracks(
        self, observation: SetObservation, detections: IntArray, vehicle: FloatArray, set_ns: int
    ) -> IntArray:
        types = self._class_types[observation.detections.class_ids[detections]]
        positions = observation.positions[detections]
        east, north, _ = (vehicle - positions).T
        rows = self._append(
            map_rows=np.full(len(detections), -1, dtype=np.int64),
            types=types,
            positions=positions,
            information=self._information(observation, detections),
            headings_deg=np.degrees(np.arctan2(east, north)),
            set_ns=set_ns,
        )
        self._table.type_votes[rows, types] += 1
        return rows

    def _information(self, observation: SetObservation, detections: IntArray) -> FloatArray:
        seen_types = self._class_types.take(observation.detections.class_ids.take(detections))
        shots, images = observation.shots, observation.seen_in.take(detections)
        return information_along(
            observation.positions.take(detections, axis=0) - shots.lens.take(images, axis=0),
            self._heights_m.take(seen_types),
            shots.optics.focal_px[1].take(images),
            box_sigma_px=self._config.box_sigma_px,
        )

    def _looks(self, observation: SetObservation, seen: Sequence[_Seen]) -> Looks:
        """What the images say about states: a light that is seen as another type than its own says nothing."""
        rows, detections = (np.concatenate([getattr(one, name) for one in seen]) for name in ("rows", "detections"))
        found = observation.detections
        own_types, seen_types = self._table.types.take(rows), self._class_types.take(found.class_ids)
        telling = (seen_types.take(detections) == own_types).nonzero()[0]
        rows, detections = rows.take(telling), detections.take(telling)
        boxes_xyxy = found.boxes_xyxy.take(detections, axis=0)
        return Looks(
            rows, found.class_probs.take(detections, axis=0), boxes_xyxy[:, 3] - boxes_xyxy[:, 1], seen[0].missed
        )

    def _count_set(self, seen: Sequence[_Seen], set_ns: int, elapsed_ns: int) -> None:
        detected, expected = np.zeros((2, len(self._table)), dtype=bool)
        for sight in seen:
            detected[sight.rows] = True
        expected[list(self._views)] = True
        self._table.end_set(detected, expected, set_ns, elapsed_ns, self._config)
        self._states.end_set(self._table.alive, self._table.starts_anew)

    def _forget(self, set_ns: int, places: PlaceBook | None) -> None:
        """Drop false alarms and the longest unseen; place what is left of the unmapped lights anew."""
        table = self._table
        # A false alarm seldom comes twice in one place: a candidate that fails to return was one.
        candidate = (table.hits > 0) & ((table.map_rows >= 0) | (table.age_s(set_ns) <= self._config.max_coast_s))
        kept = (table.known | candidate).nonzero()[0]
        if len(kept) > self._config.max_tracks:
            latest = np.argsort(-table.last_seen_ns[kept], kind="stable")[: self._config.max_tracks]
            kept = kept[np.sort(latest)]
        if len(kept) < len(table):
            self._keep(kept)
        self._unmapped.follow(table, places)

    def _keep(self, kept: IntArray) -> None:
        """Forget all tracks but these, ascending rows."""
        table = self._table
        self._row_of_light[table.map_rows[table.map_rows >= 0]] = -1
        table.keep(kept)
        self._states.keep(kept)
        self._place_map_lights()
        place = dict(zip(kept.tolist(), range(len(kept)), strict=True))
        self._views = {place[row]: views for row, views in self._views.items() if row in place}
        if self._reports is not None:
            self._reports = self._reports.take(kept)

    def _place_map_lights(self) -> None:
        on_map = np.flatnonzero(self._table.map_rows >= 0)
        self._row_of_light[self._table.map_rows[on_map]] = on_map
