import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

from autolights.core import CameraFrame, Detections, PoseBuffer, SignalSet, load_config
from autolights.core.errors import ConfigError, MapError, UsageError
from autolights.pipeline import LightPipeline, PipelineConfig

LIGHTS = {
    "a": ("3", (40.0, 2.0, 5.0), lambda t: "3-red"),
    "f": ("4", (40.0, -2.0, 5.0), lambda t: "4-off"),
    "new": ("5dh", (40.0, 5.0, 5.0), lambda t: "5dh-green"),
}
BLACK = np.zeros((800, 1280, 3), np.uint8)


def test_variants_of_the_ablation(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS, off_map=frozenset({"new"}), cameras=("narrow", "wide"), speed_mps=0)
    told = {}
    for variant in ("od", "fusion", "full"):
        told[variant] = scene.drive([0.0, 0.1], PipelineConfig(variant=variant))[1]
    truth = dict(zip(scene.truth.ids, scene.truth.positions, strict=True))

    assert [(e.map_id, e.class_name) for e in told["od"]] == [(None, "3-red"), (None, "4-off"), (None, "5dh-green")] * 2
    np.testing.assert_allclose(told["od"][0].position, truth["a"], atol=0.5)

    assert [(e.map_id, e.class_name) for e in told["fusion"]] == [
        ("a", "3-red"), ("f", "4-off"), (None, "5dh-green"),
    ] * 2  # fmt: skip
    np.testing.assert_array_equal(told["fusion"][0].position, truth["a"])
    for variant in ("od", "fusion"):
        assert all(len(e.views) == 1 and e.views[0].box_xyxy is not None for e in told[variant])
        assert len({e.track_id for e in told[variant]}) == 6

    assert [(e.map_id, e.class_name, e.flashing) for e in told["full"]] == [
        ("a", "3-red", False), ("f", "4-yleft2", True), (None, "5dh-green", False),
    ]  # fmt: skip


@pytest.mark.parametrize(("box", "score"), [((600, 300, 603, 308), 0.9), ((600, 300, 612, 336), 0.3)])
def test_what_can_be_no_new_light_still_has_a_place_without_tracks(
    make_scene: Callable, box: tuple[float, ...], score: float
) -> None:
    """Far beyond the range, and of a score too low: tracking does not even localise them."""
    scene = make_scene(LIGHTS, speed_mps=0)
    probs = np.full((1, 13), 0.001)
    probs[0, scene.signals.class_ids["3-red"]] = score
    found = Detections(np.array([box], dtype=float), np.ones(1), probs)
    frames = [CameraFrame("narrow", 0, BLACK)]
    (alone,) = scene.pipeline(PipelineConfig(variant="fusion")).step_detections(frames, [found])
    assert np.isfinite(alone.position).all()
    assert alone.distance_m > (64 if score > 0.5 else 10)
    full = scene.pipeline()
    assert full.step_detections(frames, [found]) == []
    assert full.explain()["images"][0]["new_lights"] == []


def test_step_detects_at_each_image(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS, cameras=("narrow", "wide"), speed_mps=0)

    class Recorded:
        def batch(self, images_bgr: list[np.ndarray]) -> list[Detections]:
            return [scene.detect("narrow", 0.0), scene.detect("wide", 0.0)][: len(images_bgr)]

    pipeline = scene.pipeline()
    pipeline = LightPipeline(Recorded(), scene.hmm, scene.signals, scene.rig, scene.map)
    for t in np.arange(0, 0.5, 0.02):
        pipeline.update_pose(scene.pose(t))
    for stamp_ns in (0, 100_000_000):
        frames = [CameraFrame("narrow", stamp_ns, BLACK), CameraFrame("wide", stamp_ns + 4_000_000, BLACK)]
        estimates = pipeline.step(frames)
    assert {e.map_id for e in estimates} == {"a", "f", "new"}
    assert {e.stamp_ns for e in estimates} == {104_000_000}


def test_a_frame_without_a_pose_is_left_out_and_counted(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS)
    pipeline = scene.pipeline()
    assert scene.step(pipeline, 1000.0) == []
    assert pipeline.skipped == {"no pose": 1}
    assert "camera 'narrow': no pose at stamp 1000000000000: poses cover 0 to" in pipeline.last_skip
    scene.step(pipeline, 1.0)
    assert len(scene.step(pipeline, 1.1)) == 3, "later frames are served"


def test_no_frames_no_lights(make_scene: Callable) -> None:
    assert make_scene(LIGHTS).pipeline().step([]) == []


def test_an_unknown_camera_is_refused(make_scene: Callable) -> None:
    with pytest.raises(UsageError, match="unknown camera 'rear'; calibrated are: narrow"):
        make_scene(LIGHTS).pipeline().step([CameraFrame("rear", 0, BLACK)])


def test_a_detector_of_other_classes_is_refused(make_scene: Callable) -> None:
    pipeline = make_scene(LIGHTS).pipeline()
    with pytest.raises(UsageError, match="knows 80 classes, the signal description 'autolights_13' 13"):
        pipeline.step_detections([CameraFrame("narrow", 0, BLACK)], [Detections.empty(80)])


@pytest.mark.parametrize("variant", ["od", "fusion", "full"])
@pytest.mark.parametrize("box", [(0, 0, 0, 0), (600, 300, 600, 340), (620, 340, 600, 300)])
def test_boxes_without_area_change_nothing(make_scene: Callable, variant: str, box: tuple[float, ...]) -> None:
    scene = make_scene(LIGHTS, off_map=frozenset({"new"}), speed_mps=0)
    plain, odd = (scene.pipeline(PipelineConfig(variant=variant)) for _ in range(2))
    for stamp_ns in (0, 100_000_000):
        found = scene.detect("narrow", 0.0)
        more = Detections(
            np.vstack([box, found.boxes_xyxy]),
            np.append(1.0, found.objectness),
            np.vstack([found.class_probs[0], found.class_probs]),
        )
        frames = [CameraFrame("narrow", stamp_ns, BLACK)]
        wanted, told = plain.step_detections(frames, [found]), odd.step_detections(frames, [more])
    assert [e.to_json() for e in told] == [e.to_json() for e in wanted]
    assert len(told) == 3


def test_a_map_light_of_unknown_type_is_named(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS)
    object.__setattr__(scene.map, "types", ("3", "tram", "5dh"))
    with pytest.raises(MapError, match="light 'f': unknown type 'tram'"):
        scene.pipeline()


def test_inputs_stay_as_they_were(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS, cameras=("narrow", "wide"), off_map=frozenset({"new"}))
    pipeline = scene.pipeline()
    for t in (0.0, 0.1, 0.2):
        detections = [scene.detect(name, t) for name in scene.rig]
        before = [(d.boxes_xyxy.copy(), d.objectness.copy(), d.class_probs.copy()) for d in detections]
        pipeline.step_detections([CameraFrame(name, round(t * 1e9), BLACK) for name in scene.rig], detections)
        for found, copies in zip(detections, before, strict=True):
            for array, copy in zip((found.boxes_xyxy, found.objectness, found.class_probs), copies, strict=True):
                np.testing.assert_array_equal(array, copy)


def test_explanation_names_lights_costs_and_beliefs(make_scene: Callable) -> None:
    scene = make_scene(LIGHTS, off_map=frozenset({"new"}))
    pipeline = scene.pipeline()
    scene.step(pipeline, 0.0)
    scene.step(pipeline, 0.1)
    told = pipeline.explain()
    (image,) = told["images"]
    assert image["known_lights"] == ["a", "f", "track 3"]
    assert image["matches"] == [[0, 0], [1, 1], [2, 2]]
    assert image["cost_px"][0] == [pytest.approx(0, abs=1), None, None]
    assert [sum(track["belief"].values()) for track in told["tracks"]] == pytest.approx([1, 1, 1], abs=1e-3)


@pytest.mark.parametrize("name", ["default", "paper"])
def test_shipped_settings_load(name: str) -> None:
    config = load_config(f"runtime/{name}", PipelineConfig)
    assert config.track.mode == ("timed" if name == "default" else "paper")
    assert (config.track.birth_hits, config.track.death_sets) == (2, 15)


def test_the_default_file_says_what_the_code_defaults_to() -> None:
    assert load_config("runtime/default", PipelineConfig) == PipelineConfig()


def test_a_wrong_setting_is_explained() -> None:
    with pytest.raises(ConfigError, match="unknown key 'birth_hit' in track; did you mean 'birth_hits'"):
        load_config("runtime/default", PipelineConfig, ["track.birth_hit=3"])


def test_runs_where_the_training_stack_is_absent() -> None:
    code = """
import sys
for name in ("torch", "torchvision", "albumentations", "onnx", "matplotlib"):
    sys.modules[name] = None
import numpy as np
from autolights.core import CameraFrame, CameraModel, Detections, Pose, TrafficLightMap, load_signals
from autolights.core.transforms import CAMERA_AXES_FROM_VEHICLE_AXES, rigid
from autolights.core.hmm import HmmParameters
from autolights.pipeline import LightPipeline
import autolights.run_drive

signals = load_signals()
hmm = {}
for name in signals.types:
    states, eye = signals.states_of(name), np.eye(len(signals.states_of(name)))
    hmm[name] = HmmParameters(name, states, eye[0], signals.rates(name), 0.1, eye, eye, eye, eye[0], eye, {})
camera = CameraModel("front", (1280, 800), np.array([[1000.0, 0, 640], [0, 1000, 400], [0, 0, 1]]), np.empty(0),
                     rigid(CAMERA_AXES_FROM_VEHICLE_AXES, np.zeros(3)), 64.0)
lights = TrafficLightMap(("a",), ("3",), np.array([[40.0, 0, 3]]), np.array([270.0]), signals.sizes_m(["3"]))

class Seen:
    def batch(self, images):
        return [Detections(np.array([[636.0, 312, 645, 338]]), np.ones(1), np.eye(13)[[1]]) for _ in images]

pipeline = LightPipeline(Seen(), hmm, signals, {"front": camera}, lights)
for i in range(3):
    pipeline.update_pose(Pose(i * 100_000_000, np.zeros(3), np.array([0, 0, 0, 1.0])))
    told = pipeline.step([CameraFrame("front", i * 100_000_000, np.zeros((800, 1280, 3), np.uint8))])
print([(e.map_id, e.class_name) for e in told])
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[('a', '3-red')]"


def test_poses_may_come_late(make_scene: Callable, signals: SignalSet) -> None:
    scene = make_scene(LIGHTS)
    empty = PoseBuffer()
    pipeline = LightPipeline(scene, scene.hmm, signals, scene.rig, scene.map, poses=empty)
    assert scene.step(pipeline, 0.05) == []
    for t in (0.1, 0.0):
        pipeline.update_pose(scene.pose(t))
    scene.step(pipeline, 0.05)
    assert len(scene.step(pipeline, 0.1)) == 3
