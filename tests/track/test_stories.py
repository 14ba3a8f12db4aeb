"""Scenes read as stories: what the runtime says while lights appear, hide, flash, and are misread."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from autolights.core import LightEstimate, load_config
from autolights.pipeline import PipelineConfig

AHEAD = (55.0, 2.0, 5.0)
ORIGIN = np.array([500_000.0, 4_800_000.0, 200.0])
RATE_HZ = 10.0

Reports = list[list[LightEstimate]]


@pytest.fixture(params=["default", "paper"])
def config(request: pytest.FixtureRequest) -> PipelineConfig:
    return load_config(f"runtime/{request.param}", PipelineConfig)


def times(seconds: float, rate_hz: float = RATE_HZ) -> np.ndarray:
    return np.arange(round(seconds * rate_hz)) / rate_hz


def of(reports: Reports, map_id: str | None) -> list[LightEstimate | None]:
    return [next((e for e in estimates if e.map_id == map_id), None) for estimates in reports]


def said(reports: Reports, map_id: str | None) -> list[str | None]:
    """What one may act upon."""
    return [None if e is None or e.withheld else e.class_name for e in of(reports, map_id)]


def always(name: str) -> Callable[[float], str]:
    return lambda t: name


def between(start: float, end: float, inside: object, outside: object) -> Callable[[float], object]:
    return lambda t: inside if start - 1e-6 <= t < end - 1e-6 else outside


def flashing(t: float) -> str:
    return "4-yleft2" if t % 1.1 < 0.62 else "4-off"


def test_two_hits_are_a_birth(make_scene: Callable, config: PipelineConfig) -> None:
    reports = make_scene({"a": ("3", AHEAD, always("3-red"))}).drive(times(0.4), config)
    assert said(reports, "a") == [None, "3-red", "3-red", "3-red"]
    assert len({e.track_id for estimates in reports for e in estimates}) == 1


def test_a_hit_and_a_miss_are_no_birth(make_scene: Callable, config: PipelineConfig) -> None:
    blinking = {"a": ("3", AHEAD, lambda t: "3-red" if round(t * 10) % 2 == 0 else None)}
    reports = make_scene(blinking, off_map=frozenset({"a"})).drive(times(1.0), config)
    assert not any(reports)


def test_sixteen_misses_are_silence(make_scene: Callable) -> None:
    scene = make_scene({"a": ("3", AHEAD, between(0, 0.5, "3-red", None))}, speed_mps=0)
    reports = scene.drive(times(2.5), load_config("runtime/paper", PipelineConfig))
    assert said(reports, "a")[1:20] == ["3-red"] * 19, "five sets seen, fifteen missed"
    assert said(reports, "a")[20:] == [None] * 5
    assert all(e is not None and e.withheld for e in of(reports, "a")[20:])


def test_two_seconds_are_silence_at_any_frame_rate(make_scene: Callable) -> None:
    for rate_hz in (5.0, 10.0, 30.0):
        scene = make_scene({"a": ("3", AHEAD, between(0, 1.0, "3-red", None))}, speed_mps=0)
        reports = scene.drive(times(4.0, rate_hz))
        last = max(i for i, name in enumerate(said(reports, "a")) if name is not None) / rate_hz
        assert last == pytest.approx(1.0 - 1 / rate_hz + 2.0, abs=1e-6)


def test_an_occlusion_of_a_second_keeps_the_state(make_scene: Callable, config: PipelineConfig) -> None:
    reports = make_scene({"a": ("3", AHEAD, between(1, 2, None, "3-red"))}).drive(times(3.0), config)
    assert said(reports, "a")[1:] == ["3-red"] * 29
    hidden = of(reports, "a")[15]
    assert hidden is not None
    assert [view.box_xyxy for view in hidden.views] == [None], "expected, but not detected"
    assert hidden.last_seen_ns == 900_000_000


def test_a_light_that_died_is_born_again_under_its_id(make_scene: Callable) -> None:
    script = between(0.5, 4.5, None, "3-red")
    reports = make_scene({"a": ("3", AHEAD, script)}, speed_mps=0, off_map=frozenset({"a"})).drive(times(6.0))
    names = said(reports, None)
    assert names[2] == "3-red"
    assert names[40] is None
    assert names[45:48] == [None, "3-red", "3-red"], "its state was forgotten, its place was not"
    assert len({e.track_id for estimates in reports for e in estimates}) == 1


def test_a_flashing_arrow_is_one_flash_from_birth_on(make_scene: Callable, config: PipelineConfig) -> None:
    for phase in (0.0, 0.7):
        scene = make_scene({"a": ("4", AHEAD, lambda t, phase=phase: flashing(t + phase))})
        reports = scene.drive(times(5.0), config)
        assert said(reports, "a")[1:] == ["4-yleft2"] * 49
        assert all(e is not None and e.flashing for e in of(reports, "a")[1:])


def test_a_flash_is_known_at_its_first_dark_phase(make_scene: Callable, config: PipelineConfig) -> None:
    script = {"a": ("4", AHEAD, lambda t: "4-rleft" if t < 1.95 else flashing(t - 2.0 + 0.55))}
    reports = make_scene(script).drive(times(4.0), config)
    names = said(reports, "a")
    assert "4-off" not in names
    assert names[19] == "4-rleft"
    assert names[26] == "4-yleft2", "0.6 s after the onset"


def test_a_head_that_stays_dark_is_off_and_does_not_flash(make_scene: Callable) -> None:
    script = {"a": ("4", AHEAD, lambda t: flashing(t) if t < 3 else "4-off")}
    reports = make_scene(script, speed_mps=1).drive(times(7.0))
    last = of(reports, "a")[-1]
    assert last is not None
    assert (last.class_name, last.flashing) == ("4-off", False)


def test_flash_then_steady_yellow_then_red(make_scene: Callable) -> None:
    def script(t: float) -> str:
        return flashing(t) if t < 3 else "4-yleft1" if t < 6 else "4-rleft"

    reports = make_scene({"a": ("4", AHEAD, script)}, speed_mps=1).drive(times(8.0))
    changes = [b for a, b in pairwise([None, *said(reports, "a")]) if a != b]
    assert changes == ["4-yleft2", "4-yleft1", "4-rleft"]


def test_one_wrong_frame_does_not_flip_the_state(make_scene: Callable, config: PipelineConfig) -> None:
    script = between(1.0, 1.1, "3-yellow", "3-red")
    reports = make_scene({"a": ("3", AHEAD, script)}).drive(times(2.0), config)
    assert said(reports, "a")[1:] == ["3-red"] * 19


def test_a_wash_out_of_half_a_second_is_ridden_out(make_scene: Callable) -> None:
    # Red over-exposed to amber: yellow cannot follow red, and five frames of one glare are not five opinions.
    amber = {"3-yellow": 0.6, "3-red": 0.3}
    scene = make_scene({"a": ("3", AHEAD, between(2.0, 2.5, amber, "3-red"))}, cameras=("narrow", "wide"))
    assert said(scene.drive(times(4.0)), "a")[1:] == ["3-red"] * 39


def test_a_change_is_believed_within_three_frames(make_scene: Callable, config: PipelineConfig) -> None:
    scene = make_scene({"a": ("3", AHEAD, lambda t: "3-green" if t < 1.95 else "3-yellow")})
    names = said(scene.drive(times(3.0), config), "a")
    assert names[19] == "3-green"
    assert names[22:] == ["3-yellow"] * 8


def test_neighbours_keep_their_identities(make_scene: Callable, config: PipelineConfig) -> None:
    lights = {
        "a": ("3", (55.0, 2.0, 5.0), always("3-red")),
        "b": ("3", (55.0, 0.5, 5.0), between(1.0, 2.0, None, "3-green")),
    }
    reports = make_scene(lights, noise_px=1.0).drive(times(4.0), config)
    assert set(said(reports, "a")[1:]) == {"3-red"}
    assert set(said(reports, "b")[1:]) == {"3-green"}
    assert len({e.track_id for estimates in reports for e in estimates}) == 2


def test_a_light_that_the_map_lacks_is_found(make_scene: Callable, config: PipelineConfig) -> None:
    lights = {"a": ("3", AHEAD, always("3-red")), "new": ("5dh", (55.0, -1.0, 5.3), always("5dh-green"))}
    scene = make_scene(lights, off_map=frozenset({"new"}), cameras=("narrow", "wide"), noise_px=1.0)
    reports = scene.drive(times(6.0), config)
    found = [e for e in of(reports, None) if e is not None]
    assert len({e.track_id for e in found}) == 1
    assert {e.type for e in found} == {"5dh"}
    errors_m = [np.linalg.norm(e.position - (ORIGIN + lights["new"][1])) for e in found]
    assert errors_m[-1] < 0.5
    assert errors_m[0] < 6
    sigma = np.sqrt(np.diag(found[-1].covariance))
    assert sigma[0] > sigma[1], "depth is known less well than direction"


def test_a_light_of_the_map_that_does_not_exist_is_never_reported(make_scene: Callable, config: PipelineConfig) -> None:
    scene = make_scene({"a": ("3", AHEAD, always("3-red"))}, phantoms={"ghost": ("3", (55.0, 5.0, 5.0))}, noise_px=1.0)
    reports = scene.drive(times(6.0), config)
    assert {e.map_id for estimates in reports for e in estimates} == {"a"}


def test_a_misread_type_is_no_second_light(make_scene: Callable) -> None:
    reports = make_scene({"a": ("3", AHEAD, between(1.0, 2.0, "4-gleft", "3-red"))}).drive(times(3.0))
    assert {e.map_id for estimates in reports for e in estimates} == {"a"}
    assert said(reports, "a")[1:] == ["3-red"] * 29


def test_the_type_of_an_unknown_light_is_voted(make_scene: Callable) -> None:
    script = between(0.5, 0.7, "4-gleft", "3-green")
    reports = make_scene({"a": ("3", AHEAD, script)}, off_map=frozenset({"a"})).drive(times(2.0))
    assert {(e.type, e.class_name) for estimates in reports for e in estimates} == {("3", "3-green")}

    script = between(0.0, 0.15, "4-gleft", "3-green")
    reports = make_scene({"a": ("3", (40.0, 2.0, 5.0), script)}, off_map=frozenset({"a"})).drive(times(2.0))
    told = [(e.track_id, e.type, e.class_name) for estimates in reports for e in estimates]
    assert told[0] == (1, "4", "4-gleft")
    assert told[4:] == [(1, "3", "3-green")] * 15, "outvoted, and still the same track"


def test_two_cameras_are_one_track_with_two_views(make_scene: Callable, config: PipelineConfig) -> None:
    scene = make_scene({"a": ("3", (35.0, 2.0, 5.0), always("3-red"))}, cameras=("narrow", "wide"), speed_mps=1)
    reports = scene.drive(times(1.0), config)
    (last,) = reports[-1]
    assert [(view.camera, view.box_xyxy is not None) for view in last.views] == [("narrow", True), ("wide", True)]


def test_one_camera_that_sees_it_is_a_hit(make_scene: Callable, config: PipelineConfig) -> None:
    scene = make_scene({"a": ("3", (30.0, 2.0, 5.0), always("3-red"))}, cameras=("narrow", "wide"), speed_mps=0)
    scene.detect = lambda camera, t, detect=scene.detect: detect(camera, t)[: 1 if camera == "wide" else 0]
    assert said(scene.drive(times(4.0), config), "a")[1:] == ["3-red"] * 39


def test_a_light_that_no_camera_covers_is_not_missed(make_scene: Callable) -> None:
    # After 0.3 s all sets come from a camera that does not reach the light: seventeen are more than N_death.
    scene = make_scene({"a": ("3", (62.0, 2.0, 5.0), always("3-red"))}, cameras=("narrow", "wide"), speed_mps=0)
    scene.detect = lambda camera, t, detect=scene.detect: detect(camera, t)[: 1 if camera == "narrow" else 0]
    pipeline = scene.pipeline(load_config("runtime/paper", PipelineConfig))
    reports = [scene.step(pipeline, t, ["narrow" if t < 0.25 else "wide"]) for t in times(2.5)]
    assert said(reports, "a")[1:20] == ["3-red"] * 19
    assert not any(reports[23:]), "out of sight for more than two seconds"


def test_camera_order_does_not_matter(make_scene: Callable, config: PipelineConfig) -> None:
    lights = {
        "a": ("3", (40.0, 2.0, 5.0), always("3-red")),
        "new": ("5dh", (40.0, -2.0, 5.0), always("5dh-green")),
    }
    told = []
    for cameras in (("narrow", "wide"), ("wide", "narrow")):
        scene = make_scene(lights, cameras=("narrow", "wide"), off_map=frozenset({"new"}))
        told.append([[e.to_json() for e in estimates] for estimates in scene.drive(times(2.0), config, cameras)])
    assert told[0] == told[1]


def test_dropped_frames_change_nothing_but_the_frames(make_scene: Callable) -> None:
    rng = np.random.default_rng(5)
    kept = times(6.0, 30.0)[rng.random(180) > 0.4]

    def script(t: float) -> str:
        return "3-green" if t < 2 else "3-yellow" if t < 4 else "3-red"

    scene = make_scene({"a": ("3", AHEAD, script)}, speed_mps=2)
    reports = scene.drive(kept)
    late = [t for t, name in zip(kept, said(reports, "a"), strict=True) if name != script(t)]
    assert len([t for t in late if not (t < 0.15 or 2 <= t < 2.3 or 4 <= t < 4.3)]) == 0


def test_sets_come_in_the_order_of_time(make_scene: Callable) -> None:
    scene = make_scene({"a": ("3", AHEAD, always("3-red"))})
    pipeline = scene.pipeline()
    scene.step(pipeline, 1.0)
    assert scene.step(pipeline, 0.9) == []
    assert pipeline.skipped == {"earlier than the set before": 1}
