"""The light of the scene: what the sky looks like and how bright things are in it."""

from dataclasses import dataclass

import numpy as np

from autolights.core import FloatArray
from autolights.sim.config import LightingName

Bgr = tuple[float, float, float]


@dataclass(frozen=True)
class Lighting:
    """One kind of light; colours are BGR grey levels, 0 to 255.

    Attributes:
        name: As in the configuration.
        sky_top: Colour of the zenith.
        sky_horizon: Colour of the horizon.
        cloud: Colour of clouds.
        ambient: What surfaces keep of their colour, per channel.
        sun_elevation_deg: Height of the sun's disc; None where it is not seen.
        glow: Halo of lit lamps.
        noise_gain: Of the sensor, against full light.
        lamps_on: Headlights, street lamps and windows are lit.
    """

    name: LightingName
    sky_top: Bgr
    sky_horizon: Bgr
    cloud: Bgr
    ambient: Bgr
    sun_elevation_deg: float | None
    glow: float
    noise_gain: float
    lamps_on: bool

    def shade(self, color: Bgr, factor: float = 1.0) -> Bgr:
        """The colour that a surface shows in this light; `factor` is its share by orientation."""
        b, g, r = (min(255.0, c * a * factor) for c, a in zip(color, self.ambient, strict=True))
        return (b, g, r)

    @property
    def ambient_array(self) -> FloatArray:
        """(3,) `ambient`."""
        return np.array(self.ambient)


_SUNNY = Lighting("sunny", (205, 130, 70), (235, 212, 190), (245, 242, 240), (0.94, 0.98, 1.0), None, 0.06, 1.0, False)
_OVERCAST = Lighting(
    "overcast", (205, 196, 190), (228, 224, 222), (188, 182, 178), (0.80, 0.78, 0.76), None, 0.10, 1.2, False
)
_LOW_SUN = Lighting(
    "low_sun", (190, 150, 120), (160, 205, 246), (190, 222, 250), (0.58, 0.68, 0.80), 7.0, 0.16, 1.2, False
)
_DUSK = Lighting("dusk", (92, 56, 38), (110, 118, 178), (96, 84, 104), (0.36, 0.32, 0.31), None, 0.55, 2.2, True)
LIGHTINGS: dict[LightingName, Lighting] = {kind.name: kind for kind in (_SUNNY, _OVERCAST, _LOW_SUN, _DUSK)}
