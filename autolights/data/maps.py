"""HD maps of traffic lights: GeoJSON points in longitude and latitude, metres in UTM inside the program.

Headings are clockwise from the north of the UTM grid (not from true north: the two differ by up to 3°), the way the
face of the light looks. Heights are taken as they are; the drive records their datum.
"""

from pathlib import Path
from typing import Any

import numpy as np

from autolights.core import FloatArray, SignalSet, TrafficLightMap
from autolights.core.errors import MapError
from autolights.core.json_files import read_json_object, write_json
from autolights.data.utm import Hemisphere, central_meridian_deg, lon_lat_from_utm, utm_from_lon_lat

# UTM zones are 6° wide; beyond twice their half-width the projection's scale error shows and the zone is a mistake.
_MAX_OFF_MERIDIAN_DEG = 6.0
_LON_LAT_DECIMALS = 10  # 0.01 mm


def load_map(path: Path, signals: SignalSet, utm_zone: int, hemisphere: Hemisphere) -> TrafficLightMap:
    """Read a map's lights in the order of the file.

    A light is a Point with `id`, `type`, `height_m` (of the housing's centre), `heading_deg` and optionally
    `intersection`, `group` and `lanes` (names of the lanes whose traffic it governs). A lane is a LineString along its
    middle, in the direction of travel, with `lane`, its name. Other properties are left alone. Sizes come from the
    type.

    Args:
        path: The GeoJSON file.
        signals: Which types exist, and how large they are.
        utm_zone: 1 to 60.
        hemisphere: Of the zone.

    Raises:
        MapError: If the file or a property is missing, a light's type is unknown, a lane is given twice or has no line,
            or coordinates lie outside the earth or far outside the zone; the text names file and light.
    """
    features = list(enumerate(_read_features(path)))
    lanes = [(i, feature) for i, feature in features if _is_lane(feature)]
    rows = [_read_light(path, i, feature, signals) for i, feature in features if not _is_lane(feature)]
    lon_lat = np.array([row["lon_lat"] for row in rows], dtype=np.float64).reshape(-1, 2)
    meridian = central_meridian_deg(utm_zone)
    off = np.abs((lon_lat[:, 0] - meridian + 180) % 360 - 180)
    if len(off) and off.max() > _MAX_OFF_MERIDIAN_DEG:
        worst = rows[int(off.argmax())]
        raise MapError(
            f"{path}: light '{worst['id']}' at longitude {worst['lon_lat'][0]} lies {off.max():.1f}° from the middle "
            f"of UTM zone {utm_zone} ({meridian}°); is the zone right?"
        )
    east_north = utm_from_lon_lat(lon_lat, utm_zone, hemisphere)
    types = tuple(row["type"] for row in rows)
    try:
        return TrafficLightMap(
            ids=tuple(row["id"] for row in rows),
            types=types,
            positions=np.column_stack([east_north, [row["height_m"] for row in rows]]),
            headings_deg=np.array([row["heading_deg"] for row in rows], dtype=np.float64),
            sizes_m=signals.sizes_m(types),
            intersections=tuple(row["intersection"] for row in rows),
            groups=tuple(row["group"] for row in rows),
            lanes=tuple(row["lanes"] for row in rows),
            lane_lines=_read_lanes(path, lanes, utm_zone, hemisphere),
        )
    except MapError as error:
        raise MapError(f"{path}: {error}") from error


def save_map(path: Path, lights: TrafficLightMap, utm_zone: int, hemisphere: Hemisphere) -> None:
    """Write a map that `load_map` reads back to less than a millimetre.

    Raises:
        MapError: If the zone does not exist.
    """
    lon_lat = lon_lat_from_utm(lights.positions[:, :2], utm_zone, hemisphere)
    features: list[dict[str, Any]] = [
        {
            "type": "Feature",
            "geometry": {
                "type": "Point",
                "coordinates": [round(float(value), _LON_LAT_DECIMALS) for value in lon_lat[i]],
            },
            "properties": {
                "id": lights.ids[i],
                "type": lights.types[i],
                "height_m": round(float(lights.positions[i, 2]), 4),
                "heading_deg": round(float(lights.headings_deg[i]) % 360, 4),
                "intersection": lights.intersections[i],
                "group": lights.groups[i],
                **({"lanes": list(lights.lanes[i])} if lights.lanes[i] else {}),
            },
        }
        for i in range(len(lights))
    ]
    for lane, line in lights.lane_lines.items():
        points = lon_lat_from_utm(line, utm_zone, hemisphere).round(_LON_LAT_DECIMALS).tolist()
        geometry = {"type": "LineString", "coordinates": points}
        features.append({"type": "Feature", "geometry": geometry, "properties": {"lane": lane}})
    write_json(path, {"type": "FeatureCollection", "features": features})


def _read_features(path: Path) -> list[Any]:
    features = read_json_object(path, error=MapError).get("features")
    if not isinstance(features, list):
        raise MapError(f"{path}: must be a GeoJSON FeatureCollection with a list of 'features'")
    return features


def _is_lane(feature: Any) -> bool:
    try:
        return feature["geometry"]["type"] == "LineString" and "lane" in feature["properties"]
    except (KeyError, TypeError):
        return False


def _read_lanes(
    path: Path, features: list[tuple[int, Any]], utm_zone: int, hemisphere: Hemisphere
) -> dict[str, FloatArray]:
    lines: dict[str, FloatArray] = {}
    for index, feature in features:
        lane = str(feature["properties"]["lane"])
        where = f"{path}: feature {index}: lane '{lane}'"
        if lane in lines:
            raise MapError(f"{where} is given twice")
        try:
            lon_lat = np.array([point[:2] for point in feature["geometry"]["coordinates"]], dtype=np.float64)
        except (KeyError, TypeError, ValueError) as error:
            raise MapError(f"{where}: {error}") from error
        # Written so that NaN fails too.
        if lon_lat.ndim != 2 or len(lon_lat) < 2 or not (np.abs(lon_lat) <= (180.0, 90.0)).all():
            raise MapError(f"{where}: needs two points or more of longitude and latitude, got {lon_lat.tolist()}")
        lines[lane] = utm_from_lon_lat(lon_lat, utm_zone, hemisphere)
    return lines


def _read_lane_names(value: Any) -> tuple[str, ...]:
    if value is None:
        return ()
    if not isinstance(value, list) or not all(isinstance(name, str | int) for name in value):
        raise ValueError(f"lanes must be a list of names, got {value!r}")
    return tuple(str(name) for name in value)


def _read_light(path: Path, index: int, feature: Any, signals: SignalSet) -> dict[str, Any]:
    where = f"{path}: feature {index}"
    try:
        properties = feature["properties"]
        where = f"{path}: light '{properties['id']}'"
        kind = feature["geometry"]["type"]
        if kind != "Point":
            raise MapError(f"{where}: its geometry must be a Point, got {kind}")
        lon, lat = (float(value) for value in feature["geometry"]["coordinates"][:2])
        row = {
            "id": str(properties["id"]),
            "type": str(properties["type"]),
            "lon_lat": (lon, lat),
            "height_m": float(properties["height_m"]),
            "heading_deg": float(properties["heading_deg"]),
            "intersection": str(properties.get("intersection") or ""),
            "group": str(properties.get("group") or ""),
            "lanes": _read_lane_names(properties.get("lanes")),
        }
    except KeyError as error:
        raise MapError(f"{where}: property {error} is missing") from error
    except (TypeError, ValueError) as error:
        raise MapError(f"{where}: {error}") from error
    if row["type"] not in signals.types:
        raise MapError(
            f"{where}: unknown type '{row['type']}'; "
            f"signal description '{signals.name}' knows {', '.join(signals.types)}"
        )
    # Written so that NaN fails too.
    if not (abs(lon) <= 180 and abs(lat) <= 90):
        raise MapError(
            f"{where}: longitude and latitude must lie in ±180 and ±90, got {lon}, {lat}; are they swapped or metres?"
        )
    return row
