import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from autolights.core import ModelInfo
from autolights.core.boxes import match_boxes, nms
from autolights.train.deliver.heads import MAX_CANDIDATES, SUPPRESSION_ROUNDS, End2EndHead, build_head, row_count
from autolights.train.network.model import YoloV5


@pytest.fixture(scope="module")
def head(model):
    info = ModelInfo(classes=model.classes, size_wh=(96, 64), head="end2end", opset=17)
    built = build_head(model, info)
    assert isinstance(built, End2EndHead)
    return built


def kept_in_graph(head, boxes_xyxy):
    """Rows that the graph keeps of boxes sorted best first."""
    return np.flatnonzero(head._keep(torch.from_numpy(boxes_xyxy.astype(np.float32))[None])[0].numpy()).tolist()


def greedy(boxes_xyxy, count=10_000):
    return nms(boxes_xyxy, -np.arange(len(boxes_xyxy)), iou_threshold=0.5, max_boxes=count).tolist()


@given(st.integers(0, 10_000), st.integers(1, 120))
@settings(max_examples=60, deadline=None)
def test_suppression_in_the_graph_is_greedy_suppression(head, seed, count):
    rng = np.random.default_rng(seed)
    centres = rng.choice(rng.uniform(0, 300, (6, 2)), count) + rng.normal(0, 6, (count, 2))
    halves = rng.uniform(4, 20, (count, 2))
    boxes = np.concatenate([centres - halves, centres + halves], axis=1).astype(np.float32).astype(np.float64)

    assert kept_in_graph(head, boxes) == greedy(boxes)


def chain(links):
    """Each box overlaps its neighbours alone, by an IoU of 0.6: greedy keeps every second one."""
    left = 2.5 * np.arange(links)
    return np.stack([left, np.zeros(links), left + 10, np.full(links, 10)], axis=1)


def test_a_chain_as_long_as_the_rounds_is_exact_and_a_longer_one_keeps_a_box_too_many(head):
    longest = chain(SUPPRESSION_ROUNDS + 1)
    assert kept_in_graph(head, longest) == greedy(longest) == list(range(0, SUPPRESSION_ROUNDS + 1, 2))

    longer = chain(SUPPRESSION_ROUNDS + 4)
    assert set(kept_in_graph(head, longer)) > set(greedy(longer))


def test_boxes_without_area_neither_suppress_nor_go(head):
    boxes = np.array([[5, 5, 5, 5], [5, 5, 5, 5], [0, 0, 10, 10]], dtype=np.float64)

    assert kept_in_graph(head, boxes) == greedy(boxes) == [0, 1, 2]


@pytest.mark.parametrize("dynamic_size", [False, True], ids=["fixed", "dynamic"])
@pytest.mark.parametrize("name", ["model", "fine_model"])
def test_raw_head_is_the_network_in_eval_mode(request, name, dynamic_size):
    network = request.getfixturevalue(name)
    info = ModelInfo(classes=network.classes, size_wh=(96, 64), dynamic_size=dynamic_size, opset=17)
    images = torch.rand(2, 3, 64, 96, generator=torch.Generator().manual_seed(0))

    with torch.inference_mode():
        wanted, got = network(images), build_head(network, info)(images)

    assert got.shape == (2, row_count((96, 64), network.strides), 5 + len(network.classes))
    torch.testing.assert_close(got, wanted, atol=1e-3, rtol=1e-5)


def test_end2end_head_is_greedy_suppression_of_the_raw_rows(model, head):
    images = torch.rand(2, 3, 64, 96, generator=torch.Generator().manual_seed(2))

    with torch.inference_mode():
        rows, (boxes, scores, classes, probs) = model(images).double().numpy(), head(images)

    for i in range(2):
        row_scores = rows[i, :, 4] * rows[i, :, 5:].max(axis=1)
        centres, halves = rows[i, :, :2], rows[i, :, 2:4] / 2
        row_boxes = np.concatenate([centres - halves, centres + halves], axis=1)
        kept = nms(row_boxes, row_scores, iou_threshold=0.5, max_boxes=100)
        assert len(kept) > 20
        np.testing.assert_allclose(scores[i, : len(kept)], row_scores[kept], atol=1e-5)
        # Equal scores may change places.
        a, b = match_boxes(boxes[i, : len(kept)].double().numpy(), row_boxes[kept], iou_threshold=0.99)
        assert len(a) == len(kept)
        np.testing.assert_allclose(boxes[i, a], row_boxes[kept[b]], atol=1e-2)
        np.testing.assert_allclose(probs[i, a], rows[i, kept[b], 5:], atol=1e-5)
        assert np.array_equal(classes[i, a], rows[i, kept[b], 5:].argmax(axis=1))
        assert not scores[i, len(kept) :].any()
    assert classes.dtype == torch.int32


def test_candidates_are_as_many_as_the_smallest_input_has_rows():
    network = YoloV5("n", 2)

    def candidates(size_wh, dynamic_size=False):
        info = ModelInfo(classes=network.classes, size_wh=size_wh, head="end2end", dynamic_size=dynamic_size, opset=17)
        return build_head(network, info).candidates

    assert candidates((64, 64)) == 252
    assert candidates((640, 640)) == MAX_CANDIDATES
    assert candidates((640, 640), dynamic_size=True) == MAX_CANDIDATES
