import numpy as np
import pytest

from autolights.core import ModelInfo
from autolights.core.errors import ParityError
from autolights.train.deliver.parity import TOLERANCES, Parity, _Differences

FINE = {
    "images": 2,
    "inputs": ((1, 3, 64, 96),),
    "box_px": 0.001,
    "prob": 1e-5,
    "detections": 3,
    "detection_px": 0.001,
    "score": 1e-6,
    "unmatched": 0,
    "agreement": 1.0,
    "candidates": 9,
}


@pytest.mark.parametrize(
    ("difference", "text"),
    [
        pytest.param({"box_px": 0.06}, r"in box_px 0.06 \(allowed: 0.05\)", id="box"),
        pytest.param({"detection_px": 0.02}, "detection_px", id="detection"),
        pytest.param({"prob": 2e-4}, "prob", id="probability"),
        pytest.param({"score": 2e-4}, "score", id="score"),
        pytest.param({"prob": float("nan")}, "prob nan", id="nan"),
        pytest.param({"detection_px": float("nan")}, "detection_px nan", id="nan-detection"),
        pytest.param({"box_px": float("nan")}, "box_px nan", id="nan-box"),
        pytest.param({"score": float("nan")}, "score nan", id="nan-score"),
        pytest.param({"unmatched": 1}, r"unmatched 1 \(allowed: 0\)", id="a-light-more"),
        pytest.param({"agreement": 0.4}, r"agreement 0.4 \(at least: 0.5\)", id="other-lights"),
        pytest.param(
            {"box_px": None, "unmatched": 1, "candidates": 900},
            "900 rows of an image are above the score threshold, of which the graph looks at 512",
            id="crowd",
        ),
    ],
)
def test_each_figure_can_fail_the_gate(difference, text):
    Parity(**FINE).check(TOLERANCES["fp32"])

    with pytest.raises(ParityError, match=text):
        Parity(**{**FINE, **difference}).check(TOLERANCES["fp32"])


def rows(*boxes_and_scores):
    """(x, y, side, score) each → rows of two classes."""
    return np.array([[x, y, side, side, score, 0.1, 1.0] for x, y, side, score in boxes_and_scores], dtype=np.float32)


def compared(wanted, got, precision="fp32"):
    found = _Differences(ModelInfo(classes=("a", "b"), size_wh=(96, 64), opset=17, precision=precision))
    found.add(wanted[None], [got[None]])
    return found.parity()


def test_figures_by_hand():
    wanted = rows((20, 20, 10, 0.9), (21, 20, 10, 0.8), (60, 20, 10, 0.5), (80, 40, 10, 0.1))
    got = rows((20.5, 20, 10, 0.9), (21, 20, 10, 0.8), (60, 20, 10, 0.47), (80, 40, 10, 0.1))

    parity = compared(wanted, got)

    assert parity.box_px == 0.5
    assert parity.prob == pytest.approx(0.03)
    assert (parity.detections, parity.unmatched, parity.agreement) == (2, 0, 1.0)
    assert parity.detection_px == 0.5
    assert parity.score == pytest.approx(0.03)
    assert parity.candidates == 3


def test_a_light_that_one_alone_sees_counts_unless_it_is_at_the_threshold():
    seen = rows((20, 20, 10, 0.9), (60, 20, 10, 0.4))
    unseen = rows((20, 20, 10, 0.9), (60, 40, 10, 0.1))

    assert compared(seen, unseen).unmatched == 1
    assert compared(unseen, seen).unmatched == 1
    assert compared(seen, unseen).agreement == 0.5
    assert compared(rows((60, 20, 10, 0.25005)), rows((60, 40, 10, 0.24995))).unmatched == 0


# 10 px squares that lie 10/3 px apart overlap by exactly the threshold of 0.5.
THIRD = 10 / 3


@pytest.mark.parametrize(
    ("wanted", "got"),
    [
        pytest.param(
            rows((20, 20, 10, 0.9), (20 + THIRD - 1e-5, 20, 10, 0.8)),
            rows((20, 20, 10, 0.9), (20 + THIRD + 1e-5, 20, 10, 0.8)),
            id="overlap-at-the-threshold",
        ),
        pytest.param(
            rows((20, 20, 10, 0.80001), (22, 20, 10, 0.8)),
            rows((20, 20, 10, 0.8), (22, 20, 10, 0.80001)),
            id="either-first",
        ),
        pytest.param(  # the second is suppressed or not, and so the third is not or is
            rows((20, 20, 10, 0.9), (20 + THIRD - 1e-5, 20, 10, 0.8), (26, 20, 10, 0.7)),
            rows((20, 20, 10, 0.9), (20 + THIRD + 1e-5, 20, 10, 0.8), (26, 20, 10, 0.7)),
            id="and-what-follows",
        ),
    ],
)
def test_lights_that_rounding_suppresses_are_left_aside(wanted, got):
    for ours, theirs in ((wanted, got), (got, wanted)):
        parity = compared(ours, theirs)

        assert (parity.unmatched, parity.agreement) == (0, 1.0)


@pytest.mark.parametrize(
    ("wanted", "got"),
    [
        pytest.param((20, 20, 10, 0.9), (21, 20, 10, 0.9), id="moved"),
        pytest.param((20, 20, 10, 0.9), (20, 20, 12, 0.9), id="larger"),
    ],
)
def test_what_only_looks_like_a_near_tie_counts(wanted, got):
    assert compared(rows(wanted), rows(got)).unmatched == 1


def test_no_suppression_at_all_counts():
    wanted = rows((20, 20, 10, 0.9), (21, 20, 10, 0.8), (21, 21, 10, 0.7))
    info = ModelInfo(classes=("a", "b"), size_wh=(96, 64), opset=17, precision="fp32", head="end2end")
    found = _Differences(info)
    boxes = np.hstack([wanted[:, :2] - wanted[:, 2:4] / 2, wanted[:, :2] + wanted[:, 2:4] / 2])

    found.add(wanted[None], [boxes[None], wanted[None, :, 4], np.zeros((1, 3), np.int64), wanted[None, :, 5:]])

    assert found.parity().unmatched == 2


def test_rounding_in_a_crowd_explains_everything_and_a_lost_light_nothing():
    random = np.random.default_rng(4)
    for _ in range(30):
        # On a coarse grid with coarse scores, so that ties are everywhere.
        places, scores = random.integers(0, 30, (60, 2)) * THIRD, random.integers(5, 9, 60) / 10
        crowd = rows(*((x, y, 10, score) for (x, y), score in zip(places, scores, strict=True)), (180, 20, 10, 0.6))
        rounded = crowd.copy()
        rounded[:, :2] += random.normal(0, 1e-5, (61, 2))
        rounded[:, 4] += random.normal(0, 1e-6, 61)

        assert compared(crowd, rounded).unmatched == 0
        assert compared(crowd, rounded[:-1].repeat([1] * 59 + [2], axis=0)).unmatched == 1


def test_only_a_full_list_may_lack_its_last_lights():
    apart = [(20 * i, 20, 10, 0.9 - 0.01 * i) for i in range(4)]
    full = ModelInfo(classes=("a", "b"), size_wh=(96, 64), opset=17, precision="fp32", max_detections=3, head="end2end")
    nearly = rows(*apart[:2], (40, 20, 10, 0.88), (60, 20, 10, 0.87995))

    def parity_of(reported):
        found = _Differences(full)
        boxes = np.hstack([reported[:, :2] - reported[:, 2:4] / 2, reported[:, :2] + reported[:, 2:4] / 2])
        outputs = [boxes, reported[:, 4], np.zeros(len(reported), np.int64), reported[:, 5:]]
        found.add(nearly[None], [output[None] for output in outputs])
        return found.parity()

    other_last = parity_of(nearly[[0, 1, 3]])
    assert (other_last.unmatched, other_last.agreement) == (0, 1.0)
    not_full = parity_of(nearly[:2])
    assert (not_full.unmatched, not_full.agreement) == (1, 0.8)
    assert parity_of(nearly[:0]).agreement == 0
