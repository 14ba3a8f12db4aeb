import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from autolights.core import SignalSet, TrafficLightMap
from autolights.core.errors import MapError
from autolights.data import load_map, lon_lat_from_utm, save_map


@pytest.mark.parametrize(
    ("zone", "hemisphere", "east_north"),
    [
        pytest.param(17, "north", [630_084.123, 4_833_438.456], id="toronto"),
        pytest.param(55, "south", [320_704.9, 5_812_911.1], id="melbourne"),
        pytest.param(60, "south", [811_000.0, 7_000_000.0], id="edge-of-a-zone-near-the-date-line"),
        pytest.param(1, "south", [190_000.0, 7_000_000.0], id="and-on-its-other-side"),
    ],
)
def test_positions_come_back_within_a_millimetre(
    tmp_path: Path, signals: SignalSet, zone: int, hemisphere: Any, east_north: list[float]
) -> None:
    lights = TrafficLightMap(("x",), ("4",), np.array([[*east_north, 187.25]]), np.array([359.5]), signals.sizes_m("4"))
    save_map(tmp_path / "map.geojson", lights, zone, hemisphere)
    read = load_map(tmp_path / "map.geojson", signals, zone, hemisphere)
    np.testing.assert_allclose(read.positions, lights.positions, atol=1e-3, rtol=0)
    np.testing.assert_allclose(read.headings_deg, lights.headings_deg)
    np.testing.assert_allclose(read.sizes_m, [signals.types["4"].size_m])


def test_the_central_meridian_is_at_500_km_and_longitude_comes_first() -> None:
    lon, lat = lon_lat_from_utm(np.array([[500_000.0, 0.0]]), 17, "north")[0]
    assert lon == pytest.approx(-81.0)
    assert lat == pytest.approx(0.0, abs=1e-9)


def test_groups_and_intersections_come_back(drive_parts, signals: SignalSet) -> None:
    lights = load_map(drive_parts.folder / "map.geojson", signals, 17, "north")
    assert lights.intersections == ("first", "first", "second")
    assert lights.groups == ("through", "left", "")


def test_lanes_come_back(tmp_path: Path, signals: SignalSet) -> None:
    line = np.array([[500_000.0, 4_800_000.0], [500_050.0, 4_800_001.0], [500_080.0, 4_800_001.5]])
    lights = TrafficLightMap(
        ids=("x", "y"),
        types=("4", "3"),
        positions=np.array([[500_090.0, 4_800_000.0, 5.0], [500_090.0, 4_800_003.0, 5.0]]),
        headings_deg=np.array([270.0, 270.0]),
        sizes_m=signals.sizes_m(("4", "3")),
        lanes=(("left", "12"), ()),
        lane_lines={"left": line},
    )
    save_map(tmp_path / "map.geojson", lights, 17, "north")
    read = load_map(tmp_path / "map.geojson", signals, 17, "north")
    assert read.lanes == lights.lanes
    assert read.ids == ("x", "y")
    np.testing.assert_allclose(read.lane_lines["left"], line, atol=1e-3, rtol=0)
    assert read.take(np.array([1])).lanes == ((),)


def test_an_empty_map_is_a_map(tmp_path: Path, signals: SignalSet) -> None:
    path = tmp_path / "map.geojson"
    path.write_text('{"type": "FeatureCollection", "features": []}')
    assert len(load_map(path, signals, 17, "north")) == 0


def _lane(coordinates: Any) -> dict[str, Any]:
    geometry = {"type": "LineString", "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": {"lane": "left"}}


LINE = [[-81.0, 43.0], [-81.0, 43.001]]


def _light(**changes: Any) -> dict[str, Any]:
    properties = {"id": "main-1", "type": "3", "height_m": 5, "heading_deg": 90}
    coordinates = changes.pop("coordinates", [-81.0, 43.0])
    properties.update(changes)
    properties = {name: value for name, value in properties.items() if value is not ...}
    return {"type": "Feature", "geometry": {"type": "Point", "coordinates": coordinates}, "properties": properties}


@pytest.mark.parametrize(
    ("features", "message"),
    [
        pytest.param([_light(type="7")], r"light 'main-1': unknown type '7'.*knows 3, 4, 5dh", id="type"),
        pytest.param([_light(), _light()], r"map.geojson: light ids must be unique, got 'main-1'", id="twice"),
        pytest.param([_light(height_m=...)], r"light 'main-1': property 'height_m' is missing", id="no-height"),
        pytest.param([_light(id=...)], r"feature 0: property 'id' is missing", id="no-id"),
        pytest.param([_light(heading_deg="west")], r"light 'main-1': could not convert.*'west'", id="heading"),
        pytest.param([_light(coordinates=[500_000, 4_800_000])], r"'main-1': longitude and latitude must", id="metres"),
        pytest.param([_light(coordinates=[-81, float("nan")])], r"'main-1': longitude and latitude must", id="nan"),
        pytest.param([_light(lanes="left")], r"light 'main-1': lanes must be a list of names, got 'left'", id="lanes"),
        pytest.param([_lane(LINE), _lane(LINE)], r"feature 1: lane 'left' is given twice", id="lane-twice"),
        pytest.param([_light(), _lane(LINE[:1])], r"feature 1: lane 'left': needs two points or more", id="lane-point"),
        pytest.param([_lane([["a", "b"], LINE[0]])], r"feature 0: lane 'left': could not convert", id="lane-text"),
        pytest.param([_light(coordinates=[43, -81])], r"124.0° from the middle of UTM zone 17", id="swapped"),
    ],
)
def test_a_light_that_cannot_be_is_named(
    tmp_path: Path, signals: SignalSet, features: list[dict[str, Any]], message: str
) -> None:
    path = tmp_path / "map.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    with pytest.raises(MapError, match=message):
        load_map(path, signals, 17, "north")


@pytest.mark.parametrize("zone", [0, 61])
def test_a_zone_that_does_not_exist(tmp_path: Path, signals: SignalSet, zone: int) -> None:
    path = tmp_path / "map.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [_light()]}))
    with pytest.raises(MapError, match=f"1 to 60, got {zone}"):
        load_map(path, signals, zone, "north")
    path.write_text('{"type": "Point"}')
    with pytest.raises(MapError, match=r"FeatureCollection"):
        load_map(path, signals, 17, "north")
