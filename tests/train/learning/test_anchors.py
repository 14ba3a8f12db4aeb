import numpy as np
import pytest
import torch
from scipy.cluster.vq import kmeans2

from autolights.train.learning.anchors import anchor_recall, estimate_anchors, fit_anchors
from autolights.train.network.model import FINE_STRIDES, STRIDES, YoloV5

ANCHORS = np.array([[10.0, 20.0], [40.0, 40.0]])


@pytest.mark.parametrize(
    ("side_px", "reached"),
    [
        pytest.param((10, 20), True, id="an-anchor-itself"),
        pytest.param((2.6, 5.2), True, id="just-within-a-quarter"),
        pytest.param((2.5, 5.0), False, id="a-quarter"),
        pytest.param((39, 79), True, id="almost-fourfold"),
        pytest.param((8, 90), False, id="one-side-too-long"),
        pytest.param((159, 159), True, id="the-other-anchor"),
    ],
)
def test_reach_by_hand(side_px, reached):
    assert anchor_recall(np.array([side_px], dtype=float), ANCHORS) == reached


def test_recall_is_a_share():
    sides = np.array([[10.0, 20.0], [1.0, 1.0], [40.0, 40.0], [400.0, 400.0]])

    assert anchor_recall(sides, ANCHORS) == 0.5
    assert anchor_recall(sides, ANCHORS, ratio=21) == 1.0
    assert anchor_recall(np.zeros((0, 2)), ANCHORS) == 1.0


@pytest.mark.parametrize("strides", [STRIDES, FINE_STRIDES])
def test_clusters_are_found_and_dealt_out_by_size(strides):
    """Labels around as many sizes as there are anchors: each is found, the smallest on the finest level."""
    count = 3 * len(strides)
    truth = np.stack([3 * 1.5 ** np.arange(count), 7 * 1.5 ** np.arange(count)], axis=1)
    rng = np.random.default_rng(5)
    labels = np.repeat(truth, 40, axis=0) * np.exp(rng.normal(0, 0.02, (40 * count, 2)))

    anchors = estimate_anchors(rng.permutation(labels), strides, seed=0)

    by_stride = np.concatenate([anchors[strides.index(stride)] for stride in sorted(strides)])
    np.testing.assert_allclose(by_stride, truth, rtol=0.05)


def test_anchors_come_nearer_than_the_clusters_they_start_from():
    sides = np.exp(np.random.default_rng(4).normal(2.5, 0.7, (400, 2)))

    def closeness(anchors):
        ratios = sides[:, None] / anchors.reshape(1, -1, 2)
        return np.minimum(ratios, 1 / ratios).min(axis=2).max(axis=1).mean()

    clusters = [np.exp(kmeans2(np.log(sides), 9, minit="++", seed=seed)[0]) for seed in range(5)]

    assert closeness(estimate_anchors(sides, STRIDES, seed=0)) > 1.01 * max(map(closeness, clusters))


def test_the_seed_decides():
    labels = np.exp(np.random.default_rng(0).normal(2, 1, (200, 2)))

    first, again = (estimate_anchors(labels, STRIDES, seed=1) for _ in range(2))

    np.testing.assert_array_equal(first, again)


def test_anchors_that_reach_the_labels_are_kept():
    model = YoloV5("n", 1)
    before = model.anchors.clone()

    report = fit_anchors(model, np.exp(np.random.default_rng(0).uniform(np.log(10), np.log(300), (500, 1))) * [1, 1.2])

    assert report == "anchors can reach 100.0% of 500 labels; kept"
    assert torch.equal(model.anchors, before)


def test_tiny_lights_get_tiny_anchors():
    heights = np.exp(np.random.default_rng(0).uniform(np.log(3), np.log(16), 500))
    sides = np.stack([heights * 0.4, heights], axis=1)
    model = YoloV5("n", 1)

    report = fit_anchors(model, sides)

    assert report.startswith("anchors can reach ")
    assert report.endswith("; re-estimated: 100.0%")
    assert anchor_recall(sides, model.anchors_px.numpy()) == 1.0
    assert model.anchors_px.max() < 16
    assert (model.anchors_px.prod(dim=2).flatten().diff() > 0).all()


def test_too_few_sizes_to_estimate_from():
    model = YoloV5("n", 1)

    report = fit_anchors(model, np.full((50, 2), 1.0))

    assert report == (
        "anchors can reach 0.0% of 50 labels; kept, as 9 anchors need at least 9 different label sizes, got 1"
    )
