import numpy as np
import pytest

from autolights.core import load_signals
from autolights.sim.config import NARROW, WIDE
from autolights.sim.programme import draw_programme
from autolights.sim.rig import build_camera
from autolights.sim.view import View
from autolights.sim.visibility import amodal_box
from autolights.suite import ScenarioConfig
from autolights.suite.scene import build_scene, image_boxes, show

TIMES_S = np.arange(0, 60, 0.037)


@pytest.mark.parametrize("light_type", ["3", "4", "5dh"])
def test_signals_are_those_of_the_simulator(light_type: str) -> None:
    signals = load_signals()
    programme = draw_programme(7.3, np.random.default_rng(3))
    lit, reported, flashing = show(programme, light_type, TIMES_S, signals, "ordinary")
    for i, time_s in enumerate(TIMES_S):
        wanted = programme.show(light_type, float(time_s), signals)
        assert signals.classes[lit[i]] == wanted.lit_class
        assert signals.classes[reported[i]] == wanted.class_name
        assert flashing[i] == wanted.flashing


def test_nothing_flashes_in_a_steady_programme() -> None:
    signals = load_signals()
    programme = draw_programme(7.3, np.random.default_rng(3))
    lit, reported, flashing = show(programme, "4", TIMES_S, signals, "steady")
    assert not flashing.any()
    assert np.array_equal(lit, reported)
    assert "4-off" not in {signals.classes[i] for i in lit}


@pytest.mark.parametrize("config", [NARROW, WIDE], ids=["narrow", "wide"])
def test_boxes_are_those_of_the_renderer(config: object) -> None:
    scene = build_scene(ScenarioConfig(about=""), load_signals(), np.random.default_rng(1))
    camera = build_camera(config)  # type: ignore[arg-type]
    poses = scene.poses(np.array([0.0, 3.0, 7.7]))
    boxes = image_boxes(np.array([head.corners() for head in scene.heads]), camera, poses)
    for pose, of_frame in zip(poses, boxes, strict=True):
        for head, box in zip(scene.heads, of_frame, strict=True):
            wanted = amodal_box(head, View(camera, pose))
            if wanted is None:
                assert np.isnan(box).any()
            else:
                assert box == pytest.approx(wanted, abs=1e-6)


def test_lorries_hide_lights_for_as_long_as_stated() -> None:
    scenario = ScenarioConfig(about="", occlusions_per_minute=10, occlusion_s=(0.3, 1.5), duration_s=120)
    scene = build_scene(scenario, load_signals(), np.random.default_rng(2))
    hidden = scene.occlusions.hidden(np.arange(0, 120, 0.01)) > 0
    lengths_s = []
    for column in hidden.T:
        edges = np.flatnonzero(np.diff(column.astype(int)))
        starts = edges[1:-1] if column[0] else edges
        lengths_s += ((starts[1::2] - starts[: 2 * (len(starts) // 2) : 2]) * 0.01).tolist()
    assert 0.28 < min(lengths_s) < max(lengths_s) < 1.52
    assert hidden.any(axis=0).mean() > 0.9


def test_rows_hang_as_close_as_asked() -> None:
    scenario = ScenarioConfig(about="", row_spacing_m=1.5, layouts=(("3", "3", "3", "3"),), junctions=2)
    scene = build_scene(scenario, load_signals(), np.random.default_rng(2))
    for junction in scene.town.junctions:
        row = [h for h in scene.heads if h.intersection == junction.name and h.group == "ours"]
        across = sorted(h.position[1] for h in row if abs(h.position[1]) < 10)
        assert np.diff(across) == pytest.approx([1.5, 1.5, 1.5])
