import numpy as np
import pyproj
import pytest

from autolights.core.errors import MapError
from autolights.data.utm import lon_lat_from_utm, utm_from_lon_lat


@pytest.mark.parametrize("zone", [1, 17, 60])
@pytest.mark.parametrize(("hemisphere", "code"), [("north", 32600), ("south", 32700)])
def test_agrees_with_the_geodetic_library(zone, hemisphere, code):
    random = np.random.default_rng(zone)
    # As far beyond the zone's edge as maps are taken, over all latitudes that UTM serves.
    lon = (6 * zone - 183 + random.uniform(-6, 6, 5000) + 180) % 360 - 180
    lat = random.uniform(0, 84, 5000) if hemisphere == "north" else random.uniform(-80, 0, 5000)
    lon_lat = np.column_stack([lon, lat])
    transformer = pyproj.Transformer.from_crs("EPSG:4326", f"EPSG:{code + zone}", always_xy=True)
    wanted = np.column_stack(transformer.transform(lon, lat))

    np.testing.assert_allclose(utm_from_lon_lat(lon_lat, zone, hemisphere), wanted, rtol=0, atol=1e-6)
    degrees = lon_lat_from_utm(wanted, zone, hemisphere)
    turned = (degrees - lon_lat + [180, 0]) % 360 - [180, 0]
    np.testing.assert_allclose(turned[:, 0] * np.cos(np.radians(lat)), 0, atol=1e-11)  # 0.001 mm
    np.testing.assert_allclose(degrees[:, 1], lat, rtol=0, atol=1e-11)


def test_nothing_is_nothing():
    assert utm_from_lon_lat(np.empty((0, 2)), 17, "north").shape == (0, 2)
    assert lon_lat_from_utm(np.empty((0, 2)), 17, "south").shape == (0, 2)


@pytest.mark.parametrize("zone", [0, 61])
def test_there_are_60_zones(zone):
    with pytest.raises(MapError, match=f"UTM zones go from 1 to 60, got {zone}"):
        utm_from_lon_lat(np.zeros((1, 2)), zone, "north")
