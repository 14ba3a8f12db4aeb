"""The detector is told where lights can be, and none is lost by it."""

from collections.abc import Callable

import numpy as np
import pytest

from autolights.core import CameraFrame, Detections, PoseBuffer, parse_config
from autolights.core.errors import UsageError
from autolights.pipeline import LightPipeline, PipelineConfig
from autolights.track import RegionConfig

LIGHTS = {
    "a": ("3", (40.0, 2.0, 5.0), lambda t: "3-red"),
    "b": ("3", (40.0, -6.0, 5.0), lambda t: "3-red"),
    "new": ("5dh", (30.0, 9.0, 4.0), lambda t: "5dh-green"),
}
BLACK = np.zeros((800, 1280, 3), np.uint8)


class Looking:
    """Sees what lies whole in the region that it is given, and remembers the region."""

    def __init__(self, scene) -> None:
        self.scene = scene
        self.t = 0.0
        self.asked: list[tuple | None] = []

    def batch(self, images_bgr, regions) -> list[Detections]:
        found = []
        for name, region in zip(self.scene.rig, regions, strict=True):
            self.asked.append(region)
            seen = self.scene.detect(name, self.t)
            left, top, right, bottom = region or (0, 0, 1280, 800)
            boxes = seen.boxes_xyxy
            found.append(seen[((boxes[:, :2] >= [left, top]) & (boxes[:, 2:] <= [right, bottom])).all(axis=1)])
        return found


def drive(scene, hmm, config: PipelineConfig, times) -> tuple[list, Looking]:
    detector = Looking(scene)
    poses = PoseBuffer(scene.pose(t) for t in np.arange(0, 60, 0.1))
    pipeline = LightPipeline(detector, hmm, scene.signals, scene.rig, scene.map, config, poses=poses)
    told = []
    for t in times:
        detector.t = float(t)
        told.append(pipeline.step([CameraFrame(name, round(t * 1e9), BLACK) for name in scene.rig]))
    return told, detector


def test_known_lights_are_always_in_the_region(make_scene: Callable, hmm) -> None:
    scene = make_scene(LIGHTS, off_map=frozenset({"new"}), cameras=("narrow", "wide"))
    config = PipelineConfig(regions={"narrow": RegionConfig(whole_every=10), "wide": RegionConfig(whole_every=10)})

    told, detector = drive(scene, hmm, config, np.arange(0, 3, 0.1))
    whole, _ = drive(scene, hmm, PipelineConfig(regions={"wide": RegionConfig(whole_every=1)}), np.arange(0, 3, 0.1))

    assert [region is None for region in detector.asked[:40:2]] == [i % 10 == 0 for i in range(20)]
    areas = [(right - left) * (bottom - top) for left, top, right, bottom in filter(None, detector.asked)]
    assert np.median(areas) < 0.3 * 1280 * 800
    # The light that the map lacks was seen in the first set, of which all is looked at; from then on it is looked for.
    assert {e.map_id for e in told[1]} == {"a", "b", None}
    assert len(told[-1]) == len(whole[-1]) == 3
    for ours, all_seen in zip(told[-1], whole[-1], strict=True):
        assert (ours.map_id, ours.class_name) == (all_seen.map_id, all_seen.class_name)


def test_who_never_looks_at_all_of_it_knows_the_map_alone(make_scene: Callable, hmm) -> None:
    scene = make_scene(LIGHTS, off_map=frozenset({"new"}), cameras=("narrow",))

    told, _ = drive(scene, hmm, PipelineConfig(regions={"narrow": RegionConfig(whole_every=0)}), np.arange(0, 1, 0.1))

    assert {e.map_id for e in told[-1]} == {"a", "b"}


def test_known_lights_outside_of_a_fixed_band_are_no_misses(make_scene: Callable, hmm) -> None:
    scene = make_scene(LIGHTS, cameras=("narrow",), speed_mps=0)
    band = RegionConfig(kind="fixed", box=(0, 0.9, 1, 1), whole_every=0)

    told, detector = drive(scene, hmm, PipelineConfig(regions={"narrow": band}), np.arange(0, 1, 0.1))

    assert {e.map_id for e in told[-1]} == {"a", "b", "new"}
    left, top, right, bottom = detector.asked[-1]
    assert (left, right, bottom) == (0, 1280, 800)
    assert 0 < top < 400


def test_without_a_pose_everything_is_looked_at(make_scene: Callable, hmm) -> None:
    scene = make_scene(LIGHTS, cameras=("narrow",))
    config = PipelineConfig(regions={"narrow": RegionConfig(whole_every=0)})

    _, detector = drive(scene, hmm, config, [70.0])

    assert detector.asked == [None]


def test_regions_are_settings_of_known_cameras(make_scene: Callable, hmm) -> None:
    scene = make_scene(LIGHTS)
    config = parse_config({}, PipelineConfig, ["regions.rear.kind=map"], source="test")
    assert config.regions == {"rear": RegionConfig()}

    with pytest.raises(UsageError, match="regions: unknown camera 'rear'; calibrated are: narrow"):
        drive(scene, hmm, config, [0.0])
