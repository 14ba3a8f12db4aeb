import numpy as np
import pytest

from autolights.train.measure.average_precision import average_precision
from autolights.train.measure.bootstrap import _average_precisions, _match, compare_detectors
from autolights.train.measure.predictions import Labels, Predictions

CLASSES = ("red", "green", "off")


def random_images(seed, digits=9, image_count=30):
    """Labels, and detections that are shifted, misnamed, missing or made up."""
    random = np.random.default_rng(seed)
    truth, found = [], []
    for _ in range(image_count):
        n = int(random.integers(0, 5))
        lows = random.uniform(0, 400, (n, 2))
        boxes, ids = np.hstack([lows, lows + random.uniform(10, 60, (n, 2))]), random.integers(0, 2, n)
        source = random.integers(0, n, 2 * n) if n else np.empty(0, dtype=int)
        invented = random.uniform(0, 400, (4, 2))
        truth.append(Labels(boxes, ids))
        found.append(
            Predictions(
                np.vstack(
                    [boxes[source] + random.normal(0, 2, (len(source), 4)), np.hstack([invented, invented + 20])]
                ),
                np.concatenate([np.where(random.random(len(source)) < 0.8, ids[source], 2), random.integers(0, 3, 4)]),
                np.round(random.random(len(source) + 4), digits),
            )
        )
    return truth, found


def drawn(images, groups, weights):
    """The images themselves as often as their photo was drawn."""
    return [image for image, group in zip(images, groups, strict=True) for _ in range(int(weights[group]))]


def assert_scores_as_coco(truth, found, groups, weights):
    result = _average_precisions(_match(truth, found, groups, len(CLASSES)), weights)

    for by_overlap, row in zip(result, weights, strict=True):
        oracle = average_precision(drawn(truth, groups, row), drawn(found, groups, row), CLASSES)
        assert 0.05 < oracle.ap < 0.95
        assert (by_overlap[0], by_overlap.mean()) == pytest.approx((oracle.ap50, oracle.ap), abs=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_any_draw_scores_as_coco_does(seed):
    truth, found = random_images(seed)
    random = np.random.default_rng(seed)
    groups = random.permutation(np.arange(len(truth)) % 12)

    assert_scores_as_coco(truth, found, groups, random.multinomial(12, np.full(12, 1 / 12), size=4))


def test_equal_scores_keep_the_order_of_images_as_in_coco():
    truth, found = random_images(2, digits=1)

    assert_scores_as_coco(truth, found, np.arange(len(truth)), np.ones((1, len(truth))))


def test_a_detector_compared_with_itself_does_not_differ():
    truth, found = random_images(0)

    for figure in compare_detectors(truth, [str(i) for i in range(30)], [found], [found], class_count=3, resamples=50):
        assert (figure.difference, figure.low, figure.high) == (0, 0, 0)


def box(x):
    return np.array([[x, 0.0, x + 10, 20]])


def one(x, score=0.9):
    return Predictions(box(x), np.zeros(1, dtype=np.int64), np.array([score]))


def test_interval_is_that_of_the_share_of_photos():
    # 40 photos with a light each; a finds all, b 30: the difference is the share of 10 in 40, a binomial's.
    truth = [Labels(box(0), np.zeros(1, dtype=np.int64))] * 40
    a, b = [one(0)] * 40, [one(0)] * 30 + [one(100, score=0.1)] * 10

    ap50, _ = compare_detectors(truth, [str(i) for i in range(40)], [a], [b], class_count=1, resamples=4000)

    assert (ap50.a, ap50.b) == (1, pytest.approx(76 / 101))  # recalls 0, .01, ... .75
    spread = 1.96 * np.sqrt(0.25 * 0.75 / 40)
    assert (ap50.low, ap50.high) == pytest.approx((0.25 - spread, 0.25 + spread), abs=0.03)


def test_images_of_one_photo_are_drawn_together():
    truth = [Labels(box(0), np.zeros(1, dtype=np.int64))] * 40
    a, b = [one(0)] * 40, ([one(0)] * 30 + [one(100, score=0.1)] * 10)
    photos = [str(i // 10) for i in range(40)]

    ap50, _ = compare_detectors(truth, photos, [a], [b], class_count=1, resamples=1000)

    assert ap50.low == 0  # the one photo on which they differ is not drawn in (3/4)^4 = .32 of the draws
    assert ap50.high > 0.6


def test_figures_are_means_over_runs():
    truth = [Labels(box(0), np.zeros(1, dtype=np.int64))] * 4
    finds_all, finds_none = [one(0)] * 4, [one(100)] * 4

    ap50, ap = compare_detectors(
        truth, list("abcd"), [finds_all, finds_none], [finds_none], class_count=1, resamples=20
    )

    assert (ap50.a, ap50.b, ap50.low, ap50.high) == (0.5, 0, 0.5, 0.5)
    assert ap.difference == 0.5
