"""A description whose red is legal steady and flashing: the lit state alone tells no flash (DESIGN: Signals)."""

from collections.abc import Callable

import numpy as np
import pytest

from autolights.core import SignalSet, load_config
from autolights.core.config import parse_config
from autolights.pipeline import PipelineConfig


@pytest.fixture(params=["default", "paper"])
def config(request: pytest.FixtureRequest) -> PipelineConfig:
    return load_config(f"runtime/{request.param}", PipelineConfig)


Watch = Callable[[Callable[[float], str | dict[str, float]], float], list[tuple[str, bool]]]


@pytest.fixture
def watch(make_scene: Callable, config: PipelineConfig, beacon: dict) -> Watch:
    """Look at a light for 8 s: its class and whether it flashes, from the second set on."""

    def look(shown: Callable[[float], str | dict[str, float]], rate_hz: float) -> list[tuple[str, bool]]:
        signals = parse_config(beacon, SignalSet, source="beacon")
        scene = make_scene({"a": ("b", (55.0, 2.0, 5.0), shown)}, signals=signals, speed_mps=0)
        reports = scene.drive(np.arange(round(8 * rate_hz)) / rate_hz, config)
        return [(light.class_name, light.flashing) for (light,) in reports[1:]]

    return look


def flashing(t: float) -> str:
    return "b-red" if t % 1.1 < 0.62 else "b-dark"


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 30.0])
def test_a_steady_red_never_flashes(watch: Watch, rate_hz: float) -> None:
    assert set(watch(lambda t: "b-red", rate_hz)) == {("b-red", False)}


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 30.0])
def test_a_flashing_red_flashes_from_its_first_dark_phase_on(watch: Watch, rate_hz: float) -> None:
    said = watch(flashing, rate_hz)
    known = round(1.0 * rate_hz)
    assert set(said[: round(0.6 * rate_hz) - 1]) == {("b-red", False)}, "so far it might be steady"
    assert set(said[known:]) == {("b-red", True)}


def test_a_flash_that_becomes_steady_is_steady_after_one_period(watch: Watch) -> None:
    said = watch(lambda t: flashing(t) if t < 4.4 else "b-red", rate_hz=5.0)
    last = max(i for i, (_, flashes) in enumerate(said, start=1) if flashes) / 5.0
    assert 4.2 <= last <= 4.2 + 1.2


def test_one_misread_frame_is_no_dark_phase(watch: Watch) -> None:
    said = watch(lambda t: {"b-red": 0.4, "b-dark": 0.5} if abs(t - 4.0) < 0.01 else "b-red", rate_hz=10.0)
    assert set(said) == {("b-red", False)}


def test_a_head_that_stays_dark_is_off(watch: Watch) -> None:
    assert watch(lambda t: "b-dark", rate_hz=10.0)[-1] == ("b-dark", False)
