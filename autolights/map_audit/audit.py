"""The whole audit: folders of runs and their drives in, findings, a page and a corrected map out."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import autolights
from autolights.core import SignalSet
from autolights.core.atomic import new_folder, refuse_existing
from autolights.core.errors import DataError, MapError, UsageError
from autolights.core.json_files import write_json
from autolights.data import Drive, load_detections, load_estimates, load_run_info
from autolights.data.drives import MAP
from autolights.data.run_output import DETECTIONS, ESTIMATES
from autolights.map_audit.config import MapAuditConfig
from autolights.map_audit.correction import write_corrected_map
from autolights.map_audit.evidence import gather_evidence
from autolights.map_audit.findings import KINDS, Findings, find
from autolights.map_audit.page import write_page

AUDIT, PAGE, CORRECTED = "audit.json", "audit.html", "map.geojson"
_FORMAT = 1
_SAME_M = 0.01


@dataclass(frozen=True, eq=False)
class MapAudit:
    """What came of an audit.

    Attributes:
        source: The map.
        drives: The drives that passed its lights.
        findings: The verdict.
        corrected: The corrected map.
        config: The limits.
    """

    source: Path
    drives: tuple[Drive, ...]
    findings: Findings
    corrected: Path
    config: MapAuditConfig

    def to_json(self) -> dict[str, Any]:
        """The audit as JSON-ready values (``audit.json``)."""
        found = self.findings
        return {
            "format": _FORMAT,
            "version": autolights.__version__,
            "map": str(self.source.resolve()),
            "corrected_map": str(self.corrected.resolve()),
            "drives": [{"name": drive.name, "folder": str(drive.folder.resolve())} for drive in self.drives],
            "config": self.config.model_dump(mode="json"),
            "lights": len(self.drives[0].lights),
            "confirmed": list(found.confirmed),
            "undecided": list(found.undecided),
            "small_moves_judged": found.places_judged,
            "findings": [finding.to_json() for finding in found.findings],
        }


def audit_map(
    runs: Sequence[tuple[Path, Path]],
    signals: SignalSet,
    out_dir: Path,
    config: MapAuditConfig | None = None,
    *,
    corrected: Path | None = None,
    kinds: Collection[str] = KINDS,
    force: bool = False,
) -> MapAudit:
    """Audit the map of one or several drives.

    Args:
        runs: Folder of a run of variant ``full``, and of its drive. All drives have the same map.
        signals: The signal description.
        out_dir: Gets ``audit.json``, ``audit.html`` and, unless `corrected` says otherwise, ``map.geojson``; appears
            whole or not at all.
        config: Limits.
        corrected: Where the corrected map goes.
        kinds: Which findings it puts right.
        force: Replace `out_dir`, and what is at `corrected`, were it the map itself.

    Raises:
        UsageError: If something exists and `force` is not set, a kind is unknown, or no run is given.
        DataError: If a file is missing or breaks its format, the maps differ, or a run holds no tracks.
    """
    config = config or MapAuditConfig()
    unknown = sorted(set(kinds) - set(KINDS))
    if unknown:
        raise UsageError(f"corrections must be of {', '.join(KINDS)}, got '{unknown[0]}'")
    if not runs:
        raise UsageError("a map audit needs one run or more")
    refuse_existing(out_dir, force=force)
    if corrected is not None:
        refuse_existing(corrected, force=force)
    drives = [Drive.load(drive_dir, signals) for _, drive_dir in runs]
    for drive in drives[1:]:
        _check_same_map(drives[0], drive)
    sigma_m = _map_sigma_m([run_dir for run_dir, _ in runs])
    evidence = []
    for (run_dir, _), drive in zip(runs, drives, strict=True):
        sets = load_estimates(run_dir / ESTIMATES, ["full"])
        if not sets:
            raise DataError(f"{run_dir / ESTIMATES}: holds no line of variant 'full'; run again with --variant full")
        evidence.append(gather_evidence(drive, sets, load_detections(run_dir / DETECTIONS), signals, config))
    findings = find(drives[0].lights, evidence, config, map_sigma_m=sigma_m)
    source = drives[0].folder / MAP
    with new_folder(out_dir, force=force) as folder:
        audit = MapAudit(source, tuple(drives), findings, corrected or out_dir / CORRECTED, config)
        write_json(folder / AUDIT, audit.to_json())
        write_page(folder / PAGE, findings, drives)
        first = drives[0]
        write_corrected_map(
            source,
            corrected or folder / CORRECTED,
            findings.findings,
            first.utm_zone,
            first.hemisphere,
            kinds=kinds,
            force=force,
        )
    return audit


def table(audit: MapAudit) -> str:
    """The findings as text, one a line."""
    found = audit.findings
    lines = [
        f"{len(audit.drives[0].lights)} lights in the map: {len(found.confirmed)} confirmed, "
        f"{len(found.undecided)} seen too little, {len(found.findings)} findings"
    ]
    if not found.places_judged:
        lines.append("moves of lights that were still recognised cannot be told: the runs had places=null")
    if found.findings:
        lines.append(
            f"{'kind':8} {'light':16} {'type':12} {'off by':>8} {'± m':>6} {'seen':>6} {'not':>6} {'at m':>9}  drives"
        )
    for finding in found.findings:
        values = finding.to_json()
        kind = finding.type if finding.map_type in (None, finding.type) else f"{finding.map_type} → {finding.type}"
        off = "" if finding.kind != "moved" else f"{values['distance_off_m']:.2f} m"
        sigma = "" if finding.sigmas_m is None else f"{float(np.linalg.norm(finding.sigmas_m)):.2f}"
        distances = values["distances_m"]
        reach = f"{distances['min']:.0f}–{distances['max']:.0f}"
        lines.append(
            f"{finding.kind:8} {finding.light_id:16} {kind:12} {off:>8} {sigma:>6} {values['images_seen']:>6} "
            f"{values['images_missed']:>6} {reach:>9}  {len(values['drives'])}"
        )
    return "\n".join(lines)


def _check_same_map(first: Drive, other: Drive) -> None:
    ours, theirs = first.lights, other.lights
    same = (first.utm_zone, first.hemisphere, ours.ids, ours.types) == (
        other.utm_zone,
        other.hemisphere,
        theirs.ids,
        theirs.types,
    )
    if not same or np.abs(ours.positions - theirs.positions).max(initial=0) > _SAME_M:
        raise MapError(
            f"{other.folder / MAP}: is another map than {first.folder / MAP}; audit drives of different maps one by one"
        )


def _map_sigma_m(run_dirs: Sequence[Path]) -> float | None:
    """How far off all runs took the map to be; None if one of them did not refine places."""
    sigmas = set()
    for run_dir in run_dirs:
        places = load_run_info(run_dir).get("config", {}).get("places")
        sigmas.add(float(places["map_m"]) if places else None)
    if len(sigmas) > 1:
        raise DataError("the runs had different settings of places; run them again with the same")
    return sigmas.pop()
