import pytest

from autolights.core import SignalSet
from autolights.evaluate.timelines import (
    flash_onset_delays,
    flicker_count,
    timelines,
    transition_delays,
    unsafe_frames,
)


def test_a_light_that_was_out_of_view_starts_anew_and_cameras_are_kept_apart(rows) -> None:
    outcomes = rows("R:R R:R") + rows("R:R", start_s=1.1) + rows("R:R", start_s=2.5) + rows("R:R", camera="wide")
    assert sorted(len(stretch) for stretch in timelines(outcomes)) == [1, 1, 3]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        pytest.param("R:R G:G", [(0.0, 0)], id="at-once"),
        pytest.param("R:R G:R G:R G:G", [(0.2, 2)], id="two-frames-late"),
        pytest.param("R:R G:- G:~G G:G", [(0.2, 2)], id="misses-and-withheld-reports-do-not-count"),
        pytest.param("G:G Y:G R:R", [(None, None), (0.0, 0)], id="over-before-it-was-reported"),
        pytest.param("R:R G?:R G:G", [], id="changed-while-hidden"),
        pytest.param("R:R R:G R:R", [], id="nothing-changed"),
        pytest.param("rl:rl fl*:fl fl*:fl", [], id="a-flash-is-counted-apart"),
    ],
)
def test_transition_delays(rows, words: str, expected: list[tuple[float | None, int | None]]) -> None:
    got = [(delay.seconds, delay.frames) for delay in transition_delays(rows(words))]
    assert got == [(pytest.approx(seconds) if seconds is not None else None, n) for seconds, n in expected]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        pytest.param("rl:rl fl*:fl fl*:off fl*:fl*", [2], id="class-and-flashing-must-be-said"),
        pytest.param("rl:rl fl*:off* fl*:fl*", [1], id="the-class-must-be-right"),
        pytest.param("rl:rl fl*:fl yl:yl", [None], id="never"),
        pytest.param("fl*:fl*", [], id="flashing-when-it-came-into-view"),
    ],
)
def test_flash_onset(rows, words: str, expected: list[int | None]) -> None:
    assert [delay.frames for delay in flash_onset_delays(rows(words))] == expected


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        pytest.param("R:R R:R G:G", 0, id="as-the-truth"),
        pytest.param("R:R R:G R:R", 2, id="there-and-back"),
        pytest.param("R:R G:R G:G", 0, id="late-is-not-flicker"),
        pytest.param("R:R G:Y G:G", 1, id="over-a-wrong-state"),
        pytest.param("R:Y R:R", 1, id="a-wrong-start-is-mended"),
        pytest.param("R:R R:- R:R", 0, id="a-gap-is-a-miss"),
        pytest.param("R:R R:- G:G", 0, id="a-change-in-a-gap"),
        pytest.param("fl*:fl fl*:off fl*:fl", 2, id="a-flash-taken-for-changes"),
        pytest.param("R:- G:- G:G G:R G:G", 2, id="changes-before-the-first-report-excuse-nothing"),
    ],
)
def test_flicker(rows, words: str, expected: int) -> None:
    assert flicker_count(rows(words)) == expected


@pytest.mark.parametrize(
    ("words", "unsafe", "possible"),
    [
        pytest.param("R:R R:R R:R R:R R:R", 0, 2, id="right"),
        pytest.param("R:G R:G R:G R:G R:G", 2, 2, id="go-on-red-from-0.3-s-on"),
        pytest.param("R:- R:Y R:~G R:Y R:-", 0, 2, id="caution-misses-and-withheld-are-not-go"),
        pytest.param("G:G G:G R:G R:G R:G R:G", 1, 1, id="the-time-starts-with-the-red"),
        pytest.param("R?:G R?:G R?:G R?:G R?:G", 0, 0, id="hidden-all-along"),
        pytest.param("R:R R:R R:R R:R R?:G R?:G", 2, 3, id="once-seen-an-occlusion-is-no-excuse"),
        pytest.param("rl:gl rl:gl rl:gl rl:gl", 1, 1, id="an-arrow"),
        pytest.param("dR:dgl dR:dgl dR:dgl dR:dgl", 1, 1, id="a-protected-left-under-a-doghouse's-red-ball"),
        pytest.param("dgl:dgl dgl:dgl dgl:dgl dgl:dgl", 0, 1, id="a-protected-left-that-is-there"),
        pytest.param("fl*:gl fl*:gl fl*:gl fl*:gl fl*:gl", 0, 0, id="a-flashing-arrow-is-no-stop"),
    ],
)
def test_unsafe(rows, signals: SignalSet, words: str, unsafe: int, possible: int) -> None:
    found, of = unsafe_frames(rows(words), signals)
    assert (len(found), of) == (unsafe, possible)
