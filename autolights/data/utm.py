"""UTM on the WGS 84 ellipsoid: the transverse Mercator projection by Krüger's series.

A geodetic library would do the same for 33 MB of the runtime's disk; it is the oracle in the tests.

References:
    Karney 2011, "Transverse Mercator with an accuracy of a few nanometers", Journal of Geodesy 85, eqs. 7 to 36.
"""

from typing import Literal, TypeAlias

import numpy as np

from autolights.core import FloatArray
from autolights.core.errors import MapError

Hemisphere: TypeAlias = Literal["north", "south"]

_FLATTENING = 1 / 298.257223563
_SCALE = 0.9996
_FALSE_EAST_M = 500_000.0
_FALSE_NORTH_M = {"north": 0.0, "south": 10_000_000.0}
_N = _FLATTENING / (2 - _FLATTENING)
_ECCENTRICITY = np.sqrt(_FLATTENING * (2 - _FLATTENING))
_RECTIFYING_RADIUS_M = 6_378_137.0 / (1 + _N) * (1 + _N**2 / 4 + _N**4 / 64 + _N**6 / 256)
# Polynomials in the third flattening n, highest power first: from the spherical transverse Mercator to the ellipsoidal
# one (eq. 35), and back (eq. 36).
_FORWARD = np.array(
    [
        np.polyval([7891 / 37800, -127 / 288, 41 / 180, 5 / 16, -2 / 3, 1 / 2, 0], _N),
        np.polyval([-1983433 / 1935360, 281 / 630, 557 / 1440, -3 / 5, 13 / 48, 0, 0], _N),
        np.polyval([167603 / 181440, 15061 / 26880, -103 / 140, 61 / 240, 0, 0, 0], _N),
        np.polyval([6601661 / 7257600, -179 / 168, 49561 / 161280, 0, 0, 0, 0], _N),
        np.polyval([-3418889 / 1995840, 34729 / 80640, 0, 0, 0, 0, 0], _N),
        np.polyval([212378941 / 319334400, 0, 0, 0, 0, 0, 0], _N),
    ]
)
_INVERSE = np.array(
    [
        np.polyval([96199 / 604800, -81 / 512, -1 / 360, 37 / 96, -2 / 3, 1 / 2, 0], _N),
        np.polyval([-1118711 / 3870720, 46 / 105, -437 / 1440, 1 / 15, 1 / 48, 0, 0], _N),
        np.polyval([5569 / 90720, -209 / 4480, -37 / 840, 17 / 480, 0, 0, 0], _N),
        np.polyval([-830251 / 7257600, -11 / 504, 4397 / 161280, 0, 0, 0, 0], _N),
        np.polyval([-108847 / 3991680, 4583 / 161280, 0, 0, 0, 0, 0], _N),
        np.polyval([20648693 / 638668800, 0, 0, 0, 0, 0, 0], _N),
    ]
)
_LATITUDE_ITERATIONS = 5  # Newton's method gains the last digit with the second or third


def central_meridian_deg(zone: int) -> int:
    """Longitude of the middle of a zone.

    Raises:
        MapError: If the zone is not one of 1 to 60.
    """
    if not 1 <= zone <= 60:
        raise MapError(f"UTM zones go from 1 to 60, got {zone}")
    return 6 * zone - 183


def utm_from_lon_lat(lon_lat: FloatArray, zone: int, hemisphere: Hemisphere) -> FloatArray:
    """(n, 2) degrees of longitude and latitude (WGS 84) → (n, 2) metres east and north; exact to a micrometre.

    Raises:
        MapError: If the zone is not one of 1 to 60.
    """
    lon, lat = np.radians(lon_lat.T - np.array([[central_meridian_deg(zone)], [0.0]]))
    tan_conformal = _tan_conformal(np.tan(lat))
    xi = np.arctan2(tan_conformal, np.cos(lon))
    eta = np.arcsinh(np.sin(lon) / np.hypot(tan_conformal, np.cos(lon)))
    zeta = xi + 1j * eta
    zeta = zeta + _series(_FORWARD, zeta)
    metres = _SCALE * _RECTIFYING_RADIUS_M * np.column_stack([zeta.imag, zeta.real])
    return np.asarray(metres + np.array([_FALSE_EAST_M, _FALSE_NORTH_M[hemisphere]]))


def lon_lat_from_utm(east_north: FloatArray, zone: int, hemisphere: Hemisphere) -> FloatArray:
    """(n, 2) metres of a zone → (n, 2) degrees of longitude and latitude (WGS 84).

    Raises:
        MapError: If the zone is not one of 1 to 60.
    """
    east, north = (east_north - np.array([_FALSE_EAST_M, _FALSE_NORTH_M[hemisphere]])).T / (
        _SCALE * _RECTIFYING_RADIUS_M
    )
    zeta = north + 1j * east
    zeta = zeta - _series(_INVERSE, zeta)
    xi, eta = zeta.real, zeta.imag
    lon = np.arctan2(np.sinh(eta), np.cos(xi))
    wanted = np.sin(xi) / np.hypot(np.sinh(eta), np.cos(xi))
    tan = wanted / (1 - _ECCENTRICITY**2)
    for _ in range(_LATITUDE_ITERATIONS):  # eqs. 19 to 21
        found = _tan_conformal(tan)
        slope = (1 + (1 - _ECCENTRICITY**2) * tan**2) / ((1 - _ECCENTRICITY**2) * np.hypot(1, found) * np.hypot(1, tan))
        tan = tan + (wanted - found) * slope
    lon_deg = np.degrees(lon) + central_meridian_deg(zone)
    return np.column_stack([(lon_deg + 180) % 360 - 180, np.degrees(np.arctan(tan))])


def _tan_conformal(tan: FloatArray) -> FloatArray:
    """Tangent of latitudes → tangent of conformal latitudes (eqs. 7 to 9)."""
    sigma = np.sinh(_ECCENTRICITY * np.arctanh(_ECCENTRICITY * tan / np.hypot(1, tan)))
    return np.asarray(tan * np.hypot(1, sigma) - sigma * np.hypot(1, tan))


def _series(coefficients: FloatArray, zeta: np.ndarray) -> np.ndarray:
    """Sum of c_j sin(2 j zeta), real and imaginary part at once (eqs. 11 and 15)."""
    orders = 2 * np.arange(1, len(coefficients) + 1)
    return np.asarray(np.sin(zeta[:, None] * orders) @ coefficients)
