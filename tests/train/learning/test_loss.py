import math
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import pytest
import torch

from autolights.train.config import LossConfig
from autolights.train.learning.loss import class_weights, detection_loss
from autolights.train.processes import Processes

ANCHORS = torch.tensor([[[2.0, 4.0]]])  # one level, one anchor
LABEL = torch.tensor([[0, 1, 5.5 / 10, 5.5 / 10, 2 / 10, 4 / 10]])  # the middle of cell (5, 5), of the anchor's size


def logits(batch=1, classes=3, *, objectness=-20.0, class_logits=0.0):
    maps = torch.full((batch, 1, 10, 10, 5 + classes), class_logits)
    maps[..., :4] = 0.0  # the cell's centre, the anchor's size
    maps[..., 4] = objectness
    return maps


def loss(maps, labels, *, side=640, weights=None, **gains):
    return detection_loss(
        [maps],
        labels,
        ANCHORS,
        strides=(8,),
        input_side_px=side,
        config=LossConfig(**gains),
        class_weights=weights,
    )


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


@pytest.mark.parametrize(
    ("strides", "weights"), [((8, 16, 32), (4, 1, 0.4)), ((8, 16, 32, 4), (1, 0.25, 0.06, 4))], ids=["three", "four"]
)
def test_levels_weigh_as_published(strides, weights):
    """Where only one level is unsure, only its weight counts."""
    for unsure, weight in enumerate(weights):
        maps = [logits(objectness=0.0 if level == unsure else -20.0) for level in range(len(strides))]

        losses = detection_loss(
            maps,
            torch.zeros(0, 6),
            ANCHORS.expand(len(strides), 1, 2),
            strides=strides,
            input_side_px=640,
            config=LossConfig(),
        )

        assert losses.objectness.item() == pytest.approx(3 / len(strides) * weight * math.log(2), rel=1e-5)


def test_smoothed_labels_in_closed_form():
    """Wanted 0.9 and twice 0.1: a logit of log 9 for the class and −log 9 for the others costs their entropy."""
    maps = logits()
    maps[0, 0, 5, 5, 5:] = torch.tensor([-math.log(9), math.log(9), -math.log(9)])

    smoothed = loss(maps, LABEL, label_smoothing=0.2, class_gain=1.0).classes.item()

    entropy = -(0.9 * math.log(0.9) + 0.1 * math.log(0.1))
    assert smoothed == pytest.approx(3 * 3 / 80 * entropy, rel=1e-5)


def test_focal_loss_in_closed_form():
    """A probability of 3/4 for what is wanted counts (1/4)^γ."""
    maps = logits(classes=2, objectness=-math.log(3))
    maps[0, 0, 5, 5, 5:] = torch.tensor([-math.log(3), math.log(3)])

    losses = loss(maps, LABEL, focal_gamma=1.5, class_gain=1.0)

    cost = math.log(4 / 3) / 4**1.5
    assert losses.classes.item() == pytest.approx(3 * 2 / 80 * cost, rel=1e-5)
    empty = loss(maps, torch.zeros(0, 6), focal_gamma=1.5).objectness.item()
    assert empty == pytest.approx(3 * 4 * cost, rel=1e-5)


def test_rare_classes_weigh_more_and_the_mean_over_labels_is_one():
    assert class_weights([10, 90], 0).tolist() == [1, 1]
    assert class_weights([10, 90, 0], 1).tolist()[:2] == pytest.approx([5, 5 / 9])  # 10 · 5 = 90 · 5/9 = 50
    assert class_weights([100, 400], 0.5).tolist() == pytest.approx([5 / 3, 5 / 6])  # 100 · 5/3 + 400 · 5/6 = 500
    assert class_weights([0, 0], 1).tolist() == [1, 1]


def test_a_class_weight_scales_its_positives_alone():
    other = torch.tensor([[0, 0, 2.5 / 10, 5.5 / 10, 2 / 10, 4 / 10]])  # in cell (2, 5)
    maps = logits(classes=2)
    maps[0, 0, 5, 5, 5:], maps[0, 0, 5, 2, 5:] = 1.0, 2.0
    both = torch.cat([LABEL, other])

    def cost(labels, weights=None):
        return loss(maps, labels, weights=weights).classes.item()

    weighted = cost(both, torch.tensor([3.0, 0.5]))

    assert weighted == pytest.approx((0.5 * cost(LABEL) + 3 * cost(other)) / 2, rel=1e-5)
    assert cost(both) == pytest.approx((cost(LABEL) + cost(other)) / 2, rel=1e-5)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_half_precision_maps_are_compared_in_single_precision(dtype):
    maps = logits(objectness=0.25, class_logits=0.5)  # exact in half precision

    exact, got = loss(maps, LABEL), loss(maps.to(dtype), LABEL)

    assert got.total.dtype == torch.float32
    assert got.total.item() == exact.total.item()


@dataclass(frozen=True)
class Threads(Processes):
    """Processes that are threads, so that one test sees all their gradients."""

    values: dict = field(default_factory=dict)
    barrier: threading.Barrier | None = None

    def sum(self, values):
        self.values[self.rank] = values
        self.barrier.wait(timeout=60)
        total = sum(self.values[rank] for rank in range(self.size))
        self.barrier.wait(timeout=60)  # nobody writes before all have read
        return total


def test_processes_together_follow_the_gradient_of_one_with_all_images():
    """Three images for one process, one for the other, which has no label on the coarse level; then no label at all."""
    torch.manual_seed(3)
    anchors = torch.tensor([[[2.0, 4.0]], [[3.0, 3.0]]])
    weights = torch.tensor([0.5, 2.0, 1.0])
    labels = torch.tensor(
        [
            [0, 0, 0.31, 0.42, 0.30, 0.40],
            [0, 1, 0.71, 0.72, 0.90, 0.90],
            [2, 2, 0.55, 0.28, 0.20, 0.90],
            [3, 1, 0.50, 0.63, 0.10, 0.12],
        ]
    )
    whole = [torch.randn(4, 1, side, side, 8) for side in (12, 6)]

    def gradients(maps, rows, processes):
        maps = [level.clone().requires_grad_() for level in maps]
        losses = detection_loss(
            maps,
            rows,
            anchors,
            strides=(8, 16),
            input_side_px=96,
            config=LossConfig(),
            class_weights=weights,
            processes=processes,
        )
        losses.total.backward()
        return losses, [level.grad for level in maps]

    alone, wanted = gradients(whole, labels, Processes())
    values, barrier = {}, threading.Barrier(2)
    parts = [([level[:3] for level in whole], labels[:3])]
    parts.append(([level[3:] for level in whole], labels[3:] - torch.tensor([3, 0, 0, 0, 0, 0])))

    with ThreadPoolExecutor(2) as pool:
        jobs = [pool.submit(gradients, *part, Threads(rank, 2, values, barrier)) for rank, part in enumerate(parts)]
        (first, first_gradients), (second, second_gradients) = [job.result() for job in jobs]

    for level, gradient in enumerate(wanted):
        averaged = torch.cat([first_gradients[level], second_gradients[level]]) / 2
        torch.testing.assert_close(averaged, gradient)
    assert (first.total + second.total).item() / 2 == pytest.approx(alone.total.item(), rel=1e-5)
    for losses in (first, second):
        assert losses.box.item() == pytest.approx(alone.box.item(), rel=1e-5)
        assert losses.objectness.item() == pytest.approx(alone.objectness.item(), rel=1e-5)
        assert losses.classes.item() == pytest.approx(alone.classes.item(), rel=1e-5)
