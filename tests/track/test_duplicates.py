"""Two tracks of one light become one; two lights never do."""

import copy
import json
from collections.abc import Callable

import numpy as np
import pytest

from autolights.core import Detections, LightEstimate, TrafficLightMap
from autolights.pipeline import LightPipeline, PipelineConfig
from autolights.track import DuplicateConfig, Duplicates, LightPlaces, PlaceConfig
from autolights.track.association import Association
from autolights.track.observation import CameraObservation, SetObservation
from autolights.track.projection import ProjectedLights

RED = ("3", (60.0, 2.0, 5.0), lambda t: "3-red")
ARROW = ("4", (60.0, -2.0, 5.0), lambda t: "4-rleft")


def seen_double(pipeline: LightPipeline, track_id: int, new_id: int, offset_m: np.ndarray) -> dict:
    """The saved state, with a second track of a light that hangs a little beside the first."""
    saved = json.loads(json.dumps(pipeline.to_json()))
    tracks = saved["tracks"]
    row = tracks["tracks"]["ids"].index(track_id)
    for name, column in tracks["tracks"].items():
        column.append(copy.deepcopy(column[row]))
        if name == "ids":
            column[-1] = new_id
        if name == "map_rows":
            column[-1] = -1
        if name == "positions":
            column[-1] = (np.array(column[row]) + offset_m).tolist()
        if name == "information":
            column[-1] = np.eye(3).tolist()
    tracks["next_id"] = new_id
    tracks["map_ids"].append(None)
    index = len(tracks["tracks"]["ids"]) - 1
    tracks["unmapped"].append(tracks["tracks"]["positions"][-1])
    states = tracks["states"]
    states["groups"].append(-1)
    states["said"].append(-1)
    states["pairs"].append(-1)
    for values in states["disputes"].values():
        values.append(-1 if values and not isinstance(values[0], bool) else False)
    slot = states["rows"].index(row)
    states["rows"].append(index)
    for name in ("beliefs", "joined"):
        states[name].append(copy.deepcopy(states[name][slot]))
    places = saved["places"]
    of_light = -1 - track_id if -1 - track_id in places["lights"] else "a"
    slot = places["lights"].index(of_light)
    places["lights"].append(-1 - new_id)
    for column in (places["sizes_m"], places["seen_ns"], *places["places"]["lights"].values()):
        column.append(copy.deepcopy(column[slot]))
    for name in ("positions", "_origins"):
        column = places["places"]["lights"][name]
        column[-1] = (np.array(column[-1]) + offset_m).tolist()
    return saved


def go_on(make_scene: Callable, *, off_map: frozenset[str], track_id: int, offset_m: list[float]) -> tuple:
    scene = make_scene({"a": RED, "f": ARROW}, off_map=off_map, cameras=("narrow", "wide"), speed_mps=8.0, noise_px=0.3)
    plain, doubled = scene.pipeline(), scene.pipeline()
    times = np.arange(0, 5.0, 0.1)
    shots = [[scene.detect(camera, t) for camera in scene.rig] for t in times]

    def step(pipeline: LightPipeline, i: int) -> list[LightEstimate]:
        return pipeline.step_detections(scene.shots(times[i]), shots[i])

    for i in range(15):
        step(plain, i)
    doubled.restore(seen_double(plain, track_id, 9, np.array(offset_m)))
    told = [(step(plain, i), step(doubled, i)) for i in range(15, len(times))]
    return scene, doubled, told


def test_an_unmapped_light_that_was_seen_double_is_one_again(make_scene: Callable) -> None:
    scene, pipeline, told = go_on(make_scene, off_map=frozenset({"a"}), track_id=2, offset_m=[0.4, 0.1, 0.0])
    assert sorted(e.track_id for e in told[0][1]) == [1, 2, 9], "seen double"
    assert [sorted(e.track_id for e in lights) for _, lights in told[-20:]] == [[1, 2]] * 20, "the older id stays"
    assert len(pipeline._tracks.unmapped) == 1
    for wanted, got in told[-20:]:
        wanted, got = ({e.track_id: e for e in lights} for lights in (wanted, got))
        assert got[2].class_name == wanted[2].class_name == "3-red"
        assert np.linalg.norm(got[2].position - scene.truth.positions[0]) < 0.3
        assert got[2].views == wanted[2].views


def test_a_light_of_the_map_that_was_also_followed_as_unknown_is_one_again(make_scene: Callable) -> None:
    _, pipeline, told = go_on(make_scene, off_map=frozenset(), track_id=1, offset_m=[0.3, 0.1, 0.0])
    assert sorted((e.track_id, e.map_id) for e in told[0][1] if e.map_id != "f") == [(1, "a"), (9, None)]
    for _, lights in told[-20:]:
        assert sorted((e.track_id, e.map_id) for e in lights) == [(1, "a"), (2, "f")]
    assert len(pipeline._tracks.unmapped) == 0
    assert len(pipeline._places.places) == 2


def test_the_older_id_stays_though_the_map_knows_the_younger(make_scene: Callable) -> None:
    scene = make_scene({"a": RED, "f": ARROW}, off_map=frozenset({"f"}), speed_mps=8.0)
    pipeline = scene.pipeline()
    for t in (0.0, 0.1, 0.2):
        scene.step(pipeline, t)
    manager = pipeline._tracks
    table = manager._table
    # Track 1 is the map's light; let an older track 0 be the same light, unknown to the map.
    saved = manager.to_json()
    rows = {name: [column[0], *column] for name, column in saved["tracks"].items()}
    saved["tracks"] = rows | {"ids": [0, *table.ids.tolist()]}
    saved["tracks"]["information"][0] = np.eye(3).tolist()
    saved["map_ids"] = [None, *saved["map_ids"]]
    saved["unmapped"] = [table.positions[0].tolist(), *saved["unmapped"]]
    states = saved["states"]
    for name in ("groups", "said", "pairs"):
        states[name] = [-1, *states[name]]
    states["disputes"] = {name: [column[0], *column] for name, column in states["disputes"].items()}
    of_light = states["beliefs"][states["rows"].index(0)]
    states["beliefs"] = [np.full_like(np.array(of_light), 1e-6).tolist(), *states["beliefs"]]
    states["rows"] = [0, *(row + 1 for row in states["rows"])]
    states["joined"] = [-1, *states["joined"]]
    manager.restore(saved)
    belief = manager._states.explain(1)["belief"]
    assert manager.merge(-1, 0) == 0
    assert manager._table.ids.tolist() == [0, 2]
    assert manager._table.map_rows.tolist() == [0, -1]
    assert manager._states.explain(0)["belief"] == belief, "the map's light keeps its own belief"
    np.testing.assert_array_equal(manager._table.information[0], 0)
    assert manager.merge(-3, 0) is None, "of another type"
    assert {e.map_id: e.track_id for e in scene.step(pipeline, 0.3)} == {"a": 0, None: 2}


@pytest.mark.parametrize("apart", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.8, 0.0)])
@pytest.mark.parametrize("off_map", [frozenset({"a", "b"}), frozenset({"b"})], ids=["both-unmapped", "one-unmapped"])
def test_two_lights_a_metre_apart_are_two(
    make_scene: Callable, apart: tuple[float, float, float], off_map: frozenset[str]
) -> None:
    def blinking(odd: int) -> Callable[[float], str | None]:
        # From the first second on the detector has one or the other for a second at a time, then both again.
        return lambda t: "3-red" if t < 1 or int(t) % 3 in (odd, 2) else None

    place = np.array([60.0, 0.0, 5.0])
    lights = {
        "a": ("3", tuple(place), blinking(1)),
        "b": ("3", tuple(place + apart), blinking(0)),
        "f": ARROW,
    }
    scene = make_scene(lights, off_map=off_map, cameras=("narrow", "wide"), speed_mps=8.0, noise_px=0.5)
    pipeline = scene.pipeline()
    merged = []
    merge = pipeline._tracks.merge
    pipeline._tracks.merge = lambda *pair: merged.append(pair) or merge(*pair)
    for t in np.arange(0, 5.5, 0.1):
        told = scene.step(pipeline, t)
    assert merged == []
    assert len({e.track_id for e in told if e.type == "3"}) == 2


def test_null_leaves_tracks_alone(make_scene: Callable) -> None:
    scene = make_scene({"a": RED}, off_map=frozenset({"a"}), speed_mps=8.0)
    for config in (PipelineConfig(duplicates=None), PipelineConfig(places=None)):
        pipeline = scene.pipeline(config)
        assert pipeline._duplicates is None
        for t in (0.0, 0.1, 0.2):
            scene.step(pipeline, t)
        assert pipeline.to_json()["duplicates"] is None


def test_evidence_counts_once(make_scene: Callable) -> None:
    """What two rows learnt of one light by turns is what one row learns of all of it."""
    scene = make_scene({"a": RED, "f": ARROW}, speed_mps=8.0, noise_px=0.5)
    # Images count alike wherever they were taken, so that by turns is the same as in one go.
    config = PlaceConfig(decorrelation_m=1e-6, every_s=0.0)
    camera, truth = scene.rig["narrow"], scene.truth
    split, whole = LightPlaces(["narrow"], config), LightPlaces(["narrow"], config)
    shift = np.array([0.8, -0.1, 0.05])
    for places, count in ((split, 2), (whole, 1)):
        for i in range(count):
            first = truth.positions[:1] + i * shift
            places.append(first, truth.headings_deg[:1], truth.sizes_m[:1], on_map=False)
        places.append(truth.positions[1:], truth.headings_deg[1:], truth.sizes_m[1:], on_map=True)
    for i, t in enumerate(np.arange(0, 5.0, 0.1)):
        pose = scene.pose(t)
        boxes = scene.boxes("narrow", t) + scene.rng.normal(0, 0.5, (2, 4))
        split.observe(np.array([i % 2, 2]), boxes, camera, pose)
        whole.observe(np.array([0, 1]), boxes, camera, pose)
        for places in (split, whole):
            places.settle(pose.stamp_ns)
    split.merge(0, 1)
    split.keep(np.array([0, 2]))
    split.settle(pose.stamp_ns)
    np.testing.assert_allclose(split.positions, whole.positions, atol=0.03)
    np.testing.assert_allclose(split.covariances, whole.covariances, rtol=0.1, atol=1e-5)


class Places:
    """Says where lights are, by key."""

    def __init__(self, **offsets_m: tuple[float, float, float]) -> None:
        self.offsets_m = {int(name.removeprefix("track_")): np.array(offset) for name, offset in offsets_m.items()}

    def place_of(self, key: int) -> tuple[np.ndarray, np.ndarray]:
        at = np.array([40.0, 0.0, 5.0]) + self.offsets_m.get(-1 - key, 0.0)
        return at, np.diag([0.5, 0.02, 0.02]) ** 2


def image(scene: object, detected: list[int], *, expected: bool = True) -> CameraObservation:
    """Two unmapped lights, the tracks 5 and 7, with nearly the same box; which of them was detected."""
    boxes = np.array([[600.0, 300.0, 610.0, 330.0], [601.0, 301.0, 611.0, 331.0]])
    none = np.empty(0, dtype=np.int64)
    pairs = np.array([[row, i] for i, row in enumerate(detected)], dtype=np.int64).reshape(-1, 2)
    return CameraObservation(
        camera=scene.rig["narrow"],
        pose=scene.pose(0.0),
        detections=Detections(boxes[detected], np.ones(len(detected)), np.full((len(detected), 13), 0.1)),
        projected=ProjectedLights(
            np.array([0, 1]), np.array(["", ""]), boxes, np.full(2, 40.0), np.full(2, expected)
        ),
        cost=np.empty((2, len(detected))),
        association=Association(pairs, none, none),
        positions=np.full((len(detected), 3), np.nan),
        new_lights=none,
    )  # fmt: skip


SEVEN_FIVE = (-8, -6)


@pytest.mark.parametrize(
    ("images", "places", "found"),
    [
        pytest.param([[0]] * 10, {}, True, id="never-together"),
        pytest.param([[0], [1]] * 5, {}, True, id="by-turns"),
        pytest.param([[0]] * 9, {}, False, id="too-few"),
        pytest.param([[]] * 50, {}, False, id="neither"),
        pytest.param([[0, 1], *[[0]] * 50], {}, False, id="once-together"),
        pytest.param([*[[0]] * 9, [0, 1], *[[0]] * 50], {}, False, id="later-together"),
        pytest.param([[0]] * 10, {"track_7": (0.0, 0.5, 0.0)}, False, id="aside"),
        pytest.param([[0]] * 10, {"track_7": (0.0, 0.0, -0.5)}, False, id="above"),
        pytest.param([[0]] * 10, {"track_7": (1.5, 0.0, 0.0)}, True, id="behind-within-errors"),
        pytest.param([[0]] * 10, {"track_7": (2.5, 0.0, 0.0)}, False, id="behind-beyond-errors"),
    ],
)
def test_when_two_tracks_are_one_light(make_scene: Callable, images: list, places: dict, found: bool) -> None:
    scene = make_scene({})
    lights = scene.map
    unmapped = TrafficLightMap(("5", "7"), ("", ""), np.zeros((2, 3)), np.zeros(2), np.ones((2, 3)))
    duplicates = Duplicates(lights, DuplicateConfig())
    for detected in images:
        duplicates.take_in(SetObservation.of([image(scene, detected)]), unmapped)
    vehicle = np.array([0.0, 0.0, 5.0])
    assert list(duplicates.found(Places(**places), vehicle)) == [SEVEN_FIVE] * found
    again = Duplicates(lights, DuplicateConfig())
    again.restore(json.loads(json.dumps(duplicates.to_json())))
    assert list(again.found(Places(**places), vehicle)) == [SEVEN_FIVE] * found
    duplicates.forget(-8)
    assert duplicates.to_json() == {"apart": [], "alone": []}


def test_a_light_that_none_expects_is_not_missed(make_scene: Callable) -> None:
    scene = make_scene({})
    unmapped = TrafficLightMap(("5", "7"), ("", ""), np.zeros((2, 3)), np.zeros(2), np.ones((2, 3)))
    duplicates = Duplicates(scene.map, DuplicateConfig())
    for _ in range(50):
        duplicates.take_in(SetObservation.of([image(scene, [0], expected=False)]), unmapped)
    assert list(duplicates.found(Places(), np.zeros(3))) == []
