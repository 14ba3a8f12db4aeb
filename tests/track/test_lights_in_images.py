"""The known lights of all images at once: those that each image has alone, from a map that is searched now and then."""

from collections.abc import Callable

import numpy as np
import pytest

from autolights.core import Pose, TrafficLightMap, load_signals
from autolights.core.shots import Shots
from autolights.track import join_projected, project_lights
from autolights.track.known_lights import Surroundings
from autolights.track.lights_in_images import project_known
from autolights.track.observation import SetObservation
from autolights.track.projection import ANY_TYPE

ORIGIN = np.array([500_000.0, 4_800_000.0, 200.0])
SIGNALS = load_signals()


def lights_along(count: int, seed: int, *, typed: bool = True) -> TrafficLightMap:
    rng = np.random.default_rng(seed)
    types = tuple(rng.choice(list(SIGNALS.types), count).tolist())
    return TrafficLightMap(
        ids=tuple(map(str, range(count))),
        types=types if typed else (ANY_TYPE,) * count,
        positions=ORIGIN + rng.uniform([-100, -40, 3], [600, 40, 7], (count, 3)),
        headings_deg=rng.uniform(180, 360, count),
        sizes_m=SIGNALS.sizes_m(types),
    )


@pytest.mark.parametrize("unmapped_count", [0, 30])
def test_all_images_at_once_are_each_alone(make_scene: Callable, unmapped_count: int) -> None:
    cameras = list(make_scene({}, cameras=("narrow", "wide")).rig.values())
    lights, unmapped = lights_along(300, 0), lights_along(unmapped_count, 1, typed=False)
    surroundings = Surroundings(lights, tuple(SIGNALS.types), 64.0)
    seen = 0
    for along_m in np.arange(0.0, 500.0, 3.7):
        turn = 0.2 * np.sin(along_m)
        poses = [
            Pose(0, ORIGIN + np.array([along_m + 0.05 * i, 0.0, 1.5]), np.array([0, 0, np.sin(turn), np.cos(turn)]))
            for i in range(2)
        ]
        found = project_known(surroundings.around(poses[0].position, unmapped), Shots.of(cameras, poses))
        for image, (camera, pose) in enumerate(zip(cameras, poses, strict=True)):
            alone = join_projected(
                project_lights(lights, camera, pose), project_lights(unmapped, camera, pose), row_offset=len(lights)
            )
            here = found.images == image
            np.testing.assert_array_equal(found.indices[here], alone.indices)
            np.testing.assert_array_equal(found.types[here], alone.types)
            np.testing.assert_array_equal(found.expected[here], alone.expected)
            np.testing.assert_allclose(found.distances_m[here], alone.distances_m, rtol=1e-9)
            np.testing.assert_allclose(found.boxes_xyxy[here], alone.boxes_xyxy, atol=1e-5)
            seen += len(alone)
    assert seen > 1000


def test_a_set_taken_apart_and_joined_again_is_the_same(make_scene: Callable) -> None:
    lights = {
        "a": ("3", (40.0, 2.0, 5.0), lambda t: "3-red"),
        "b": ("4", (42.0, -3.0, 5.0), lambda t: "4-off" if t < 0.3 else None),
        "new": ("3", (38.0, -1.0, 5.0), lambda t: "3-green"),
    }
    scene = make_scene(lights, off_map=frozenset({"new"}), cameras=("narrow", "wide"))
    pipeline = scene.pipeline()
    for t in (0.0, 0.1, 0.2, 0.3, 0.4):
        scene.step(pipeline, t)
        together, _ = pipeline._behind
        again = SetObservation.of(list(together)[::-1])
        for name in ("seen_in", "known_in", "cost", "positions", "new_lights"):
            np.testing.assert_array_equal(getattr(again, name), getattr(together, name))
        for name in ("matches", "unmatched_lights", "unmatched_detections"):
            np.testing.assert_array_equal(getattr(again.association, name), getattr(together.association, name))
        np.testing.assert_array_equal(again.projected.boxes_xyxy, together.projected.boxes_xyxy)
        np.testing.assert_array_equal(again.detections.class_probs, together.detections.class_probs)


def test_unmapped_lights_that_moved_are_as_if_made_anew(make_scene: Callable) -> None:
    cameras = list(make_scene({}, cameras=("narrow", "wide")).rig.values())
    lights, unmapped = lights_along(100, 0), lights_along(20, 1, typed=False)
    type_names, pose = tuple(SIGNALS.types), Pose(0, ORIGIN, np.array([0.0, 0.0, 0.0, 1.0]))
    shots = Shots.of(cameras, [pose, pose])
    kept = Surroundings(lights, type_names, 64.0)
    before = kept.around(pose.position, unmapped)
    assert kept.around(pose.position, unmapped) is before

    moved = unmapped.at(unmapped.positions + np.array([0.3, -0.2, 0.1]))
    found = project_known(kept.around(pose.position, moved), shots)
    fresh = project_known(Surroundings(lights, type_names, 64.0).around(pose.position, moved), shots)

    assert len(found) > 10
    np.testing.assert_array_equal(found.indices, fresh.indices)
    np.testing.assert_array_equal(found.boxes_xyxy, fresh.boxes_xyxy)
    assert moved.within(moved.positions[3], 0.01).tolist() == [3], "it is searched where it is now"
    assert (project_known(before, shots).boxes_xyxy.shape != found.boxes_xyxy.shape) or not np.array_equal(
        project_known(before, shots).boxes_xyxy, found.boxes_xyxy
    )
