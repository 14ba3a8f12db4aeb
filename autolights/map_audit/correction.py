"""The map as it should be: the file as it was, but for what was found wrong."""

import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from autolights.core.atomic import refuse_existing
from autolights.core.errors import MapError
from autolights.core.json_files import read_json_object, write_json
from autolights.data import lon_lat_from_utm
from autolights.data.utm import Hemisphere
from autolights.map_audit.findings import Finding

_LON_LAT_DECIMALS = 10


def write_corrected_map(
    source: Path,
    target: Path,
    findings: Sequence[Finding],
    utm_zone: int,
    hemisphere: Hemisphere,
    *,
    kinds: Collection[str],
    force: bool = False,
) -> int:
    """Write a map with the findings put right; everything else, properties that nobody knows included, stays.

    Args:
        source: The map that was audited.
        target: Appears whole or not at all; may be `source` if `force` is set.
        findings: Of its audit.
        utm_zone: Of the findings' positions.
        hemisphere: Of the zone.
        kinds: Which kinds of findings are put right.
        force: Replace what is there.

    Returns:
        How many findings were put right.

    Raises:
        UsageError: If `target` exists and `force` is not set.
        MapError: If `source` does not hold a light that was judged.
    """
    refuse_existing(target, force=force)
    collection = read_json_object(source, error=MapError)
    features: list[Any] = list(collection["features"])
    index = {str(f["properties"].get("id")): i for i, f in enumerate(features) if f["geometry"]["type"] == "Point"}
    chosen = [finding for finding in findings if finding.kind in kinds]
    gone: set[int] = set()
    for finding in chosen:
        if finding.kind == "missing":
            features.append(_feature(finding, utm_zone, hemisphere))
            continue
        if finding.light_id not in index:
            raise MapError(f"{source}: light '{finding.light_id}' is not in this map; is it the one of the drives?")
        i = index[finding.light_id]
        if finding.kind == "extra":
            gone.add(i)
            continue
        feature = json.loads(json.dumps(features[i]))
        if finding.kind == "moved":
            coordinates, height_m = _place(finding, utm_zone, hemisphere)
            feature["geometry"]["coordinates"][:2] = coordinates
            feature["properties"]["height_m"] = height_m
        else:
            feature["properties"]["type"] = finding.type
        features[i] = feature
    kept = [feature for i, feature in enumerate(features) if i not in gone]
    write_json(target, {**collection, "features": kept})
    return len(chosen)


def _feature(finding: Finding, utm_zone: int, hemisphere: Hemisphere) -> dict[str, Any]:
    coordinates, height_m = _place(finding, utm_zone, hemisphere)
    return {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": coordinates},
        "properties": {
            "id": finding.light_id,
            "type": finding.type,
            "height_m": height_m,
            "heading_deg": round(finding.heading_deg, 1),
            "intersection": finding.intersection,
            "group": "",
        },
    }


def _place(finding: Finding, utm_zone: int, hemisphere: Hemisphere) -> tuple[list[float], float]:
    assert finding.position is not None
    (lon_lat,) = lon_lat_from_utm(np.array([finding.position[:2]]), utm_zone, hemisphere)
    return [round(float(value), _LON_LAT_DECIMALS) for value in lon_lat], round(float(finding.position[2]), 4)
