"""Lights that show one phase: what is seen of one is known of all, until they contradict each other."""

from collections.abc import Callable

import numpy as np
import pytest

from autolights.core import TrafficLightMap
from autolights.pipeline import PipelineConfig
from autolights.track.signal_groups import GroupDisputes, Partners, group_numbers, share

TIMES = np.arange(60) / 10
PLACES = [(40.0, y, 5.0) for y in (2.0, -1.0, 5.0)]


def told(reports: list, map_id: str) -> list[str | None]:
    found = [next((e for e in estimates if e.map_id == map_id), None) for estimates in reports]
    return [None if e is None or e.withheld else e.class_name for e in found]


def test_only_one_intersection_group_and_type_are_one_signal() -> None:
    def light_map(*rows: tuple[str, str, str]) -> TrafficLightMap:
        n = len(rows)
        intersections, groups, types = zip(*rows, strict=True)
        ids = tuple(f"{i}" for i in range(n))
        return TrafficLightMap(ids, types, np.zeros((n, 3)), np.zeros(n), np.ones((n, 3)), intersections, groups)

    numbers = group_numbers(
        light_map(
            ("x", "ours", "3"), ("x", "ours", "3"), ("x", "ours", "4"), ("y", "ours", "3"), ("x", "", "3"),
            ("x", "", "3"), ("y", "ours", "3"),
        )
    )  # fmt: skip
    assert numbers.tolist() == [0, 0, -1, 1, -1, -1, 1]


def green_at_3(t: float) -> str:
    return "3-red" if t < 2.95 else "3-green"


@pytest.mark.parametrize("groups", [True, False])
def test_a_light_behind_a_lorry_changes_with_its_group(make_scene: Callable, groups: bool) -> None:
    hidden = lambda t: None if 2.45 < t < 4.05 else green_at_3(t)  # noqa: E731
    lights = {"a": ("3", PLACES[0], hidden), "b": ("3", PLACES[1], green_at_3)}
    reports = make_scene(lights, groups=groups, speed_mps=0, accuracy=0.998).drive(TIMES)
    assert told(reports, "b")[33:] == ["3-green"] * 27
    assert set(told(reports, "a")[35:40]) == ({"3-green"} if groups else {"3-red"})


def test_an_error_of_one_is_outvoted(make_scene: Callable) -> None:
    wrong = lambda t: "3-green" if 2 < t < 3 else "3-red"  # noqa: E731
    red = lambda t: "3-red"  # noqa: E731
    lights = {"a": ("3", PLACES[0], wrong), "b": ("3", PLACES[1], red), "c": ("3", PLACES[2], red)}
    assert set(told(make_scene(lights, groups=True, speed_mps=0).drive(TIMES), "a")[1:]) == {"3-red"}


def test_lights_that_contradict_each_other_share_no_more(make_scene: Callable) -> None:
    lights = {
        "a": ("3", PLACES[0], lambda t: "3-red"),
        "b": ("3", PLACES[1], lambda t: "3-red" if t < 1 else "3-green"),
    }
    scene = make_scene(lights, groups=True, speed_mps=0)
    pipeline = scene.pipeline()
    reports = [scene.step(pipeline, float(t)) for t in TIMES]
    assert told(reports, "a")[45:] == ["3-red"] * 15
    assert told(reports, "b")[45:] == ["3-green"] * 15
    for track in pipeline.explain()["tracks"]:
        assert track["group"]["disputed"], "it is said, and not averaged away"
        assert not track["group"]["shares"]


def test_a_dispute_outlasts_a_set_in_which_one_is_not_seen() -> None:
    disputes, rows, mates = GroupDisputes(after_s=1.0), np.arange(2), Partners.of(np.array([7, 7]))
    disputes.append(2)
    odd, agreed = np.eye(2), np.array([[0.9, 0.1], [0.9, 0.1]])
    both, one = np.ones(2, dtype=bool), np.array([True, False])
    said = []
    for now_ms, beliefs, seen in (
        (0, odd, both),
        (1000, odd, both),
        (1100, odd, one),
        (1200, odd, both),
        (1300, agreed, one),
        (1400, agreed, both),
    ):
        disputes.judge(rows, mates, beliefs, seen, now_ms)
        said.append(bool(disputes.disputed.all()))
    assert said == [False, True, True, True, True, False]


def test_who_has_lost_all_mates_shares_no_more(make_scene: Callable) -> None:
    lights = {"a": ("3", PLACES[0], lambda t: "3-red"), "b": ("3", PLACES[1], lambda t: "3-red" if t < 1 else None)}
    scene = make_scene(lights, groups=True, speed_mps=0)
    pipeline = scene.pipeline()
    shares = []
    for t in TIMES[:45]:
        scene.step(pipeline, float(t))
        shares.append(next(x["group"]["shares"] for x in pipeline.explain()["tracks"] if x["map_id"] == "a"))
    assert shares[9]
    assert not shares[-1], "b is dead"


def test_they_share_again_once_they_agree(make_scene: Callable) -> None:
    lights = {
        "a": ("3", PLACES[0], lambda t: "3-red"),
        "b": ("3", PLACES[1], lambda t: "3-green" if 1 < t < 3.5 else "3-red"),
    }
    scene = make_scene(lights, groups=True, speed_mps=0)
    pipeline = scene.pipeline()
    for t in TIMES:
        scene.step(pipeline, float(t))
    assert [(t["group"]["disputed"], t["group"]["shares"]) for t in pipeline.explain()["tracks"]] == [(False, True)] * 2


def test_sharing_can_be_left_out(make_scene: Callable) -> None:
    config = PipelineConfig()
    config = config.model_copy(update={"track": config.track.model_copy(update={"share_groups": False})})
    lights = {"a": ("3", PLACES[0], green_at_3), "b": ("3", PLACES[1], green_at_3)}
    scene = make_scene(lights, groups=True, speed_mps=0)
    pipeline = scene.pipeline(config)
    for t in TIMES[:20]:
        scene.step(pipeline, float(t))
    assert not any(track["group"]["shares"] for track in pipeline.explain()["tracks"])


def test_partners_add_up_over_groups_in_any_order() -> None:
    joined, values = np.array([4, -1, 2, 4, -1, 4]), np.random.default_rng(0).random((6, 3))
    of_group = {light: [i for i in range(6) if joined[i] == joined[light] >= 0] or [light] for light in range(6)}
    expected = [values[mates].sum(axis=0) for mates in of_group.values()]
    np.testing.assert_allclose(Partners.of(joined).total(values), expected)
    assert Partners.of(joined[:0]).total(values[:0]).shape == (0, 3)


def test_a_new_group_believes_what_each_of_its_lights_has_seen() -> None:
    rng = np.random.default_rng(0)
    initial, evidence, looks = rng.dirichlet(np.ones(5)), rng.random((3, 5)), rng.dirichlet(np.ones(4), (3, 5))
    own = (initial * evidence)[:, None, :] * looks.transpose(0, 2, 1)
    own /= own.sum(axis=(1, 2), keepdims=True)
    joined = share(own, None, np.full(3, -1), np.array([7, 7, -1]), np.tile(initial, (3, 1)))
    expected = initial * evidence[0] * evidence[1]
    for light in (0, 1):
        np.testing.assert_allclose(joined[light].sum(axis=0), expected / expected.sum())
        np.testing.assert_allclose(joined[light] / joined[light].sum(axis=0), looks[light].T)
    np.testing.assert_array_equal(joined[2], own[2])


def test_who_joins_takes_over_the_belief_and_keeps_its_looks() -> None:
    rng = np.random.default_rng(0)
    own, shared = rng.random((2, 3, 4, 5))
    own /= own.sum(axis=(1, 2), keepdims=True)
    shared /= shared.sum(axis=(1, 2), keepdims=True)
    joined = share(own, shared, np.array([7, 7, -1]), np.array([7, 7, 7]), np.full((3, 5), 0.2))
    np.testing.assert_array_equal(joined[:2], shared[:2])
    np.testing.assert_allclose(joined[2].sum(axis=0), shared[0].sum(axis=0))
    np.testing.assert_allclose(joined[2] / joined[2].sum(axis=0), own[2] / own[2].sum(axis=0))
