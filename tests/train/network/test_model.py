import pytest
import torch

from autolights.train.network.model import ANCHORS_PX, FINE_STRIDES, STRIDES, YoloV5

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


def test_a_fine_level_is_added_behind_the_published_ones():
    published = YoloV5("n", 2).eval()
    fine = YoloV5("n", 2, strides=FINE_STRIDES).eval()
    fine.load_state_dict({k: v for k, v in published.state_dict().items() if k != "model.24.anchors"}, strict=False)
    images = torch.rand(1, 3, 64, 96)
    seen = {}
    for i in (2, 17):
        fine.model[i].register_forward_hook(lambda _module, _inputs, output, i=i: seen.update({i: output}))

    raw, wanted = fine(images), published(images)

    torch.testing.assert_close(raw[:, : wanted.shape[1]], wanted)
    added = raw[0, wanted.shape[1] :]
    assert len(added) == 3 * (64 // 4) * (96 // 4)
    # A cell of stride 4 reaches half a cell beyond its sides, and boxes up to 4 times its anchor.
    assert (added[0, :2] >= -2).all()
    assert (added[0, :2] <= 6).all()
    assert (added[0, 2:4] <= 4 * torch.tensor(ANCHORS_PX[4][0])).all()
    assert (seen[2].shape[2:], seen[17].shape[2:]) == ((16, 24), (8, 12))
    logits = fine.detect.m[3](fine.fine(seen[17], seen[2])).view(3, 7, 16 * 24)
    torch.testing.assert_close(added[:, 4:].view(3, 16 * 24, 3), logits[:, 4:].sigmoid().permute(0, 2, 1))
    bias = fine.detect.m[3].bias.view(3, 7)[:, 4]
    assert 4 < bias.sigmoid().mean() * (640 / 4) ** 2 < 16  # about 8 lights an image, like on each level


@pytest.mark.parametrize("strides", [STRIDES, FINE_STRIDES])
def test_anchors_are_set_in_pixels_and_kept_in_cells(strides):
    model = YoloV5("n", 1, strides=strides)
    torch.testing.assert_close(model.anchors_px, torch.tensor([ANCHORS_PX[stride] for stride in strides]))

    model.set_anchors(torch.full((len(strides), 3, 2), 48.0))

    assert model.anchors[:, 0, 0].tolist() == [48 / stride for stride in strides]
    assert (model.anchors_px == 48).all()


def test_levels_are_the_published_three_or_one_more():
    with pytest.raises(ValueError, match=r"strides must be \(8, 16, 32\) or \(8, 16, 32, 4\), got \(4, 8\)"):
        YoloV5("n", 2, strides=(4, 8))


def test_names_must_fit_the_classes():
    assert YoloV5("n", 2).classes == ("0", "1")
    with pytest.raises(ValueError, match="fit the names, got 2 and 1"):
        YoloV5("n", 2, ["green"])
