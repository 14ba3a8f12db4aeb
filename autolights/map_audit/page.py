"""The audit as one HTML page that opens anywhere: a plan, and for each finding its numbers and pictures."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

import autolights
from autolights.core.atomic import write_text
from autolights.core.errors import DataError
from autolights.data import Drive
from autolights.map_audit.evidence import Sighting
from autolights.map_audit.findings import Finding, Findings

_CROP_HEIGHTS = 3.5  # of the light's box, to each side
_PICTURE_PX = 200
_PLAN_PX = 1040.0
_COLORS = {
    "confirmed": "#2fa866",
    "undecided": "#8b949e",
    "missing": "#3b6fe0",
    "extra": "#e5484d",
    "moved": "#f5b400",
    "type": "#7c5cd6",
}
_TITLES = {
    "missing": "Missing: hang there, are not in the map",
    "extra": "Extra: in the map, but were never seen where they should have been",
    "moved": "Moved: hang elsewhere than the map says",
    "type": "Of another type than the map says",
}


@dataclass(frozen=True)
class _Dot:
    x: float
    y: float
    color: str
    text: str


def write_page(path: Path, findings: Findings, drives: Sequence[Drive]) -> None:
    """Write the page.

    Args:
        path: Where.
        findings: The verdict.
        drives: The drives; images that are no longer there are left out.
    """
    by_name = {drive.name: drive for drive in drives}
    rows: dict[str, list[dict[str, Any]]] = {kind: [] for kind in _TITLES}
    for finding in findings.findings:
        pictures = [_picture(by_name[shot.drive], shot) for shot in finding.examples]
        rows[finding.kind].append(
            {"values": finding.to_json(), "pictures": [picture for picture in pictures if picture is not None]}
        )
    environment = Environment(
        loader=PackageLoader("autolights.map_audit"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("audit.html.j2").render(
        version=autolights.__version__,
        drives=drives,
        findings=findings,
        rows=rows,
        titles=_TITLES,
        colors=_COLORS,
        plan=_plan(findings, drives),
    )
    write_text(path, page)


def _plan(findings: Findings, drives: Sequence[Drive]) -> dict[str, Any] | None:
    """Lights and the ways of the vehicles from above, in pixels of the page; north is up."""
    lights = drives[0].lights
    verdict = dict.fromkeys(findings.confirmed, "confirmed")
    verdict |= dict.fromkeys(findings.undecided, "undecided")
    places = [(light_id, lights.positions[row, :2]) for row, light_id in enumerate(lights.ids)]
    for finding in findings.findings:
        verdict[finding.light_id] = finding.kind
        places += _new_place(finding)
    ways = [np.array([pose.position[:2] for pose in drive.poses]) for drive in drives]
    points = np.concatenate([np.array([place for _, place in places]).reshape(-1, 2), *ways])
    if not len(points):
        return None
    low, high = points.min(axis=0) - 5, points.max(axis=0) + 5
    scale = _PLAN_PX / max(high - low)

    def place(point: np.ndarray[Any, Any]) -> tuple[float, float]:
        return round(float((point[0] - low[0]) * scale), 1), round(float((high[1] - point[1]) * scale), 1)

    return {
        "width": round(float((high[0] - low[0]) * scale), 1),
        "height": round(float((high[1] - low[1]) * scale), 1),
        "ways": [" ".join("{},{}".format(*place(point)) for point in way[:: max(1, len(way) // 500)]) for way in ways],
        "dots": [
            _Dot(*place(point), _COLORS[verdict[light_id]], f"{light_id}: {verdict[light_id]}")
            for light_id, point in places
        ],
    }


def _new_place(finding: Finding) -> list[tuple[str, Any]]:
    return (
        [(finding.light_id, finding.position[:2])] if finding.kind == "missing" and finding.position is not None else []
    )


def _picture(drive: Drive, shot: Sighting) -> dict[str, Any] | None:
    """A crop around the light, its box drawn; None if the image is gone."""
    record = next((f for f in drive.frames if (f.camera, f.stamp_ns) == (shot.camera, shot.stamp_ns)), None)
    if record is None:
        return None
    try:
        image_bgr = drive.read(record).image_bgr
    except DataError:
        return None
    left, top, right, bottom = shot.box_xyxy
    reach = max(_CROP_HEIGHTS * (bottom - top), 24.0)
    height, width = image_bgr.shape[:2]
    x0, y0 = max(0, int((left + right) / 2 - reach)), max(0, int((top + bottom) / 2 - reach))
    x1, y1 = min(width, int((left + right) / 2 + reach)), min(height, int((top + bottom) / 2 + reach))
    if x1 <= x0 or y1 <= y0:
        return None
    scale = _PICTURE_PX / (y1 - y0)
    crop = cv2.resize(image_bgr[y0:y1, x0:x1], None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    _, data = cv2.imencode(".jpg", crop, [cv2.IMWRITE_JPEG_QUALITY, 86])
    return {
        "uri": f"data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}",
        "width": crop.shape[1],
        "height": crop.shape[0],
        "x": round((left - x0) * scale, 1),
        "y": round((top - y0) * scale, 1),
        "w": round((right - left) * scale, 1),
        "h": round((bottom - top) * scale, 1),
        "caption": f"{shot.drive}, {shot.camera}, {shot.distance_m:.0f} m",
    }
