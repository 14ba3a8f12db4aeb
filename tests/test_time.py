"""Time as it is on the road: what the table in docs/time.md promises."""

from collections.abc import Callable

import numpy as np
import pytest

from autolights.core import LightEstimate, Pose, PoseBuffer, SignalSet
from autolights.core.frames import CameraFrame
from autolights.pipeline import LATE, NO_POSE, LightPipeline, PipelineConfig

LIGHTS = {
    "a": ("3", (40.0, 2.0, 5.0), lambda t: "3-red"),
    "b": ("3", (40.0, -2.0, 5.0), lambda t: "3-green"),
}
NOTHING = np.zeros((1, 1, 3), np.uint8)


def live(make_scene: Callable, **settings: object) -> tuple:
    """A scene, and a pipeline that gets its poses one by one."""
    scene = make_scene(LIGHTS, **settings)
    return scene, LightPipeline(scene, scene.pipeline()._hmm, scene.signals, scene.rig, scene.map)


def feed(pipeline: LightPipeline, scene: object, times_s: np.ndarray, *, clock_s: float = 0.0) -> None:
    for t in times_s.tolist():
        pose = scene.pose(t)
        pipeline.update_pose(Pose(round((t + clock_s) * 1e9), pose.position, pose.quaternion_xyzw))


def see(
    pipeline: LightPipeline, scene: object, t: float, cameras: tuple[str, ...] = ("narrow",), *, clock_s: float = 0.0
) -> list[LightEstimate]:
    frames = [CameraFrame(name, round((t + clock_s) * 1e9), NOTHING) for name in cameras]
    return pipeline.step_detections(frames, [scene.detect(name, t) for name in cameras])


@pytest.mark.parametrize("told", [False, True])
def test_what_a_mask_hides_is_not_missed(make_scene: Callable, told: bool) -> None:
    """After a second of red a lorry hides the right half of the image, and with it light b, for three seconds."""
    scene, pipeline = live(make_scene, speed_mps=0)
    feed(pipeline, scene, np.arange(0, 5, 0.02))
    lorry = np.zeros((80, 128), dtype=bool)
    lorry[:, 64:] = True
    for t in np.arange(0, 5, 0.1).round(3).tolist():
        hidden = 1 <= t < 4
        found = scene.detect("narrow", t)
        frame = CameraFrame("narrow", round(t * 1e9), NOTHING, lorry if told and hidden else None)
        seen = found[:1] if hidden else found
        pipeline.step_detections([frame], [seen])
        tracks = {track["map_id"]: track for track in pipeline.explain()["tracks"]}
        if t == 3.9:
            assert (tracks["b"]["misses"], tracks["b"]["alive"]) == ((0, True) if told else (30, False))
            assert "withheld: not seen for" in tracks["b"]["rule"]
            assert tracks["a"]["misses"] == 0
    assert tracks["b"]["alive"]


@pytest.mark.parametrize("late_s", [0.0, 0.06, -0.06])
def test_stamps_that_are_off_are_told(make_scene: Callable, late_s: float) -> None:
    """By a turn: straight on a delay looks like an error of all places."""
    scene, pipeline = live(make_scene, noise_px=0.3)

    def turning(t: float) -> Pose:
        half = 0.06 * np.sin(1.5 * t)
        position = scene.truth.positions[0] + np.array([5 * t - 40, -2, -4.5])
        return Pose(round(t * 1e9), position, np.array([0.0, 0.0, np.sin(half), np.cos(half)]))

    scene.pose = turning
    feed(pipeline, scene, np.arange(0, 5, 0.02))
    for t in np.arange(0.1, 4, 0.1).round(3).tolist():
        see(pipeline, scene, t, clock_s=-late_s)
    health = pipeline.health()["narrow"]
    assert health.delay_s == pytest.approx(late_s, abs=3 * health.delay_sigma_s)
    assert health.delay_sigma_s < 0.01
    assert health.delay_alarm == (late_s != 0)


def test_cameras_out_of_step_tell_as_much_as_cameras_in_step(make_scene: Callable) -> None:
    scene, apart = live(make_scene, cameras=("narrow", "wide"))
    together = scene.pipeline()
    feed(apart, scene, np.arange(0, 2, 0.02))
    for t in np.arange(0, 1, 0.1).round(3).tolist():
        see(apart, scene, t, ("narrow",))
        one = see(apart, scene, t + 0.05, ("wide",))
        other = see(together, scene, t + 0.05, ("narrow", "wide"))
    assert [(e.map_id, e.class_name, e.withheld) for e in one] == [(e.map_id, e.class_name, e.withheld) for e in other]
    for mine, theirs in zip(one, other, strict=True):
        assert mine.probability == pytest.approx(theirs.probability, abs=0.02)
        np.testing.assert_allclose(mine.position, theirs.position, atol=0.05)


def test_a_late_set_is_left_out_and_does_no_harm(make_scene: Callable) -> None:
    scene, pipeline = live(make_scene, cameras=("narrow", "wide"))
    feed(pipeline, scene, np.arange(0, 2, 0.02))
    for t in (0.0, 0.1, 0.2):
        see(pipeline, scene, t)
    assert see(pipeline, scene, 0.1, ("wide",)) == []
    assert pipeline.skipped == {LATE: 1}
    assert LATE in pipeline.last_skip
    assert len(see(pipeline, scene, 0.3)) == 2


def test_a_frame_that_is_late_within_its_set_is_used(make_scene: Callable) -> None:
    scene, pipeline = live(make_scene, cameras=("narrow", "wide"))
    feed(pipeline, scene, np.arange(0, 2, 0.02))
    see(pipeline, scene, 0.0)
    see(pipeline, scene, 0.1)
    frames = [CameraFrame("wide", 80_000_000, NOTHING), CameraFrame("narrow", 200_000_000, NOTHING)]
    told = pipeline.step_detections(frames, [scene.detect("wide", 0.08), scene.detect("narrow", 0.2)])
    assert {view.camera for estimate in told for view in estimate.views} == {"wide", "narrow"}
    assert not pipeline.skipped


def test_when_a_camera_stops_the_other_carries_on(make_scene: Callable) -> None:
    scene, pipeline = live(make_scene, cameras=("narrow", "wide"), speed_mps=1.0)
    feed(pipeline, scene, np.arange(0, 4.9, 0.02))
    for t in np.arange(0, 1, 0.1).round(3).tolist():
        see(pipeline, scene, t, ("narrow", "wide"))
    for t in np.arange(1, 4.8, 0.1).round(3).tolist():
        told = see(pipeline, scene, t, ("wide",))
        assert [(e.map_id, e.withheld) for e in told] == [("a", False), ("b", False)]


def test_a_gap_in_the_poses_costs_its_frames_only(make_scene: Callable) -> None:
    scene, pipeline = live(make_scene)
    feed(pipeline, scene, np.concatenate([np.arange(0, 0.5, 0.02), np.arange(1.0, 2, 0.02)]))
    told = {t: see(pipeline, scene, t) for t in np.arange(0, 1.6, 0.1).round(3).tolist()}
    assert pipeline.skipped == {NO_POSE: 5}
    assert [t for t, lights in told.items() if not lights] == [0.0, 0.5, 0.6, 0.7, 0.8, 0.9]
    assert "apart" in pipeline.last_skip


def test_a_pose_that_comes_late_serves_the_frames_that_wait_for_it(make_scene: Callable) -> None:
    scene, pipeline = live(make_scene)
    feed(pipeline, scene, np.array([0.0, 0.02]))
    assert see(pipeline, scene, 0.2) == []
    feed(pipeline, scene, np.array([0.3, 0.16, 0.22]))
    see(pipeline, scene, 0.2)
    assert len(see(pipeline, scene, 0.22)) == 2
    assert pipeline.skipped == {NO_POSE: 1}


@pytest.mark.parametrize("jump_s", [-3600.0, -8.0])
def test_a_clock_that_is_set_back_starts_all_tracks_anew(make_scene: Callable, jump_s: float) -> None:
    scene, pipeline = live(make_scene, speed_mps=1.0)
    feed(pipeline, scene, np.arange(0, 2, 0.02), clock_s=4000)
    for t in np.arange(0, 1, 0.1).round(3).tolist():
        before = see(pipeline, scene, t, clock_s=4000)
    feed(pipeline, scene, np.arange(2.0, 4, 0.02), clock_s=4000 + jump_s)
    told = [see(pipeline, scene, t, clock_s=4000 + jump_s) for t in (2.1, 2.2, 2.3)]
    assert pipeline.clock_jumps == 1
    assert not pipeline.skipped
    assert [len(lights) for lights in told] == [0, 2, 2], "born again after two sets"
    assert max(e.track_id for e in before) < min(e.track_id for e in told[-1]), "ids are never used twice"
    assert {e.map_id: e.class_name for e in told[-1]} == {"a": "3-red", "b": "3-green"}


def test_a_clock_that_jumps_ahead_leaves_no_old_state(make_scene: Callable) -> None:
    scene, pipeline = live(make_scene, speed_mps=1.0)
    feed(pipeline, scene, np.arange(0, 2, 0.02))
    for t in np.arange(0, 1, 0.1).round(3).tolist():
        see(pipeline, scene, t)
    feed(pipeline, scene, np.arange(2.0, 4, 0.02), clock_s=3600)
    frames = [CameraFrame("narrow", 3_602_100_000_000, NOTHING)]
    nothing = scene.detect("narrow", 2.1)[:0]
    assert [e for e in pipeline.step_detections(frames, [nothing]) if not e.withheld] == []
    see(pipeline, scene, 2.2, clock_s=3600)
    told = see(pipeline, scene, 2.3, clock_s=3600)
    assert {e.map_id: e.class_name for e in told if not e.withheld} == {"a": "3-red", "b": "3-green"}


def test_a_pose_buffer_begins_anew_when_the_clock_was_set_back(signals: SignalSet) -> None:
    buffer = PoseBuffer(history_s=5.0)
    for stamp_s in (100.0, 100.1, 95.2, 50.0, 50.1):
        buffer.add(Pose(round(stamp_s * 1e9), np.zeros(3), np.array([0.0, 0, 0, 1])))
    assert len(buffer) == 2
    assert buffer.at(50_050_000_000).stamp_ns == 50_050_000_000


def test_lights_behind_and_above_are_neither_hit_nor_miss(make_scene: Callable) -> None:
    """Past the stop line the light leaves the image above: its state is kept for `max_coast_s`, then no more."""
    scene, pipeline = live(make_scene, speed_mps=10.0)
    config = PipelineConfig()
    reported: dict[float, list[LightEstimate]] = {}
    last_seen_s = 0.0
    for t in np.arange(0, 7, 0.1).round(3).tolist():
        feed(pipeline, scene, t + np.arange(0, 0.1, 0.02))
        if len(scene.detect("narrow", t)):
            last_seen_s = t
        reported[t] = see(pipeline, scene, t)
    assert 1.0 < last_seen_s < 4.0
    fresh = [t for t, lights in reported.items() if any(not e.withheld for e in lights)]
    assert last_seen_s <= max(fresh) <= last_seen_s + config.track.max_coast_s + 0.15
    assert reported[6.9] == []
    unseen = [view for t, lights in reported.items() if t > last_seen_s for e in lights for view in e.views]
    assert unseen == []
