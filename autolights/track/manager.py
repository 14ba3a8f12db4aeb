"""All tracks: observations of several cameras in, one estimate per light out (Wu et al. 2023, Sec. III-C)."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from autolights.core import (
    CameraView,
    FloatArray,
    HmmParameters,
    LightEstimate,
    SignalSet,
    TrafficLightMap,
)
from autolights.track.config import TrackConfig
from autolights.track.hmm_filter import hmm_predict, hmm_update
from autolights.track.linking import link_across_cameras
from autolights.track.localization import localization_information
from autolights.track.observation import CameraObservation, Sighting
from autolights.track.projection import ANY_TYPE
from autolights.track.states import TypeStates
from autolights.track.track import Track


class TrackManager:
    """Tracks of mapped and unmapped lights.

    Args:
        lights: The map.
        signals: The signal description.
        hmm: One model per type.
        config: Birth, death and memory.
    """

    def __init__(
        self, lights: TrafficLightMap, signals: SignalSet, hmm: Mapping[str, HmmParameters], config: TrackConfig
    ) -> None:
        self._lights = lights
        self._signals = signals
        self._config = config
        self._states = {name: TypeStates.of(name, signals, hmm[name]) for name in signals.types}
        self._class_types = [signals.type_of[name] for name in signals.classes]
        self._mapped: dict[int, Track] = {}
        self._unmapped: list[Track] = []
        self._unmapped_lights = _as_map([], signals)
        self._last_set_ns: int | None = None
        self._next_id = 0

    @property
    def unmapped(self) -> TrafficLightMap:
        """Lights that the map does not hold, tentative ones too: projected and associated exactly like map lights."""
        return self._unmapped_lights

    def update(self, observations: Sequence[CameraObservation], stamp_ns: int) -> list[LightEstimate]:
        """Take in one set of frames.

        Args:
            observations: One per image, held against the map and `unmapped` as they are now, in any order.
            stamp_ns: Latest stamp of the set; no earlier than the last set's.

        Returns:
            Estimates of all lights that were born, in the order of their track ids. A light whose state is too old is
            withheld; one that is out of sight for long is not mentioned.

        Raises:
            ValueError: If `stamp_ns` is earlier than the last set's.
        """
        if self._last_set_ns is not None and stamp_ns < self._last_set_ns:
            raise ValueError(f"sets must come in the order of time, got {stamp_ns} after {self._last_set_ns}")
        self._let_time_pass(stamp_ns)
        ordered = sorted(observations, key=lambda observation: (observation.stamp_ns, observation.camera.name))
        for observation in ordered:
            self._take_in(observation, stamp_ns)
        self._start_tracks(ordered, stamp_ns)
        self._end_set(stamp_ns)
        return self._estimates(ordered, stamp_ns)

    def explain(self) -> list[dict[str, Any]]:
        """The belief behind each track, as JSON-ready values."""
        return [
            {
                "track_id": track.id,
                "map_id": None if track.map_row is None else self._lights.ids[track.map_row],
                "belief": dict(
                    zip(self._states[track.type].params.states, np.round(track.belief, 4).tolist(), strict=True)
                ),
                "alive": track.alive,
                "hits": track.hits,
                "misses": track.misses,
            }
            for track in self._tracks()
        ]

    def _tracks(self) -> list[Track]:
        return [*self._mapped.values(), *self._unmapped]

    def _let_time_pass(self, stamp_ns: int) -> None:
        elapsed_s = 0.0 if self._last_set_ns is None else (stamp_ns - self._last_set_ns) / 1e9
        self._last_set_ns = stamp_ns
        for track in self._tracks():
            track.views.clear()
        if self._config.mode == "timed":
            for states, tracks in self._by_type(self._tracks()):
                _set_beliefs(tracks, hmm_predict(_beliefs(tracks), states.params, elapsed_s))

    def _take_in(self, observation: CameraObservation, set_ns: int) -> None:
        """Give each detection that was matched to its track; note who was expected in vain."""
        projected, detections = observation.projected, observation.detections
        seen: list[tuple[Track, int]] = []
        for light, detection in observation.association.matches.tolist():
            track = self._track_at(int(projected.indices[light]), set_ns)
            track.views.append(_view(observation, detection))
            seen.append((track, detection))
        for light in observation.association.unmatched_lights[
            projected.expected[observation.association.unmatched_lights]
        ].tolist():
            row = int(projected.indices[light])
            missed = self._mapped.get(row) if row < len(self._lights) else self._unmapped[row - len(self._lights)]
            if missed is not None:
                missed.views.append(CameraView(observation.camera.name, observation.stamp_ns, None))

        class_ids = detections.class_ids
        for track, detection in seen:
            self._remember(track, observation, detection, int(class_ids[detection]), set_ns)
        # An unmapped light may be seen as another type than it was voted: that tells nothing about its state.
        telling = [(t, d) for t, d in seen if self._class_types[class_ids[d]] == t.type]
        self._update_beliefs(telling, detections.class_probs, set_ns)

    def _track_at(self, row: int, set_ns: int) -> Track:
        """The track of a known light; a map light gets one at its first detection."""
        if row >= len(self._lights):
            track = self._unmapped[row - len(self._lights)]
        elif row in self._mapped:
            track = self._mapped[row]
        else:
            light_type = self._lights.types[row]
            track = self._mapped[row] = Track(
                id=self._take_id(),
                map_row=row,
                type=light_type,
                position=self._lights.positions[row],
                information=None,
                heading_deg=float(self._lights.headings_deg[row]),
                belief=self._states[light_type].params.initial,
                last_seen_ns=set_ns,
                last_set_ns=set_ns,
            )
        if track.starts_anew and not track.views:
            track.belief = self._states[track.type].params.initial
        return track

    def _remember(
        self, track: Track, observation: CameraObservation, detection: int, class_id: int, set_ns: int
    ) -> None:
        _, top, _, bottom = observation.detections.boxes_xyxy[detection]
        track.remember(Sighting(set_ns, class_id, float(bottom - top)), self._class_types[class_id], self._config)
        if track.map_row is not None:
            return
        voted = max(track.type_votes, key=lambda name: (track.type_votes[name], name == track.type))
        if voted != track.type:
            track.type, track.belief = voted, self._states[voted].params.initial
        track.refine_position(observation.positions[detection], self._information(observation, detection))

    def _update_beliefs(self, seen: Sequence[tuple[Track, int]], class_probs: FloatArray, set_ns: int) -> None:
        row_of = {track.id: detection for track, detection in seen}
        for states, tracks in self._by_type([track for track, _ in seen]):
            rows = [row_of[track.id] for track in tracks]
            beliefs = _beliefs(tracks)
            if self._config.mode == "paper":  # one fixed A per observation
                beliefs = hmm_predict(beliefs, states.params, None)
            weight = np.array([self._independence(track, set_ns) for track in tracks])
            x = class_probs[rows][:, states.class_ids]
            _set_beliefs(tracks, hmm_update(beliefs, x, states.params, weight=weight))

    def _independence(self, track: Track, set_ns: int) -> float:
        correlation_s = self._config.error_correlation_s
        if self._config.mode == "paper" or correlation_s == 0 or track.starts_anew:
            return 1.0
        return min(1.0, track.age_s(set_ns) / correlation_s)

    def _start_tracks(self, observations: Sequence[CameraObservation], set_ns: int) -> None:
        """Make tentative tracks of the detections that nobody knew; what two cameras see twice becomes one."""
        fresh: list[Track] = []
        for observation in observations:
            candidates = list(fresh)
            rows = observation.new_lights
            if not len(rows):
                continue
            places = np.array([track.position for track in fresh]).reshape(-1, 3)
            linked = link_across_cameras(places, observation.positions[rows], observation.pose.position)
            class_ids = observation.detections.class_ids
            seen: list[tuple[Track, int]] = []
            for i, detection in enumerate(rows.tolist()):
                class_id = int(class_ids[detection])
                if i in linked:
                    track = candidates[linked[i]]
                    self._remember(track, observation, detection, class_id, set_ns)
                else:
                    track = self._new_track(observation, detection, class_id, set_ns)
                    fresh.append(track)
                track.views.append(_view(observation, detection))
                if track.type == self._class_types[class_id]:
                    seen.append((track, detection))
            self._update_beliefs(seen, observation.detections.class_probs, set_ns)
        self._unmapped += fresh

    def _new_track(self, observation: CameraObservation, detection: int, class_id: int, set_ns: int) -> Track:
        light_type = self._class_types[class_id]
        position = observation.positions[detection]
        to_vehicle = observation.pose.position - position
        track = Track(
            id=self._take_id(),
            map_row=None,
            type=light_type,
            position=position,
            information=self._information(observation, detection),
            heading_deg=float(np.degrees(np.arctan2(to_vehicle[0], to_vehicle[1]))),
            belief=self._states[light_type].params.initial,
            last_seen_ns=set_ns,
            last_set_ns=set_ns,
        )
        _, top, _, bottom = observation.detections.boxes_xyxy[detection]
        track.remember(Sighting(set_ns, class_id, float(bottom - top)), light_type, self._config)
        return track

    def _information(self, observation: CameraObservation, detection: int) -> FloatArray:
        light_type = self._class_types[int(observation.detections.class_ids[detection])]
        return localization_information(
            observation.positions[detection],
            self._signals.types[light_type].height_m,
            observation.camera,
            observation.pose,
            box_sigma_px=self._config.box_sigma_px,
        )

    def _end_set(self, set_ns: int) -> None:
        for track in self._tracks():
            track.end_set(set_ns, self._config)
        # A false alarm seldom comes twice in one place: a candidate that fails to return was one.
        self._unmapped = [
            track
            for track in self._unmapped
            if track.known or (track.hits > 0 and track.age_s(set_ns) <= self._config.max_coast_s)
        ]
        self._mapped = {row: track for row, track in self._mapped.items() if track.known or track.hits > 0}
        self._unmapped_lights = _as_map(self._unmapped, self._signals)

    def _estimates(self, observations: Sequence[CameraObservation], set_ns: int) -> list[LightEstimate]:
        if not observations:
            return []
        vehicle = observations[-1].pose.position
        reported = [
            track
            for track in self._tracks()
            if track.known and (track.views or track.age_s(set_ns) <= self._config.max_coast_s)
        ]
        return [self._estimate(track, vehicle, set_ns) for track in sorted(reported, key=lambda track: track.id)]

    def _estimate(self, track: Track, vehicle: FloatArray, set_ns: int) -> LightEstimate:
        state = self._states[track.type].report(track.belief, track.history)
        return LightEstimate(
            stamp_ns=set_ns,
            track_id=track.id,
            map_id=None if track.map_row is None else self._lights.ids[track.map_row],
            type=track.type,
            class_name=state.class_name,
            probability=state.probability,
            flashing=state.flashing,
            withheld=track.is_stale(set_ns, self._config),
            position=track.position,
            covariance=None if track.information is None else np.linalg.inv(track.information),
            distance_m=math.dist(track.position, vehicle),
            last_seen_ns=track.last_seen_ns,
            views=tuple(track.views),
        )

    def _by_type(self, tracks: Sequence[Track]) -> Iterator[tuple[TypeStates, list[Track]]]:
        for name, states in self._states.items():
            group = [track for track in tracks if track.type == name]
            if group:
                yield states, group

    def _take_id(self) -> int:
        self._next_id += 1
        return self._next_id


def _beliefs(tracks: Sequence[Track]) -> FloatArray:
    return np.stack([track.belief for track in tracks])


def _set_beliefs(tracks: Sequence[Track], beliefs: FloatArray) -> None:
    for track, belief in zip(tracks, beliefs, strict=True):
        track.belief = belief


def _view(observation: CameraObservation, detection: int) -> CameraView:
    left, top, right, bottom = observation.detections.boxes_xyxy[detection].tolist()
    return CameraView(observation.camera.name, observation.stamp_ns, (left, top, right, bottom))


def _as_map(tracks: Sequence[Track], signals: SignalSet) -> TrafficLightMap:
    return TrafficLightMap(
        ids=tuple(str(track.id) for track in tracks),
        types=(ANY_TYPE,) * len(tracks),
        positions=np.array([track.position for track in tracks]).reshape(-1, 3),
        headings_deg=np.array([track.heading_deg for track in tracks]),
        sizes_m=signals.sizes_m(track.type for track in tracks),
    )
