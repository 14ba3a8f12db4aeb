"""Painted faces: the lit lamp is the brightest place, also where its hue has washed out."""

import colorsys

import pytest

from autolights.core import load_signals
from autolights.sim.disturbances import HeadLook
from autolights.sim.faces import HousingColor, paint_face
from autolights.sim.lighting import LIGHTINGS

SIGNALS = load_signals()
SCALE = 96


def lamp_brightness(class_name: str, look: HeadLook, housing: HousingColor) -> dict[str, float]:
    """Mean brightness within half the radius of each lamp of a painted face."""
    kind = SIGNALS.types[SIGNALS.type_of[class_name]]
    face = paint_face(kind, class_name, housing, look, LIGHTINGS["sunny"], SCALE)[..., :3].astype(float)
    reach = round(0.25 * kind.lamp_diameter_m * SCALE)
    brightness = {}
    for name, lamp in kind.lamps.items():
        x, y = round(lamp.center[0] * face.shape[1]), round(lamp.center[1] * face.shape[0])
        brightness[name] = float(face[y - reach : y + reach, x - reach : x + reach].max(axis=2).mean())
    return brightness


@pytest.mark.parametrize("class_name", SIGNALS.classes)
@pytest.mark.parametrize("washout", [0.0, 0.5, 1.0])
def test_lit_lamps_outshine_dark_ones_however_washed_out(class_name: str, washout: float) -> None:
    lit = SIGNALS.state(class_name).lit
    for housing in ("black", "yellow"):
        brightness = lamp_brightness(class_name, HeadLook(washout=washout), housing)
        dark = max(value for name, value in brightness.items() if name not in lit)
        assert all(brightness[name] > dark + 40 for name in lit)


def test_an_over_exposed_red_turns_amber_and_then_pale() -> None:
    kind = SIGNALS.types["3"]
    hues, saturations = [], []
    for washout in (0.0, 0.5, 1.0):
        face = paint_face(kind, "3-red", "black", HeadLook(washout=washout), LIGHTINGS["sunny"], SCALE)
        x, y = (round(c * n) for c, n in zip(kind.lamps["red"].center, face.shape[1::-1], strict=True))
        blue, green, red = face[y - 6, x + 7, :3] / 255
        hue, saturation, _ = colorsys.rgb_to_hsv(red, green, blue)
        hues.append(min(hue, 1 - hue) * 360)
        saturations.append(saturation)
    assert hues[0] < 12 < hues[1] < 50
    assert saturations[0] > 0.6 > 0.4 > saturations[2]


def test_a_doghouse_has_no_corner_beside_its_top_lamp() -> None:
    face = paint_face(SIGNALS.types["5dh"], "5dh-red", "yellow", HeadLook(), LIGHTINGS["sunny"], SCALE)
    assert face[2, 2, 3] == 0
    assert face[2, face.shape[1] // 2, 3] == 255
    assert face[-3, 2, 3] == 255
