from itertools import groupby

import numpy as np
import pytest

from autolights.core import FloatArray, SignalSet, load_signals
from autolights.core.errors import UsageError
from autolights.sim.detector_model import (
    DetectorModel,
    DetectorModelConfig,
    LightViews,
    ModelledFrame,
    confusion_rates,
    expected_confusion,
    perturb_errors,
    scale_errors,
    split_chance,
)

SIZE_WH = (1280, 800)
RED, YELLOW, GREEN = "3-red", "3-yellow", "3-green"
DURATION_S = 120.0
COUNT = 40


@pytest.fixture(scope="module")
def signals() -> SignalSet:
    return load_signals()


@pytest.fixture(scope="module")
def rates(signals: SignalSet) -> FloatArray:
    return confusion_rates({RED: {YELLOW: 0.07, GREEN: 0.03}}, signals)


QUIET = DetectorModelConfig(
    miss_rate=0, small_height_px=0, false_alarms_per_s=0, edge_sigma_px=0, edge_sigma_share=0, min_score=0
)


def views(
    signals: SignalSet,
    *,
    rate_hz: float = 10.0,
    shown: str = RED,
    height_px: float = 40.0,
    hidden: float = 0.0,
    count: int = COUNT,
    is_light: bool = True,
    offset_s: float = 0.0,
) -> LightViews:
    times_s = np.arange(0, DURATION_S, 1 / rate_hz) + offset_s
    left = np.linspace(50, 1150, count)
    boxes = np.stack([left, np.full(count, 300.0), left + 0.34 * height_px, np.full(count, 300 + height_px)], axis=1)
    return LightViews(
        times_s=times_s,
        size_wh=SIZE_WH,
        boxes_xyxy=np.broadcast_to(boxes, (len(times_s), count, 4)),
        class_ids=np.full((len(times_s), count), signals.class_ids[shown]),
        hidden=np.full((len(times_s), count), hidden),
        is_light=np.full(count, is_light),
    )


def model(
    signals: SignalSet, rates: FloatArray, config: DetectorModelConfig = QUIET, **changes: float
) -> DetectorModel:
    config = config.model_copy(update=changes)
    return DetectorModel(signals, rates, config, count=COUNT, duration_s=DURATION_S + 1, seed=(7,))


def seen_as(frames: list[ModelledFrame], count: int = COUNT) -> np.ndarray:
    """(t, n) class seen; -1 for a miss."""
    seen = np.full((len(frames), count), -1)
    for t, frame in enumerate(frames):
        own = frame.sources >= 0
        seen[t, frame.sources[own]] = frame.detections.class_ids[own]
    return seen


def run_lengths(flags: np.ndarray) -> np.ndarray:
    """Lengths of the runs of True down the columns, those at the ends left out."""
    lengths = []
    for column in flags.T:
        runs = [(value, sum(1 for _ in group)) for value, group in groupby(column.tolist())]
        lengths += [length for value, length in runs[1:-1] if value]
    return np.array(lengths)


def test_classes_are_mistaken_at_their_rates(signals: SignalSet, rates: FloatArray) -> None:
    seen = seen_as(model(signals, rates).detect(views(signals), camera=0))
    # 120 s x 40 lights hold some 12,000 independent draws: a standard deviation of 0.2 points.
    assert np.mean(seen == signals.class_ids[YELLOW]) == pytest.approx(0.07, abs=0.01)
    assert np.mean(seen == signals.class_ids[GREEN]) == pytest.approx(0.03, abs=0.006)
    assert np.mean(seen == signals.class_ids[RED]) == pytest.approx(0.90, abs=0.012)


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 30.0])
def test_an_error_lasts_as_long_at_any_frame_rate(signals: SignalSet, rates: FloatArray, rate_hz: float) -> None:
    seen = seen_as(model(signals, rates, persistence_s=0.4).detect(views(signals, rate_hz=rate_hz), camera=0))
    lengths = run_lengths(seen != signals.class_ids[RED])
    # Of runs with an exponential length of mean m, sampled every dt, those that are hit last dt / (1 − exp(−dt / m)).
    dt_s = 1 / rate_hz
    expected_s = dt_s / (1 - np.exp(-dt_s / 0.4))
    assert len(lengths) > 300
    assert lengths.mean() * dt_s == pytest.approx(expected_s, rel=0.12)


def test_the_same_errors_whatever_the_frame_rate(signals: SignalSet, rates: FloatArray) -> None:
    slow = seen_as(model(signals, rates).detect(views(signals, rate_hz=10), camera=0))
    fast = seen_as(model(signals, rates).detect(views(signals, rate_hz=20), camera=0))
    assert np.array_equal(slow, fast[::2])


@pytest.mark.parametrize("correlation", [0.0, 0.5, 1.0])
def test_errors_of_two_cameras_correlate_as_asked(signals: SignalSet, rates: FloatArray, correlation: float) -> None:
    detector = model(signals, rates, camera_correlation=correlation)
    wrong = [
        (seen_as(detector.detect(views(signals, offset_s=0.004 * c), camera=c)) != signals.class_ids[RED]).ravel()
        for c in (0, 1)
    ]
    assert np.corrcoef(*wrong)[0, 1] == pytest.approx(correlation, abs=0.04)
    assert np.mean(wrong[0]) == pytest.approx(0.1, abs=0.012)


def test_split_chances_make_the_asked_chance_and_correlation() -> None:
    chance, correlation = np.array([0.0, 0.02, 0.3, 0.9, 1.0]), 0.4
    shared, own = split_chance(chance, correlation)
    assert 1 - (1 - shared) * (1 - own) == pytest.approx(chance)
    both = shared + (1 - shared) * own**2
    assert both - chance**2 == pytest.approx(correlation * chance * (1 - chance))


@pytest.mark.parametrize(
    ("height_px", "hidden", "missed"),
    [
        pytest.param(400, 0.0, 0.02, id="large"),
        pytest.param(16, 0.0, 1 - 0.98 * (1 - (8 / 16) ** 2), id="small"),
        pytest.param(8, 0.0, 1.0, id="too-small"),
        pytest.param(400, 0.5, 1 - 0.98 * 0.5, id="half-hidden"),
        pytest.param(400, 0.9, 1.0, id="hidden"),
    ],
)
def test_small_and_hidden_lights_are_missed(
    signals: SignalSet, rates: FloatArray, height_px: float, hidden: float, missed: float
) -> None:
    detector = model(signals, rates, miss_rate=0.02, small_height_px=8.0)
    seen = seen_as(detector.detect(views(signals, height_px=height_px, hidden=hidden), camera=0))
    assert np.mean(seen < 0) == pytest.approx(missed, abs=0.015)


def test_what_is_outside_the_image_is_not_seen(signals: SignalSet, rates: FloatArray) -> None:
    inside = views(signals)
    outside = inside.boxes_xyxy + np.array([5000.0, 0, 5000.0, 0])
    behind = np.full_like(inside.boxes_xyxy, np.nan)
    for boxes in (outside, behind):
        there = LightViews(inside.times_s, SIZE_WH, boxes, inside.class_ids, inside.hidden, inside.is_light)
        assert not any(len(frame.detections) for frame in model(signals, rates).detect(there, camera=0))


def test_boxes_are_as_noisy_as_asked(signals: SignalSet, rates: FloatArray) -> None:
    there = views(signals, height_px=100)
    frames = model(signals, rates, edge_sigma_px=1.5, edge_sigma_share=0.02).detect(there, camera=0)
    off = np.concatenate([f.detections.boxes_xyxy - there.boxes_xyxy[0][f.sources] for f in frames])
    assert off.std(axis=0) == pytest.approx(np.full(4, 2.5), rel=0.06)  # hypot(1.5, 0.02 x 100)
    assert np.abs(off.mean(axis=0)).max() < 0.1


def test_scores_tell_something_but_not_all(signals: SignalSet, rates: FloatArray) -> None:
    frames = model(signals, rates, miss_rate=0.05).detect(views(signals), camera=0)
    scores = np.concatenate([f.detections.scores for f in frames])
    right = np.concatenate([f.detections.class_ids == signals.class_ids[RED] for f in frames])
    assert scores[right].mean() > scores[~right].mean() + 0.1
    # Some errors are surer than some truths.
    assert np.percentile(scores[~right], 90) > np.percentile(scores[right], 20)
    assert (scores <= 1).all()
    assert np.percentile(scores, 1) < 0.4 < 0.7 < np.median(scores)


def test_the_truth_comes_second_in_an_error(signals: SignalSet, rates: FloatArray) -> None:
    frames = model(signals, rates).detect(views(signals), camera=0)
    probs = np.concatenate([f.detections.class_probs for f in frames])
    wrong = probs.argmax(axis=1) != signals.class_ids[RED]
    assert (np.argsort(probs[wrong], axis=1)[:, -2] == signals.class_ids[RED]).mean() > 0.95


def test_a_lookalike_is_a_light_for_its_share_of_the_time(signals: SignalSet, rates: FloatArray) -> None:
    there = views(signals, is_light=False, shown=GREEN)
    seen = seen_as(model(signals, rates, lookalike_share=0.3).detect(there, camera=0))
    assert np.mean(seen >= 0) == pytest.approx(0.3, abs=0.02)


def test_false_alarms_come_at_their_rate_and_stay_a_while(signals: SignalSet, rates: FloatArray) -> None:
    there = views(signals, hidden=1.0)  # nothing else to be seen
    frames = model(signals, rates, false_alarms_per_s=10.0, persistence_s=0.4).detect(there, camera=0)
    assert all((frame.sources == -1).all() for frame in frames)
    # 10 a second that stay for 0.4 s: 4 at any time.
    assert np.mean([len(frame.detections) for frame in frames]) == pytest.approx(4.0, abs=0.5)


def test_same_seed_same_detections(signals: SignalSet, rates: FloatArray) -> None:
    config = DetectorModelConfig()
    first, again = (model(signals, rates, config).detect(views(signals), camera=1) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        assert np.array_equal(a.detections.boxes_xyxy, b.detections.boxes_xyxy)
        assert np.array_equal(a.detections.class_probs, b.detections.class_probs)
    other = DetectorModel(signals, rates, config, count=COUNT, duration_s=DURATION_S + 1, seed=(8,))
    assert not np.array_equal(seen_as(first), seen_as(other.detect(views(signals), camera=1)))


def test_another_detector_of_the_same_quality(signals: SignalSet, rates: FloatArray) -> None:
    others = [perturb_errors(rates, 0.6, np.random.default_rng(i)) for i in range(2000)]
    assert np.mean(others, axis=0) == pytest.approx(rates, abs=0.003)
    assert not np.allclose(others[0], rates, atol=0.003)
    assert others[0].sum(axis=1) == pytest.approx(np.ones(len(rates)))


def test_scaled_errors_stay_rates(signals: SignalSet, rates: FloatArray) -> None:
    assert scale_errors(rates, 2.0)[signals.class_ids[RED], signals.class_ids[YELLOW]] == pytest.approx(0.14)
    assert np.diag(scale_errors(rates, 1e6)).min() == pytest.approx(0.1)


def test_the_expected_matrix_counts_misses(signals: SignalSet, rates: FloatArray) -> None:
    confusion = expected_confusion(rates, signals, per_class=1000, miss_rate=0.1, score_threshold=0.25)
    row = confusion.counts[signals.class_ids[RED]]
    assert row[signals.class_ids[YELLOW]] == 63
    assert row[signals.class_ids[RED]] == 810
    assert row[-1] == 100


@pytest.mark.parametrize(
    ("table", "message"),
    [
        pytest.param({RED: {"3-blue": 0.1}}, "'3-blue' is no class", id="unknown"),
        pytest.param({RED: {YELLOW: 1.0}}, "sum to less than 1", id="never-right"),
        pytest.param({RED: {YELLOW: -0.1}}, "not be negative", id="negative"),
    ],
)
def test_impossible_rates_are_refused(signals: SignalSet, table: dict[str, dict[str, float]], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        confusion_rates(table, signals)
