import pytest
import torch
from torchvision.ops import box_convert, complete_box_iou_loss

from autolights.train.learning.complete_iou import complete_iou


def random_boxes(count, seed):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, 4, generator=generator, dtype=torch.float64) * 4 + 0.1


def test_values_and_gradients_are_torchvisions_for_ordinary_boxes():
    wanted = random_boxes(200, seed=1)
    ours, theirs = (random_boxes(200, seed=2).requires_grad_() for _ in range(2))

    values = complete_iou(ours, wanted)
    corners = [box_convert(boxes, "cxcywh", "xyxy") for boxes in (theirs, wanted)]
    expected = 1 - complete_box_iou_loss(*corners)
    values.sum().backward()
    expected.sum().backward()

    torch.testing.assert_close(values, expected, atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(ours.grad, theirs.grad, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("side", [1e-8, 1e-18])
def test_a_flat_box_has_a_finite_gradient_that_makes_it_grow(side):
    flat = torch.tensor([[0.9, 0.8, 2.0, side]], requires_grad=True)

    complete_iou(flat, torch.tensor([[0.9, 0.8, 1.9, 5.1]])).sum().backward()

    assert torch.isfinite(flat.grad).all()
    assert flat.grad[0, 3] > 0
