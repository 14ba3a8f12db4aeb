"""What tracking remembers: saved as plain JSON and gone on from, and bounded however long it runs."""

import json
from collections.abc import Callable

import numpy as np
import pytest
from pydantic import ValidationError

from autolights.core import Detections, load_config
from autolights.core.errors import DataError
from autolights.pipeline import PipelineConfig
from autolights.track import TrackConfig, TrackManager
from autolights.track.association import Association
from autolights.track.observation import CameraObservation
from autolights.track.projection import ProjectedLights
from autolights.track.states import Looks
from autolights.track.timed_states import TimedStates

AHEAD = (40.0, 2.0, 5.0)


def script(t: float) -> str:
    return ("4-yleft2" if t % 1.1 < 0.62 else "4-off") if t < 3 else "4-yleft1"


LIGHTS = {
    "a": ("3", AHEAD, lambda t: "3-red" if t < 2.5 else "3-green"),
    "b": ("3", (40.0, -1.0, 5.0), lambda t: "3-red" if t < 2.5 else "3-green"),
    "f": ("4", (40.0, -4.0, 5.0), script),
    "new": ("5dh", (40.0, 5.0, 5.0), lambda t: "5dh-green"),
}


@pytest.mark.parametrize("name", ["default", "paper"])
def test_estimates_go_on_from_a_saved_state(make_scene: Callable, name: str) -> None:
    config = load_config(f"runtime/{name}", PipelineConfig)
    scene = make_scene(LIGHTS, off_map=frozenset({"new"}), cameras=("narrow", "wide"), noise_px=0.5, groups=True)
    first, second = scene.pipeline(config), scene.pipeline(config)
    times = np.arange(60) / 10
    shots = [[scene.detect(camera, t) for camera in scene.rig] for t in times]

    def step(pipeline, i):
        return [e.to_json() for e in pipeline.step_detections(scene.shots(times[i]), shots[i])]

    for i in range(27):
        step(first, i)
    second.restore(json.loads(json.dumps(first.to_json())))
    for i in range(27, 60):
        assert step(second, i) == step(first, i)
    assert len(step(first, 59)) == 4


def test_a_long_drive_goes_on_from_wherever_it_was_saved(make_scene: Callable) -> None:
    """Past the moment at which lights that were passed are settled for good; places, relevance and duplicates too."""
    lights = {
        **LIGHTS,
        "c": ("3", (150.0, 1.0, 5.0), lambda t: "3-red"),
        "new2": ("3", (150.0, -3.0, 5.0), lambda t: "3-red"),
        "twin": ("3", (150.3, -3.3, 5.2), lambda t: "3-red" if t > 15 else None),
    }
    off_map = frozenset({"new", "new2", "twin"})
    scene = make_scene(lights, off_map=off_map, cameras=("narrow", "wide"), speed_mps=6.0, noise_px=0.5)
    times = np.arange(0, 24.0, 0.2)
    shots = [[scene.detect(camera, t) for camera in scene.rig] for t in times]

    def step(pipeline, i):
        told = pipeline.step_detections(scene.shots(times[i]), shots[i])
        # The last digits hang on how arrays lie in memory.
        return [e.to_json() | {"covariance": np.round(e.covariance, 9).tolist()} for e in told]

    first, saved, restored = scene.pipeline(), {}, {}
    for i in range(len(times)):
        if i in (20, 70, 95):
            saved[i] = json.loads(json.dumps(first.to_json()))
            restored[i] = scene.pipeline()
            restored[i].restore(saved[i])
        told = step(first, i)
        for pipeline in restored.values():
            assert step(pipeline, i) == told
    assert any(light["governs"] and light["covariance"] for light in told)
    active = [state["places"]["places"]["lights"]["_active"] for state in (saved[20], first.to_json())]
    assert all(active[0]), "nothing was settled yet"
    assert not all(active[1]), "the lights that were passed are"


def test_a_state_of_something_else_is_refused(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS)
    pipeline = scene.pipeline()
    scene.step(pipeline, 0.0)
    saved = pipeline._tracks.to_json()
    manager = scene.pipeline()._tracks
    for change, message in (
        ({"format": 99}, "format 99 is not 4"),
        ({"signals": "other"}, "signals was 'other' when it was saved and is 'autolights_13' now"),
        ({"config": {**saved["config"], "dwell_stages": 3}}, "setting track.dwell_stages was 3"),
        ({"map_ids": ["gone"]}, "light 'gone' is not on the map"),
        ({"tracks": {}}, r"damaged \(KeyError"),
    ):
        with pytest.raises(DataError, match=message):
            manager.restore({**saved, **change})


def look_at(manager: TrackManager, scene: object, t: float, places: np.ndarray) -> CameraObservation:
    """One image whose detections are all new lights."""
    n = len(places)
    boxes = np.tile([100.0, 100.0, 110.0, 130.0], (n, 1))
    probs = np.full((n, 13), 0.01)
    probs[:, scene.signals.class_ids["3-red"]] = 0.9
    none = np.empty(0, dtype=np.int64)
    return CameraObservation(
        camera=scene.rig["narrow"],
        pose=scene.pose(t),
        detections=Detections(boxes, np.full(n, 0.9), probs),
        projected=ProjectedLights(none, np.empty(0, np.str_), np.empty((0, 4)), np.empty(0), np.empty(0, dtype=bool)),
        cost=np.empty((0, n)),
        association=Association(np.empty((0, 2), dtype=np.int64), none, np.arange(n)),
        positions=places,
        new_lights=np.arange(n),
    )


def test_memory_is_bounded_however_many_lights_pass(make_scene: Callable) -> None:
    scene = make_scene({})
    manager = TrackManager(
        scene.map,
        scene.signals,
        scene.hmm,
        TrackConfig(birth_hits=1, max_tracks=20, max_coast_s=0.15, state_memory_s=0.15),
    )
    rng = np.random.default_rng(0)
    sizes = []
    for i in range(200):
        places = scene.pose(0).position + rng.uniform(20, 60, (3, 3))
        manager.update([look_at(manager, scene, 0.0, places)], round(i * 1e8))
        states = manager.to_json()["states"]
        assert len(states["rows"]) <= 6, "of this set and the one before"
        sizes.append(len(json.dumps(manager.to_json())))
        assert len(manager) <= 20
        assert len(manager.unmapped) <= 20
    assert max(sizes[100:]) < 1.1 * max(sizes[20:100])
    assert manager._table.ids.min() > 500, "the latest are kept"


def test_a_light_out_of_sight_for_long_is_born_anew(make_scene: Callable) -> None:
    scene = make_scene({"a": ("3", AHEAD, lambda t: "3-red" if t < 5 else "3-green")}, speed_mps=0)

    def reports(pipeline, times):
        return [scene.step(pipeline, t)[0] if t else scene.step(pipeline, t) for t in times]

    known, forgotten, fresh = (scene.pipeline() for _ in range(3))
    for pipeline in (known, forgotten):
        reports(pipeline, (0.0, 0.1, 0.2))
    at_once, anew = reports(known, (10.1,))[0], reports(forgotten, (10.3, 10.4))
    scene.step(fresh, 10.3)

    assert not at_once.withheld
    assert [light.withheld for light in anew] == [True, False]
    assert anew[1].probability == pytest.approx(scene.step(fresh, 10.4)[0].probability)
    assert at_once.probability != pytest.approx(anew[1].probability)


@pytest.mark.parametrize("source", [0, 1])
@pytest.mark.parametrize("forgotten", [0, 1])
def test_what_is_remembered_of_one_of_two_tracks_is_kept_when_they_become_one(
    make_scene: Callable, forgotten: int, source: int
) -> None:
    scene = make_scene({})
    states = TimedStates(scene.signals, scene.hmm, TrackConfig())
    states.append(np.zeros(2, dtype=np.int64), np.full(2, -1))
    probs = np.full((2, len(scene.signals.classes)), 0.01)
    probs[[0, 1], [scene.signals.class_ids[name] for name in ("3-red", "3-green")]] = 0.9
    nobody = np.empty(0, dtype=np.int64)
    states.let_time_pass(0)
    states.take_in(Looks(np.arange(2), probs, np.full(2, 30.0), nobody))
    alive = np.arange(2) != forgotten
    states.end_set(alive, ~alive)
    known = states.explain(1 - forgotten)["belief"]
    assert states.explain(forgotten) == {"belief": None}
    assert states.report().doubtful[forgotten]

    states.merge(0, 1, source)
    states.keep(np.array([0]))

    assert states.explain(0)["belief"] == known
    assert states.report().class_ids[0] == scene.signals.class_ids["3-green" if forgotten == 0 else "3-red"]


def test_a_dead_light_of_the_map_lives_on_in_a_track_that_is_the_same(make_scene: Callable) -> None:
    lights = {
        "a": ("3", AHEAD, lambda t: "3-red" if t < 1 else None),
        "new": ("3", (40.0, -2.0, 5.0), lambda t: "3-red"),
    }
    scene = make_scene(lights, off_map=frozenset({"new"}), speed_mps=0)
    pipeline = scene.pipeline()
    for t in np.arange(40) / 10:
        told = scene.step(pipeline, t)
    assert [(light.map_id, light.withheld) for light in told] == [("a", True), (None, False)]
    manager = pipeline._tracks
    assert manager._states.explain(0)["belief"] is None

    assert manager.merge(-1 - told[1].track_id, 0) == 0

    assert manager._states.explain(0)["belief"]["3-red"] > 0.9


def test_what_is_acted_upon_is_not_forgotten() -> None:
    with pytest.raises(ValidationError, match=r"state_memory_s must be at least max_coast_s \(2\), got 1"):
        TrackConfig(state_memory_s=1.0)
