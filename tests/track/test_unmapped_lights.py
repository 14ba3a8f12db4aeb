"""Lights that the map does not hold, from the first box to what all boxes together say."""

from collections.abc import Callable

import numpy as np
import pytest

from autolights.pipeline import PipelineConfig
from autolights.track import TrackConfig, place_book

TRUTH = (45.0, 2.0, 5.5)


def error_m(scene, positions):
    return np.linalg.norm(positions - (scene.truth.positions[0]), axis=-1)


def test_tracks_stand_where_all_images_together_have_them(make_scene: Callable) -> None:
    scene = make_scene({"x": ("3", TRUTH, lambda t: "3-red")}, off_map=frozenset({"x"}), noise_px=1.0, speed_mps=8.0)
    pipeline = scene.pipeline()
    for i in range(40):
        (light,) = scene.step(pipeline, 0.1 * i) or [None]

    assert error_m(scene, light.position) < 0.5
    np.testing.assert_array_equal(pipeline._tracks._table.positions[0], light.position)
    np.testing.assert_allclose(pipeline._tracks.unmapped.positions[0], light.position, atol=0.02)
    observations, _ = pipeline._behind
    assert np.isnan(observations.positions).all(), "a box of a light whose place is known is not localised"


def test_a_type_that_is_outvoted_takes_its_size_along(make_scene: Callable) -> None:
    # A vehicle that stands and boxes without noise: nothing but the type ever changes.
    scene = make_scene(
        {"x": ("4", TRUTH, lambda t: "3-red" if t < 0.45 else "4-rleft")}, off_map=frozenset({"x"}), speed_mps=0.0
    )
    pipeline = scene.pipeline()
    for i in range(40):
        scene.step(pipeline, 0.1 * i)

    tracks = pipeline._tracks
    four = scene.signals.sizes_m(["4"])
    np.testing.assert_array_equal(tracks.unmapped.sizes_m, four)
    assert error_m(scene, tracks.unmapped.positions[0]) < 4.0, (
        "the depth follows from the size: 11 m with the wrong one"
    )


def test_places_make_room_at_the_cost_of_tracks_that_are_no_more(
    make_scene: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    lights = {f"x{i}": ("3", (40.0, 3.0 * i - 6, 5.5), lambda t: "3-red") for i in range(4)}
    lights |= {"gone": ("3", (45.0, 9.0, 5.5), lambda t: "3-red" if t < 0.25 else None)}
    scene = make_scene(lights, off_map=frozenset(lights), speed_mps=0.0)
    pipeline = scene.pipeline(PipelineConfig(track=TrackConfig(birth_hits=4)))
    for i in range(40):
        scene.step(pipeline, 0.1 * i)
    places = pipeline._places
    before = set(places._keys)
    living = {-1 - int(track) for track in pipeline._tracks.unmapped.ids}
    assert len(living) == 4
    assert before > living, "the place of a candidate that never came back is still kept"

    monkeypatch.setattr(place_book, "_MAX_LIGHTS", 4)
    scene.step(pipeline, 4.0)

    assert set(places._keys) <= living
