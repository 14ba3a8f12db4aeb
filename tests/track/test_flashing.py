import numpy as np
import pytest

from autolights.core import FlashingPair
from autolights.track import flash_verdict

PAIR = FlashingPair(on="on", off="off", reported="on")


def samples(seconds: float, rate_hz: float, period_s: float, on_ratio: float, phase_s: float = 0.0) -> tuple:
    stamps_s = np.arange(0, seconds, 1 / rate_hz) + 1.7e9
    lit = ((stamps_s - 1.7e9 + phase_s) % period_s) < on_ratio * period_s
    return stamps_s.tolist(), lit.tolist()


@pytest.mark.parametrize("rate_hz", [10.0, 15.0, 30.0])
@pytest.mark.parametrize("period_s", [1.0, 1.1, 1.2])
@pytest.mark.parametrize("on_ratio", [0.52, 0.65])
@pytest.mark.parametrize("phase_s", [0.0, 0.37, 0.8])
def test_legal_flashes_are_seen(rate_hz: float, period_s: float, on_ratio: float, phase_s: float) -> None:
    assert flash_verdict(*samples(4.0, rate_hz, period_s, on_ratio, phase_s), PAIR) == "flashing"


@pytest.mark.parametrize(
    ("seconds", "rate_hz", "period_s", "on_ratio", "verdict"),
    [
        pytest.param(2.0, 30, 1.0, 0.6, "unknown", id="less-than-two-cycles"),
        pytest.param(5.0, 30, 2.0, 0.6, "unknown", id="too-slow"),
        pytest.param(5.0, 30, 0.5, 0.6, "unknown", id="too-fast: flicker of a bad detector"),
        pytest.param(5.0, 30, 1.0, 0.85, "unknown", id="lit-for-too-long"),
        pytest.param(5.0, 30, 1.0, 0.3, "unknown", id="dark-for-too-long"),
        pytest.param(4.0, 7.5, 1.1, 0.6, "unknown", id="too-few-frames: the hidden states decide"),
        pytest.param(3.0, 10, 100.0, 1.0, "steady", id="always-lit"),
        pytest.param(3.0, 10, 100.0, 0.0, "steady", id="always-dark"),
        pytest.param(2.2, 10, 100.0, 1.0, "unknown", id="lit-but-not-for-two-cycles-yet"),
    ],
)
def test_verdicts(seconds: float, rate_hz: float, period_s: float, on_ratio: float, verdict: str) -> None:
    assert flash_verdict(*samples(seconds, rate_hz, period_s, on_ratio), PAIR) == verdict


def test_a_gap_may_have_hidden_the_dark_phase() -> None:
    stamps_s, lit = samples(4.0, 10, 100.0, 1.0)
    keep = [i for i, stamp in enumerate(stamps_s) if (stamp - 1.7e9) % 1.1 < 0.6]
    assert flash_verdict([stamps_s[i] for i in keep], [lit[i] for i in keep], PAIR) == "unknown"


def test_a_flash_that_ended_is_no_flash() -> None:
    stamps_s, lit = samples(4.0, 10, 1.1, 0.55)
    after = [stamps_s[-1] + 0.1 * i for i in range(1, 16)]
    assert flash_verdict([*stamps_s, *after], [*lit, *[True] * 15], PAIR) == "unknown"
    after = [stamps_s[-1] + 0.1 * i for i in range(1, 30)]
    assert flash_verdict([*stamps_s, *after], [*lit, *[True] * 29], PAIR) == "steady"


@pytest.mark.parametrize("count", [0, 1, 2])
def test_hardly_anything_seen(count: int) -> None:
    assert flash_verdict([0.1 * i for i in range(count)], [True] * count, PAIR) == "unknown"
