import math

import pytest
import torch

from autolights.train.config import LossConfig
from autolights.train.loss import detection_loss

ANCHORS = torch.tensor([[[2.0, 4.0]]])  # one level, one anchor
LABEL = torch.tensor([[0, 1, 5.5 / 10, 5.5 / 10, 2 / 10, 4 / 10]])  # the middle of cell (5, 5), of the anchor's size


def logits(batch=1, classes=3, *, objectness=-20.0, class_logits=0.0):
    maps = torch.full((batch, 1, 10, 10, 5 + classes), class_logits)
    maps[..., :4] = 0.0  # the cell's centre, the anchor's size
    maps[..., 4] = objectness
    return maps


def loss(maps, labels, *, side=640, **gains):
    return detection_loss([maps], labels, ANCHORS, strides=(8,), input_side_px=side, config=LossConfig(**gains))


def test_a_perfect_answer_costs_nothing():
    maps = logits(class_logits=-20.0)
    maps[0, 0, 5, 5, 4] = 20.0
    maps[0, 0, 5, 5, 5 + 1] = 20.0

    assert loss(maps, LABEL).total.item() == pytest.approx(0, abs=1e-6)


def test_parts_in_closed_form():
    """One level of the published three: its gain is 3, its weight 4."""
    maps = logits(classes=8, objectness=0.0)
    maps[0, 0, 5, 5, 2] = math.log(3)  # width (2 · 3/4)² = 9/4 of the anchor's: IoU 4/9, same centre

    losses = loss(maps, LABEL, side=320, box_gain=0.05, objectness_gain=1.0, class_gain=0.5)

    iou = 4 / 9
    v = 4 / math.pi**2 * (math.atan(2 / 4) - math.atan(4.5 / 4)) ** 2
    ciou = iou - v * v / (1 - iou + v)
    assert losses.box.item() == pytest.approx(0.05 * 3 * (1 - ciou), rel=1e-4)
    # A logit of 0 costs log 2 whatever is wanted.
    assert losses.objectness.item() == pytest.approx(3 * 4 * math.log(2) / 4, rel=1e-5)
    assert losses.classes.item() == pytest.approx(0.5 * 3 * math.log(2) * 8 / 80, rel=1e-5)
    parts = losses.box + losses.objectness + losses.classes
    assert losses.total.item() == pytest.approx(parts.item(), rel=1e-6)


def test_a_distant_box_pays_for_its_distance():
    near, far = logits(), logits()
    far[0, 0, 5, 5, 0] = 20.0  # centre at the cell's 1.5: IoU 1/3 beside the centres' distance

    penalty = 1 / (3**2 + 4**2)
    assert loss(far, LABEL).box.item() == pytest.approx(0.15 * (1 - 1 / 3 + penalty), rel=1e-4)
    assert loss(near, LABEL).box.item() == pytest.approx(0, abs=1e-6)


def test_total_is_the_sum_over_the_batch():
    one, four = logits(1), logits(4)
    labels = torch.cat([LABEL + torch.tensor([i, 0, 0, 0, 0, 0]) for i in range(4)])

    assert loss(four, labels).total.item() == pytest.approx(4 * loss(one, LABEL).total.item(), rel=1e-5)


def test_of_two_labels_in_a_cell_the_better_one_counts_in_any_order():
    other = LABEL * torch.tensor([1, 1, 1, 1, 0.5, 0.5])
    maps = logits(objectness=3.0)

    orders = [loss(maps, torch.cat(pair)).objectness.item() for pair in ((LABEL, other), (other, LABEL))]

    assert orders[0] == orders[1] == pytest.approx(loss(maps, LABEL).objectness.item())


def test_a_batch_without_labels_teaches_objectness_only():
    maps = logits(objectness=0.0).requires_grad_()

    losses = loss(maps, torch.zeros(0, 6))
    losses.total.backward()

    assert (losses.box.item(), losses.classes.item()) == (0, 0)
    assert maps.grad[..., 4].abs().sum() > 0
    assert maps.grad[..., :4].abs().sum() == maps.grad[..., 5:].abs().sum() == 0
