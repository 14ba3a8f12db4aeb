import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from autolights.core import TrafficLightMap
from autolights.pipeline import LightPipeline, PipelineConfig
from autolights.track import PlaceBook, PlaceConfig

LIGHTS = {
    "a": ("3", (60.0, 2.0, 5.0), lambda t: "3-red"),
    "b": ("3", (60.0, -2.0, 5.0), lambda t: "3-red"),
    "new": ("5dh", (60.0, 6.0, 5.0), lambda t: "5dh-green"),
}
ERROR = np.array([0.5, 0.3, -0.2])


def surveyed_wrongly(lights: TrafficLightMap) -> TrafficLightMap:
    positions = lights.positions + np.where(np.array(lights.ids)[:, None] == "a", ERROR, 0.0)
    return TrafficLightMap(lights.ids, lights.types, positions, lights.headings_deg, lights.sizes_m)


def test_a_map_light_moves_to_where_the_images_show_it(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS, off_map=frozenset({"new"}), cameras=("narrow", "wide"), speed_mps=10.0)
    scene.map = surveyed_wrongly(scene.map)
    truth = dict(zip(scene.truth.ids, scene.truth.positions, strict=True))
    told = scene.drive(np.arange(0, 4.0, 0.1).tolist(), PipelineConfig())
    first, last = ({e.map_id: e for e in told[i]} for i in (1, -1))
    assert np.abs(last["a"].position - truth["a"])[1:].max() < 0.07, "aside and up: at once"
    assert abs(last["a"].position[0] - truth["a"][0]) < ERROR[0], "along the way: as parallax grows"
    assert np.linalg.norm(last["b"].position - truth["b"]) < 0.2
    assert np.linalg.norm(last[None].position - truth["new"]) < 0.3
    for light_id, estimate in last.items():
        error = estimate.position - truth[light_id or "new"]
        assert error @ np.linalg.inv(estimate.covariance) @ error < 11.3  # 99 % of three degrees of freedom
        assert estimate.distance_m < first[light_id].distance_m


def test_what_was_told_before_stays_as_it_was(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS, off_map=frozenset({"new"}), speed_mps=10.0)
    pipeline = scene.pipeline()
    kept = []
    for t in np.arange(0, 3.0, 0.1).tolist():
        kept += [(estimate, estimate.position.copy()) for estimate in scene.step(pipeline, t)]
    assert len(kept) > 60
    for estimate, position in kept:
        np.testing.assert_array_equal(estimate.position, position)


@pytest.mark.parametrize(("error_m", "left_m"), [(0.3, 0.0), (0.6, 0.225)])
def test_lights_are_looked_for_where_the_images_showed_them(
    make_scene: Callable, error_m: float, left_m: float
) -> None:
    """Up to 1.5 standard deviations of the map, 0.375 m; what is beyond is left to the gates."""
    scene = make_scene(LIGHTS, cameras=("narrow", "wide"), speed_mps=10.0)
    positions = scene.map.positions + np.array([[0.0, error_m, 0.0]]) * (np.array(scene.map.ids) == "a")[:, None]
    scene.map = replace(scene.map, positions=positions)
    metres_off = {}
    for sigmas in (1.5, 0.0):
        pipeline = scene.pipeline(PipelineConfig(alignment=None, places=PlaceConfig(projected_sigmas=sigmas)))
        for t in np.arange(0, 3.0, 0.1).tolist():
            scene.step(pipeline, t)
        (narrow, *_) = pipeline.explain()["images"]
        row = narrow["known_lights"].index("a")
        detection = next(j for i, j in narrow["matches"] if i == row)
        wanted, found = (np.array(narrow[name]) for name in ("projected_xyxy", "detected_xyxy"))
        aside_px = abs(wanted[row][[0, 2]].mean() - found[detection][[0, 2]].mean())
        height_px = np.ptp(found[detection][[1, 3]])
        metres_off[sigmas] = aside_px / height_px * scene.map.sizes_m[row, 1]
    assert metres_off[0.0] == pytest.approx(error_m, abs=0.08)
    assert metres_off[1.5] == pytest.approx(left_m, abs=0.08)


def test_offsets_are_those_of_the_lights_that_were_seen(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS, cameras=("narrow", "wide"), speed_mps=10.0)
    pipeline = scene.pipeline()
    book = pipeline._places
    np.testing.assert_array_equal(book.offsets_m(np.arange(5)), np.zeros((5, 3)))
    for t in np.arange(0, 1.0, 0.1).tolist():
        scene.step(pipeline, t)
    told = book.offsets_m(np.array([2, 0, 3]))
    for offset, light_id in zip(told, ("new", "a"), strict=False):
        row = scene.map.ids.index(light_id)
        np.testing.assert_array_equal(offset, book.place(light_id, 0)[0] - scene.map.positions[row])
    np.testing.assert_array_equal(told[2], 0.0)


def test_without_places_the_map_has_the_last_word(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS, speed_mps=10.0)
    scene.map = surveyed_wrongly(scene.map)
    told = scene.drive(np.arange(0, 3.0, 0.1).tolist(), PipelineConfig(places=None))[-1]
    where = dict(zip(scene.map.ids, scene.map.positions, strict=True))
    for estimate in told:
        np.testing.assert_array_equal(estimate.position, where[estimate.map_id])
        assert estimate.covariance is None


def test_saved_and_restored_it_knows_the_same_places(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS, off_map=frozenset({"new"}), speed_mps=10.0)
    pipeline: LightPipeline = scene.pipeline()
    for t in np.arange(0, 2.0, 0.1).tolist():
        told = scene.step(pipeline, t)
    book = PlaceBook(scene.map, scene.rig, PlaceConfig())
    book.restore(json.loads(json.dumps(pipeline._places.to_json())))
    assert {e.map_id for e in told} == {"a", "b", None}
    for estimate in told:
        position, covariance = book.place(estimate.map_id, estimate.track_id)
        np.testing.assert_array_equal(position, estimate.position)
        np.testing.assert_array_equal(covariance, estimate.covariance)


def test_only_so_many_lights_are_remembered(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS, speed_mps=10.0)
    pipeline = scene.pipeline()
    for t in (0.0, 0.3, 0.6):
        scene.step(pipeline, t)
    book = pipeline._places
    book._seen_ns[0] = 0
    book._keep(np.array([1, 2]))
    assert len(book.places) == 2
    assert book.place("a", 0) is None or book.place("b", 0) is None
    assert len(scene.step(pipeline, 0.9)) == 3
    assert len(book.places) == 3, "it comes back"
