"""Which lights matter now: distance along the way, intersection, whether they govern the approach."""

import json
from collections.abc import Callable

import numpy as np
import pytest

from autolights.core import LightEstimate, Pose, SignalSet, TrafficLightMap
from autolights.pipeline import PipelineConfig
from autolights.track import Relevance, RelevanceConfig
from autolights.track.relevance import intersections

NONE: np.ndarray = np.empty((0, 3))
QUATERNION = {
    "east": [0.0, 0.0, 0.0, 1.0],
    "north": [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)],
    "west": [0.0, 0.0, 1.0, 0.0],
}


def make_map(signals: SignalSet, lights: dict[str, tuple[float, float, float]], **columns: object) -> TrafficLightMap:
    """Lights by id: east, north, heading; all of type 3 and 5 m up."""
    rows = np.array(list(lights.values())).reshape(-1, 3)
    return TrafficLightMap(
        tuple(lights),
        ("3",) * len(lights),
        np.column_stack([rows[:, :2], np.full(len(rows), 5.0)]),
        rows[:, 2],
        signals.sizes_m(("3",) * len(lights)),
        **columns,  # type: ignore[arg-type]
    )


def estimate(track_id: int, map_id: str | None, position: tuple[float, float, float]) -> LightEstimate:
    return LightEstimate(0, track_id, map_id, "3", "3-red", 0.9, False, False, np.array(position), None, 1.0, 0)


def tell(
    lights: TrafficLightMap,
    heads: str = "east",
    at: tuple[float, float] = (0.0, 0.0),
    unmapped: TrafficLightMap | None = None,
    lanes: list[str] | None = None,
    **config: float,
) -> list[LightEstimate]:
    pose = Pose(0, np.array([*at, 1.0]), np.array(QUATERNION[heads]))
    unmapped = lights.take(np.empty(0, dtype=np.int64)) if unmapped is None else unmapped
    known = [estimate(i + 1, light_id, tuple(lights.positions[i])) for i, light_id in enumerate(lights.ids)]
    known += [estimate(int(t), None, tuple(p)) for t, p in zip(unmapped.ids, unmapped.positions, strict=True)]
    return Relevance(lights, RelevanceConfig(**config)).tell(known, unmapped, pose, lanes)


def test_the_way_ahead_is_counted_along_the_heading(signals: SignalSet) -> None:
    lights = make_map(signals, {"a": (30.0, 40.0, 180.0)})
    assert tell(lights, "east")[0].ahead_m == pytest.approx(30)
    assert tell(lights, "north")[0].ahead_m == pytest.approx(40)
    assert tell(lights, "west")[0].ahead_m == pytest.approx(-30)
    assert tell(lights, "north", at=(30.0, 50.0))[0].ahead_m == pytest.approx(-10)


@pytest.mark.parametrize(
    ("place", "governs"),
    [
        pytest.param((40.0, 0.0, 270.0), True, id="faces-us"),
        pytest.param((40.0, 0.0, 310.0), True, id="40-degrees-aside"),
        pytest.param((40.0, 0.0, 320.0), False, id="50-degrees-aside"),
        pytest.param((40.0, 0.0, 180.0), False, id="crossing-street"),
        pytest.param((40.0, 0.0, 90.0), False, id="shows-its-back"),
        pytest.param((-1.0, 0.0, 270.0), False, id="passed"),
        pytest.param((40.0, 24.0, 270.0), True, id="at-the-corner"),
        pytest.param((40.0, -26.0, 270.0), False, id="another-road"),
    ],
)
def test_who_governs_by_heading(signals: SignalSet, place: tuple[float, float, float], governs: bool) -> None:
    assert tell(make_map(signals, {"a": place}))[0].governs is governs


def test_nearest_upcoming_intersection_first(signals: SignalSet) -> None:
    lights = make_map(
        signals,
        {
            "far": (90.0, 0.0, 270.0),
            "behind": (-20.0, 0.0, 270.0),
            "crossing": (28.0, 5.0, 180.0),
            "ours-2": (35.0, 0.0, 270.0),
            "parallel": (10.0, 60.0, 270.0),
            "ours-1": (33.0, 4.0, 270.0),
        },
    )
    told = tell(lights)
    assert [light.map_id for light in told] == ["ours-2", "ours-1", "crossing", "far", "parallel", "behind"]
    assert [light.governs for light in told] == [True, True, False, True, False, False]
    assert told[0].intersection == told[2].intersection == "near crossing"
    assert told[3].intersection == "near far"


def test_intersections_are_the_maps_or_clusters(signals: SignalSet) -> None:
    lights = make_map(
        signals,
        {"a": (0, 0, 0), "b": (20, 0, 0), "c": (40, 0, 0), "d": (66, 0, 0), "e": (10, 10, 0), "f": (200, 0, 0)},
        intersections=("", "", "", "", "main", ""),
    )
    names, numbers = intersections(lights, 25.0)
    # a and b lie within 25 m of e, c within 25 m of b only; a named intersection is not chained on.
    assert [names[i] for i in numbers] == ["main", "main", "near c", "near d", "main", "near f"]
    assert intersections(lights.take(np.empty(0, dtype=np.int64)), 25.0)[0] == ()


def test_clusters_against_brute_force(signals: SignalSet) -> None:
    rng = np.random.default_rng(3)
    places = np.column_stack([rng.uniform(0, 300, (60, 2)), np.zeros(60)])
    lights = make_map(signals, {f"t{i:02d}": tuple(place) for i, place in enumerate(places)})
    _, numbers = intersections(lights, 25.0)
    reach = np.linalg.norm(places[:, None] - places[None], axis=-1) <= 25.0
    for _ in range(60):
        reach = (reach.astype(int) @ reach.astype(int)) > 0
    np.testing.assert_array_equal(numbers[:, None] == numbers[None, :], reach)


def test_lights_that_the_map_lacks_join_an_intersection_or_make_one(signals: SignalSet) -> None:
    lights = make_map(signals, {"a": (40.0, 0.0, 270.0)}, intersections=("main",))
    unmapped = make_map(
        signals, {"7": (42.0, 8.0, 265.0), "8": (100.0, 0.0, 268.0), "9": (110.0, 9.0, 180.0), "12": (300.0, 0.0, 90.0)}
    )
    told = {light.track_id: light for light in tell(lights, unmapped=unmapped)}
    assert {i: light.intersection for i, light in told.items()} == {
        1: "main", 7: "main", 8: "near track 8", 9: "near track 8", 12: "near track 12",
    }  # fmt: skip
    assert [told[i].governs for i in (1, 7, 8, 9, 12)] == [True, True, True, False, False]
    alone = tell(lights.take(np.empty(0, dtype=np.int64)), unmapped=unmapped)
    assert [light.intersection for light in alone] == ["near track 7", "near track 8", "near track 8", "near track 12"]


def test_a_track_that_was_just_forgotten_has_no_face(signals: SignalSet) -> None:
    lights = make_map(signals, {})
    pose = Pose(0, np.zeros(3), np.array(QUATERNION["east"]))
    (told,) = Relevance(lights, RelevanceConfig()).tell([estimate(4, None, (9.0, 0.0, 5.0))], lights, pose)
    assert (told.ahead_m, told.intersection, told.governs) == (9.0, "near track 4", None)


LINES = {
    "through": np.array([[-50.0, 0.0], [30.0, 0.0]]),
    "left": np.array([[-50.0, 3.5], [30.0, 3.5]]),
    "against": np.array([[30.0, -3.5], [-50.0, -3.5]]),
}


@pytest.mark.parametrize(
    ("at", "heads", "governs"),
    [
        pytest.param((0.0, 0.3), "east", {"t": True, "l": False, "none": True, "aside": True}, id="through"),
        pytest.param((0.0, 3.0), "east", {"t": False, "l": True, "none": True, "aside": False}, id="left"),
        pytest.param((0.0, 1.75), "east", {"t": True, "l": True, "none": True, "aside": True}, id="on-the-marking"),
        pytest.param((0.0, 9.0), "east", {"t": True, "l": True, "none": True, "aside": False}, id="on-no-lane"),
        pytest.param((0.0, -3.5), "east", {"t": True, "l": True, "none": True, "aside": False}, id="wrong-way"),
        pytest.param((20.0, 0.0), "north", {"t": False, "l": False, "none": False, "aside": True}, id="crossing"),
    ],
)
def test_lane_links_come_before_headings(
    signals: SignalSet, at: tuple[float, float], heads: str, governs: dict[str, bool]
) -> None:
    lights = make_map(
        signals,
        {"t": (40.0, 0.0, 270.0), "l": (40.0, 3.0, 270.0), "none": (40.0, 6.0, 270.0), "aside": (40.0, 35.0, 200.0)},
        lanes=(("through",), ("left",), (), ("through",)),
        lane_lines=LINES,
    )
    assert {light.map_id: light.governs for light in tell(lights, heads, at)} == governs


def test_a_caller_who_knows_the_lane_is_believed(signals: SignalSet) -> None:
    lights = make_map(signals, {"t": (40.0, 0.0, 270.0), "l": (40.0, 3.0, 270.0)}, lanes=(("through",), ("left",)))
    assert [light.governs for light in tell(lights)] == [True, True]
    assert {light.map_id: light.governs for light in tell(lights, lanes=["left"])} == {"t": False, "l": True}


def test_the_pipeline_tells_it_and_the_line_keeps_it(make_scene: Callable) -> None:
    lights = {
        "second": ("3", (70.0, 0.0, 5.0), lambda t: "3-red"),
        "first": ("3", (40.0, -2.0, 5.0), lambda t: "3-red"),
        "new": ("5dh", (41.0, 5.0, 5.0), lambda t: "5dh-green"),
    }
    scene = make_scene(lights, off_map=frozenset({"new"}))
    pipeline = scene.pipeline()
    for t in (0.0, 0.1, 0.2):
        told = scene.step(pipeline, t)
    assert [light.map_id for light in told] == ["first", None, "second"]
    assert [light.intersection for light in told] == ["near first", "near first", "near second"]
    assert [light.governs for light in told] == [True] * 3
    for light in told:
        forward = light.position[0] - scene.pose(0.2).position[0]
        assert light.ahead_m == pytest.approx(forward)
        read = LightEstimate.from_json(json.loads(json.dumps(light.to_json())), light.stamp_ns)
        assert (read.intersection, read.governs) == (light.intersection, light.governs)
        assert read.ahead_m == pytest.approx(light.ahead_m, abs=5e-4)
    assert pipeline.explain()["relevance"] == {"lanes": []}
    plain = scene.drive([0.0, 0.1, 0.2], PipelineConfig(relevance=None))[-1]
    assert [(light.track_id, light.ahead_m, light.governs) for light in plain] == [(i, None, None) for i in (1, 2, 3)]
