import pytest
import torch

from autolights.train.model import ANCHORS_PX, STRIDES, YoloV5

NANO_LAYERS = [1760, 4672, 4800, 18560, 29184, 73984, 156928, 295424, 296448, 164608, 33024, 0, 0, 90880, 8320, 0, 0]
NANO_LAYERS += [22912, 36992, 0, 74496, 147712, 0, 296448, 115005]  # published, 80 classes


@pytest.mark.parametrize(
    ("size", "coco", "autolights_13"),
    [
        ("n", 1_872_157, 1_781_506),
        ("s", 7_235_389, 7_054_690),
        ("m", 21_190_557, 20_919_810),
        ("l", 46_563_709, 46_202_914),
        ("x", 86_749_405, 86_298_562),
    ],
)
def test_parameter_counts_are_the_published_ones(size, coco, autolights_13):
    with torch.device("meta"):
        counts = [sum(p.numel() for p in YoloV5(size, classes).parameters()) for classes in (80, 13)]

    assert counts == [coco, autolights_13]


def test_each_layer_of_the_nano_has_the_published_parameters():
    layers = YoloV5("n", 80).model

    assert [sum(p.numel() for p in layer.parameters()) for layer in layers] == NANO_LAYERS


def test_rows_run_over_levels_anchors_y_and_x():
    model = YoloV5("n", 2).eval()
    rows_per_level = [3 * (64 // stride) * (96 // stride) for stride in STRIDES]
    maps = [torch.zeros(1, 3, 64 // stride, 96 // stride, 7) for stride in STRIDES]

    raw = model.detect.decode(maps)

    assert model(torch.zeros(1, 3, 64, 96)).shape == raw.shape == (1, sum(rows_per_level), 7)
    # Zero logits: the centre of the cell, the anchor's size, probability one half.
    row = raw[0, rows_per_level[0] + 1 * (4 * 6) + 2 * 6 + 5]  # stride 16, anchor 1, y 2, x 5
    assert row.tolist() == [5.5 * 16, 2.5 * 16, *ANCHORS_PX[16][1], 0.5, 0.5, 0.5]


def test_training_mode_gives_logits_that_start_from_the_prior():
    torch.manual_seed(0)
    model = YoloV5("n", 13).train()

    maps = model(torch.rand(2, 3, 64, 64))

    assert [tuple(m.shape) for m in maps] == [(2, 3, 8, 8, 18), (2, 3, 4, 4, 18), (2, 3, 2, 2, 18)]
    expected_lights = sum(
        model.detect.m[i].bias.view(3, 18)[:, 4].sigmoid().mean() * (640 / s) ** 2 for i, s in enumerate(STRIDES)
    )
    assert 12 < expected_lights < 48  # about 8 per level


def test_names_must_fit_the_classes():
    assert YoloV5("n", 2).classes == ("0", "1")
    with pytest.raises(ValueError, match="fit the names, got 2 and 1"):
        YoloV5("n", 2, ["green"])
