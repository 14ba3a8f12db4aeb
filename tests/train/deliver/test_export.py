import numpy as np
import onnx
import pytest
import torch
from torch import nn

from autolights.core import InitialWeights
from autolights.core.boxes import match_boxes
from autolights.core.errors import ParityError, UsageError
from autolights.core.model_info import load_model_info
from autolights.infer import Detector, decode
from autolights.infer.letterbox import InputBuffer
from autolights.train.deliver import export
from autolights.train.deliver.export import Parity, export_onnx
from autolights.train.network.model import FINE_STRIDES, YoloV5

CLASSES = ("3-red", "3-green", "3-yellow")
SIZE_WH = (96, 64)


@pytest.fixture(scope="module")
def model():
    """A nano whose weights and statistics are anything but zero, and that finds something everywhere."""
    torch.manual_seed(0)
    network = YoloV5("n", len(CLASSES), CLASSES)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.1)
            module.running_var.uniform_(0.5, 1.5)
    for convolution in network.detect.m:
        nn.init.normal_(convolution.weight, std=0.5)
        nn.init.normal_(convolution.bias, std=0.5)
    return network


@pytest.fixture
def photo():
    return np.random.default_rng(1).integers(0, 256, (80, 140, 3), dtype=np.uint8)


def test_runtime_detector_says_what_the_network_says(model, photo, tmp_path):
    report = export_onnx(model, tmp_path / "model.onnx", size_wh=SIZE_WH, images=[photo])
    blob = np.empty((1, 3, SIZE_WH[1], SIZE_WH[0]), dtype=np.float32)
    letterbox = InputBuffer(SIZE_WH).fill(photo, blob[0])
    with torch.inference_mode():
        raw = model.eval()(torch.from_numpy(blob))[0].numpy()
    wanted = decode(raw, letterbox, score_threshold=0.25)

    got = Detector(report.path, report.info)(photo)

    assert len(wanted) > 10
    assert len(got) == len(wanted)
    a, b = match_boxes(got.boxes_xyxy, wanted.boxes_xyxy, iou_threshold=0.9)  # equal scores may change places
    np.testing.assert_allclose(got.boxes_xyxy[a], wanted.boxes_xyxy[b], atol=1e-3)
    np.testing.assert_allclose(got.objectness[a], wanted.objectness[b], atol=1e-4)
    np.testing.assert_allclose(got.class_probs[a], wanted.class_probs[b], atol=1e-4)
    assert len(a) == len(got)
    assert report.info.parity["images"] == 3
    assert report.info.parity["detections"] >= len(wanted)
    assert report.info.parity["detection_px"] < 1e-3


def test_file_is_small_typed_and_tells_what_it_is(model, tmp_path):
    weights = InitialWeights(name="base.pt", sha256="0" * 64, licence="Apache-2.0")
    report = export_onnx(
        model,
        tmp_path / "model.onnx",
        size_wh=SIZE_WH,
        score_threshold=0.3,
        initial_weights=weights,
        training={"ap": 0.5},
    )

    proto = onnx.load(report.path)
    assert len(proto.graph.node) <= 240
    assert not {"BatchNormalization", "Shape", "Range", "Expand"} & {node.op_type for node in proto.graph.node}
    inferred = onnx.shape_inference.infer_shapes(proto, strict_mode=True, data_prop=True).graph
    shapes = {value.name: [d.dim_value for d in value.type.tensor_type.shape.dim] for value in inferred.value_info}
    assert all(all(shape) for shape in shapes.values())
    rows = 3 * (12 * 8 + 6 * 4 + 3 * 2)
    assert [d.dim_value for d in inferred.output[0].type.tensor_type.shape.dim] == [1, rows, 8]
    properties = {entry.key: entry.value for entry in proto.metadata_props}
    assert properties["names"] == '["3-red", "3-green", "3-yellow"]'
    assert (properties["size_wh"], properties["head"]) == ("[96, 64]", "raw")
    assert load_model_info(report.path) == report.info
    assert (report.info.classes, report.info.size_wh, report.info.opset) == (CLASSES, SIZE_WH, 17)
    assert (report.info.score_threshold, report.info.initial_weights) == (0.3, weights)
    assert report.info.training == {"ap": 0.5}


def test_a_fine_level_is_exported_too(photo, tmp_path):
    torch.manual_seed(1)
    network = YoloV5("n", 2, strides=FINE_STRIDES)
    for convolution in network.detect.m:
        nn.init.normal_(convolution.weight, std=0.5)
        nn.init.normal_(convolution.bias, std=0.5)
    anchors_px = torch.arange(4.0, 28.0).view(4, 3, 2)
    network.set_anchors(anchors_px)

    report = export_onnx(network, tmp_path / "model.onnx", size_wh=SIZE_WH, images=[photo])

    (output,) = onnx.load(report.path).graph.output
    rows = 3 * (12 * 8 + 6 * 4 + 3 * 2 + 24 * 16)
    assert [d.dim_value for d in output.type.tensor_type.shape.dim] == [1, rows, 7]
    assert report.info.parity["detections"] > 10


def test_initial_weights_are_those_the_network_remembers(tmp_path):
    network = YoloV5("n", 1, ["light"])
    network.initial_weights = InitialWeights(name="yolov5n.pt", sha256="1" * 64, licence="AGPL-3.0")

    report = export_onnx(network.train(), tmp_path / "model.onnx", size_wh=(32, 32))

    assert report.info.initial_weights == network.initial_weights
    assert network.training


def test_a_wrong_export_is_not_written(model, tmp_path, monkeypatch):
    class Larger(export._FixedSize):
        def __init__(self, network, size_wh):
            super().__init__(network, size_wh)
            self.anchors *= 1.01

    monkeypatch.setattr(export, "_FixedSize", Larger)

    with pytest.raises(
        ParityError, match=r"differs from the network by .* px in the raw output, .*; nothing was written"
    ):
        export_onnx(model, tmp_path / "model.onnx", size_wh=SIZE_WH)

    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "difference",
    [
        pytest.param({"box_px": 0.06}, id="box"),
        pytest.param({"detection_px": 0.02}, id="detection"),
        pytest.param({"prob": 2e-4}, id="probability"),
        pytest.param({"prob": float("nan")}, id="nan"),
        pytest.param({"detection_px": float("nan")}, id="nan-detection"),
        pytest.param({"box_px": float("nan")}, id="nan-box"),
        pytest.param({"unmatched": 1}, id="a-light-more"),
    ],
)
def test_each_figure_can_fail_the_gate(difference):
    fine = {"images": 2, "box_px": 0.001, "prob": 1e-5, "detections": 3, "detection_px": 0.001, "unmatched": 0}
    Parity(**fine).check()

    with pytest.raises(ParityError):
        Parity(**{**fine, **difference}).check()


@pytest.mark.parametrize("size_wh", [(640, 400), (0, 32), (-32, 32)])
def test_size_must_fit_the_strides(model, tmp_path, size_wh):
    with pytest.raises(UsageError, match="must be multiples of 32 px, got"):
        export_onnx(model, tmp_path / "model.onnx", size_wh=size_wh)
