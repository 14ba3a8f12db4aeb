"""What is wrong with a map: lights that are missing, gone, moved or of another type, with the evidence for it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy.stats import norm

from autolights.core import FloatArray, TrafficLightMap
from autolights.map_audit.config import MapAuditConfig
from autolights.map_audit.evidence import DriveEvidence, Evidence, Sighting

Kind: TypeAlias = Literal["missing", "extra", "moved", "type"]
KINDS: tuple[Kind, ...] = ("missing", "extra", "moved", "type")

_EXAMPLES = 3
_SAME_INTERSECTION_M = 40.0
_FACING_COSINE = np.cos(np.radians(45.0))
_TOGETHER_SHARE = 0.05  # of the images in which two lights may be seen together by mistake and still be one


@dataclass(frozen=True, eq=False)
class Finding:
    """One thing that is wrong.

    Attributes:
        kind: ``missing``: not in the map; ``extra``: in the map, but not there; ``moved``: elsewhere; ``type``: another
            type.
        light_id: The map's, or a new one for a missing light.
        type: Type as it should be; of an extra light the map's.
        map_type: The map's; None for a missing light.
        position: (3,) metres as it should be; None for an extra light.
        map_position: (3,) metres in the map; None for a missing light.
        sigmas_m: (3,) standard deviations of `position`; None where it is the map's.
        heading_deg: The way its face looks: the map's, or for a missing light that of its neighbours or viewers.
        intersection: The map's name; of a missing light that of its nearest neighbour, empty if there is none.
        evidence: What the images say.
    """

    kind: Kind
    light_id: str
    type: str
    map_type: str | None
    position: FloatArray | None
    map_position: FloatArray | None
    sigmas_m: FloatArray | None
    heading_deg: float
    intersection: str
    evidence: Evidence

    @property
    def offset_m(self) -> FloatArray | None:
        """(3,) east, north, up from the map's place to the true one."""
        return None if self.position is None or self.map_position is None else self.position - self.map_position

    @property
    def examples(self) -> tuple[Sighting, ...]:
        """Images that show it, from the nearest to farther ones; of an extra light those that show nothing."""
        shots = self.evidence.missed if self.kind == "extra" else self.evidence.seen
        ordered = sorted(shots, key=lambda sighting: sighting.distance_m)
        return tuple(ordered[:: max(1, len(ordered) // _EXAMPLES)][:_EXAMPLES])

    def to_json(self) -> dict[str, Any]:
        """The finding as JSON-ready values."""
        evidence, offset = self.evidence, self.offset_m
        shots = evidence.missed if self.kind == "extra" else evidence.seen
        distances = [sighting.distance_m for sighting in shots]
        residuals = np.array(evidence.residuals_px).reshape(-1, 2)
        return {
            "kind": self.kind,
            "light": self.light_id,
            "type": self.type,
            "map_type": self.map_type,
            "position": _rounded(self.position),
            "map_position": _rounded(self.map_position),
            "offset_m": _rounded(offset),
            "distance_off_m": None if offset is None else round(float(np.linalg.norm(offset)), 3),
            "sigmas_m": _rounded(self.sigmas_m),
            "heading_deg": round(self.heading_deg, 1),
            "intersection": self.intersection,
            "images_seen": len(evidence.seen),
            "images_missed": len(evidence.missed),
            "types_seen": dict(evidence.types.most_common()),
            "drives": list(evidence.drives),
            "way_m": round(evidence.way_m, 1),
            "distances_m": {
                "min": round(min(distances), 1),
                "median": round(float(np.median(distances)), 1),
                "max": round(max(distances), 1),
            },
            "residual_px": _rounded(residuals.mean(axis=0), 2) if len(residuals) else None,
            "spread_px": _rounded(residuals.std(axis=0), 2) if len(residuals) else None,
            "examples": [
                {
                    "drive": shot.drive,
                    "camera": shot.camera,
                    "stamp_ns": shot.stamp_ns,
                    "box_xyxy": [round(edge, 1) for edge in shot.box_xyxy],
                    "distance_m": round(shot.distance_m, 1),
                }
                for shot in self.examples
            ],
        }


@dataclass(frozen=True, eq=False)
class Findings:
    """The verdict on a map.

    Attributes:
        findings: In the order of `KINDS`, then of the map.
        confirmed: Ids of lights that are where and what the map says.
        undecided: Ids of lights about which the images say too little.
        places_judged: Whether small moves could be told: the runs refined places.
    """

    findings: tuple[Finding, ...]
    confirmed: tuple[str, ...]
    undecided: tuple[str, ...]
    places_judged: bool


def find(
    lights: TrafficLightMap, drives: Sequence[DriveEvidence], config: MapAuditConfig, *, map_sigma_m: float | None
) -> Findings:
    """Judge each light of a map, and each that it does not hold.

    Args:
        lights: The map.
        drives: Evidence of one or several drives with this map.
        config: Limits.
        map_sigma_m: How far off the runs took the map to be, per axis (`PlaceConfig.map_m`); None if they did not
            refine places.
    """
    known = {light_id: Evidence() for light_id in lights.ids}
    for drive in drives:
        for light_id, evidence in drive.lights.items():
            known[light_id].add(evidence)
    judge = _Judge(lights, known, config, map_sigma_m)
    unmapped = judge.unknown(_same_lights([e for drive in drives for e in drive.tracks.values()], config))
    moved = judge.reunite(unmapped)
    findings: list[Finding] = []
    confirmed: list[str] = []
    undecided: list[str] = []
    for row, light_id in enumerate(lights.ids):
        mine = [*moved.get(row, ()), *judge.of_map_light(row, already=row in moved)]
        findings += mine
        if not mine:
            (confirmed if judge.is_there(known[light_id]) else undecided).append(light_id)
    findings += judge.missing(unmapped)
    return Findings(
        findings=tuple(sorted(findings, key=lambda finding: KINDS.index(finding.kind))),
        confirmed=tuple(confirmed),
        undecided=tuple(undecided),
        places_judged=map_sigma_m is not None,
    )


@dataclass(frozen=True, eq=False)
class _Unmapped:
    """A light that the map does not hold."""

    position: FloatArray
    covariance: FloatArray
    type: str
    evidence: Evidence


class _Judge:
    def __init__(
        self,
        lights: TrafficLightMap,
        known: Mapping[str, Evidence],
        config: MapAuditConfig,
        map_sigma_m: float | None,
    ) -> None:
        self._lights, self._known, self._config, self._map_sigma_m = lights, known, config, map_sigma_m
        self._gate = float(norm.isf(config.moved_chance / 2))

    def enough(self, shots: Sequence[Sighting]) -> bool:
        """Whether so many images say something: enough of them, from more than one place."""
        if len(shots) < self._config.min_images:
            return False
        evidence = Evidence(seen=list(shots))
        return len(evidence.drives) > 1 or evidence.way_m >= self._config.min_way_m

    def is_there(self, evidence: Evidence) -> bool:
        """Whether a light was seen often, and in most of the images that say something of it."""
        return self.enough(evidence.seen) and evidence.seen_share > self._config.moved_share

    def unknown(self, unmapped: Sequence[_Unmapped]) -> list[_Unmapped]:
        """Unmapped lights that are real and no light of the map seen double."""
        config, kept = self._config, []
        for light in unmapped:
            sure = float(np.sqrt(np.linalg.eigvalsh(light.covariance)[-1])) <= config.missing_sigma_m
            share = light.evidence.expected_share
            if self.enough(light.evidence.seen) and share >= config.missing_share and sure and not self._double(light):
                kept.append(light)
        return kept

    def reunite(self, unmapped: list[_Unmapped]) -> dict[int, list[Finding]]:
        """Lights of the map that were seldom seen, and unmapped ones of their type nearby: these have moved.

        Those are taken out of `unmapped`.
        """
        lights, config = self._lights, self._config
        gone = [row for row in range(len(lights)) if self._is_gone(row, config.moved_share)]
        pairs = sorted(
            (float(np.linalg.norm(light.position - lights.positions[row])), row, i)
            for i, light in enumerate(unmapped)
            for row in gone
            if light.type == lights.types[row]
        )
        moved: dict[int, list[Finding]] = {}
        used: set[int] = set()
        for distance_m, row, i in pairs:
            if distance_m <= config.moved_max_m and row not in moved and i not in used:
                used.add(i)
                light = unmapped[i]
                moved[row] = [self._finding("moved", row, light.position, light.covariance, light.evidence)]
        unmapped[:] = [light for i, light in enumerate(unmapped) if i not in used]
        return moved

    def of_map_light(self, row: int, *, already: bool) -> list[Finding]:
        """What is wrong with one light of the map."""
        evidence, findings = self._known[self._lights.ids[row]], []
        if already:
            return []
        if self._is_gone(row, self._config.extra_share):
            return [self._finding("extra", row, None, None, evidence)]
        if not self.enough(evidence.seen):
            return []
        offset, covariance = self._free_place(row)
        if covariance is not None and self._moved(offset, covariance):
            position = self._lights.positions[row] + offset
            findings.append(self._finding("moved", row, position, covariance, evidence))
        ((kind, count),) = evidence.types.most_common(1)
        if kind != self._lights.types[row] and count >= self._config.type_share * evidence.types.total():
            findings.append(self._finding("type", row, self._lights.positions[row], None, evidence, kind=kind))
        return findings

    def missing(self, unmapped: Sequence[_Unmapped]) -> list[Finding]:
        """Lights that the map does not hold."""
        taken, findings = set(self._lights.ids), []
        number = 0
        for light in sorted(unmapped, key=lambda light: light.evidence.seen[0].stamp_ns):
            number += 1
            while f"new-{number}" in taken:
                number += 1
            heading_deg, intersection = self._neighbourhood(light)
            findings.append(
                Finding(
                    kind="missing",
                    light_id=f"new-{number}",
                    type=light.type,
                    map_type=None,
                    position=light.position,
                    map_position=None,
                    sigmas_m=np.sqrt(np.diag(light.covariance)),
                    heading_deg=heading_deg,
                    intersection=intersection,
                    evidence=light.evidence,
                )
            )
        return findings

    def _is_gone(self, row: int, share: float) -> bool:
        evidence = self._known[self._lights.ids[row]]
        return self.enough(evidence.missed) and evidence.seen_share <= share

    def _finding(
        self,
        what: Kind,
        row: int,
        position: FloatArray | None,
        covariance: FloatArray | None,
        evidence: Evidence,
        *,
        kind: str | None = None,
    ) -> Finding:
        lights = self._lights
        return Finding(
            kind=what,
            light_id=lights.ids[row],
            type=kind or lights.types[row],
            map_type=lights.types[row],
            position=position,
            map_position=lights.positions[row],
            sigmas_m=None if covariance is None else np.sqrt(np.diag(covariance)),
            heading_deg=float(lights.headings_deg[row]),
            intersection=lights.intersections[row],
            evidence=evidence,
        )

    def _free_place(self, row: int) -> tuple[FloatArray, FloatArray | None]:
        """Where the images alone would put a light: (3,) metres from the map's place, and (3, 3) m².

        Each drive's estimate took the map to be good to `map_sigma_m`; that is taken off, and a vaguer one put on.
        """
        places = self._known[self._lights.ids[row]].places
        if self._map_sigma_m is None or not places:
            return np.zeros(3), None
        information, vector = np.eye(3) / self._config.free_map_m**2, np.zeros(3)
        for position, covariance in places:
            told = np.linalg.inv(covariance)
            information += told - np.eye(3) / self._map_sigma_m**2
            vector += told @ (position - self._lights.positions[row])
        if np.linalg.eigvalsh(information)[0] <= 0:
            return np.zeros(3), None
        covariance = np.linalg.inv(information)
        return np.asarray(covariance @ vector), covariance

    def _moved(self, offset: FloatArray, covariance: FloatArray) -> bool:
        """Whether a light is off, along those axes along which errors would not do that, and can have moved so far.

        Farther off than that, the runtime has taken another light for it.
        """
        variances, axes = np.linalg.eigh(covariance)
        along, sigmas = np.abs(axes.T @ offset), np.sqrt(variances)
        sure = along > self._gate * sigmas
        surely_m, most_m = np.linalg.norm((along - sigmas)[sure]), np.linalg.norm(along[sure])
        return bool(surely_m >= self._config.moved_m and most_m <= self._config.moved_max_m)

    def _double(self, light: _Unmapped) -> bool:
        """Whether an unmapped light is one of the map that the runtime followed twice: in one place, never together."""
        near = self._lights.within(light.position, self._config.moved_max_m)
        for row in near.tolist():
            evidence = self._known[self._lights.ids[row]]
            if not self.enough(evidence.seen):
                continue
            apart = light.position - self._lights.positions[row] - self._free_place(row)[0]
            together = len(light.evidence.images & evidence.images)
            if np.linalg.norm(apart) <= self._config.same_light_m and together <= _TOGETHER_SHARE * len(
                light.evidence.images
            ):
                return True
        return False

    def _neighbourhood(self, light: _Unmapped) -> tuple[float, str]:
        """Heading and intersection of a missing light: those of the nearest light that looks the same way, if any."""
        shots = np.array([sighting.vehicle for sighting in light.evidence.seen])
        ways = shots - light.position[:2]
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        east, north = ways.mean(axis=0)
        heading_deg = float(np.degrees(np.arctan2(east, north)) % 360)
        near = self._lights.within(light.position, _SAME_INTERSECTION_M)
        if not len(near):
            return heading_deg, ""
        ordered = near[np.argsort(np.linalg.norm(self._lights.positions[near] - light.position, axis=1))]
        intersection = self._lights.intersections[ordered[0]]
        for row in ordered.tolist():
            if np.cos(np.radians(self._lights.headings_deg[row] - heading_deg)) >= _FACING_COSINE:
                return float(self._lights.headings_deg[row]), intersection
        return heading_deg, intersection


def _same_lights(tracks: Sequence[Evidence], config: MapAuditConfig) -> list[_Unmapped]:
    """Unmapped tracks of all drives, those of one light as one; the longest first."""
    lights: list[_Unmapped] = []
    for track in sorted(tracks, key=lambda track: -len(track.seen)):
        if not track.places or not track.seen:
            continue
        ((position, covariance),) = track.places[-1:]
        kind = track.types.most_common(1)[0][0]
        for i, light in enumerate(lights):
            near = np.linalg.norm(light.position - position) <= config.same_light_m
            together = len(light.evidence.images & track.images)
            if near and together <= _TOGETHER_SHARE * len(track.images):
                lights[i] = _joined(light, _Unmapped(position, covariance, kind, track))
                break
        else:
            copy = Evidence()
            copy.add(track)
            lights.append(_Unmapped(position, covariance, kind, copy))
    return lights


def _joined(one: _Unmapped, other: _Unmapped) -> _Unmapped:
    """Two tracks of one light; in one drive they share its errors, so there the better place counts alone."""
    one.evidence.add(other.evidence)
    kind = one.evidence.types.most_common(1)[0][0]
    if set(one.evidence.drives) & set(other.evidence.drives) and len(one.evidence.drives) == 1:
        better = min(one, other, key=lambda light: float(np.trace(light.covariance)))
        return _Unmapped(better.position, better.covariance, kind, one.evidence)
    a, b = np.linalg.inv(one.covariance), np.linalg.inv(other.covariance)
    covariance = np.linalg.inv(a + b)
    return _Unmapped(covariance @ (a @ one.position + b @ other.position), covariance, kind, one.evidence)


def _rounded(values: FloatArray | None, digits: int = 3) -> list[float] | None:
    return None if values is None else [round(float(value), digits) for value in values]
