import json

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from autolights.core import InitialWeights
from autolights.core.boxes import match_boxes
from autolights.core.errors import ParityError, UsageError
from autolights.core.model_info import load_model_info
from autolights.infer import Detector, decode
from autolights.infer.letterbox import InputBuffer
from autolights.train.deliver import export, heads
from autolights.train.deliver.export import export_onnx
from autolights.train.network.model import YoloV5

SIZE_WH = (96, 64)
ROWS = 3 * (12 * 8 + 6 * 4 + 3 * 2)


def ports(proto):
    return {
        port.name: [d.dim_param or d.dim_value for d in port.type.tensor_type.shape.dim]
        for port in (*proto.graph.input, *proto.graph.output)
    }


@pytest.mark.parametrize("head", ["raw", "end2end"])
def test_runtime_detector_says_what_the_network_says(model, photo, tmp_path, head):
    report = export_onnx(model, tmp_path / "model.onnx", size_wh=SIZE_WH, head=head, images=[photo])
    blob = np.empty((1, 3, SIZE_WH[1], SIZE_WH[0]), dtype=np.float32)
    letterbox = InputBuffer(SIZE_WH).fill(photo, blob[0])
    with torch.inference_mode():
        raw = model(torch.from_numpy(blob))[0].numpy()
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
    assert len(proto.graph.node) <= 220  # the public exporter makes 263
    shapes = {value.name: [d.dim_value for d in value.type.tensor_type.shape.dim] for value in proto.graph.value_info}
    assert {name for node in proto.graph.node for name in node.output} - {"output"} == set(shapes)
    assert all(all(shape) for shape in shapes.values())
    assert ports(proto) == {"images": [1, 3, 64, 96], "output": [1, ROWS, 8]}
    properties = {entry.key: entry.value for entry in proto.metadata_props}
    assert json.loads(properties["names"]) == list(model.classes)
    assert (properties["size_wh"], properties["head"], properties["precision"]) == ("[96, 64]", "raw", "fp32")
    assert load_model_info(report.path) == report.info
    assert (report.info.classes, report.info.size_wh, report.info.opset) == (model.classes, SIZE_WH, 17)
    assert (report.info.score_threshold, report.info.initial_weights) == (0.3, weights)
    assert report.info.training == {"ap": 0.5}


@pytest.mark.parametrize("dynamic", ["fixed", "batch", "size", "batch and size"])
@pytest.mark.parametrize("head", ["raw", "end2end", "efficient-nms"])
def test_every_head_at_every_freedom(model, photo, tmp_path, head, dynamic):
    size_wh = (128, 96)
    report = export_onnx(
        model,
        tmp_path / "model.onnx",
        size_wh=size_wh,
        head=head,
        dynamic_batch="batch" in dynamic,
        dynamic_size="size" in dynamic,
        max_detections=20,
        images=[photo],
    )

    proto = onnx.load(report.path)
    batch = "batch" if "batch" in dynamic else 1
    rows = "rows" if "size" in dynamic else 3 * (16 * 12 + 8 * 6 + 4 * 3)
    assert ports(proto) == {
        "images": [batch, 3, *(("height", "width") if "size" in dynamic else (96, 128))],
        **{
            "raw": {"output": [batch, rows, 8]},
            "end2end": {
                "boxes": [batch, 20, 4],
                "scores": [batch, 20],
                "classes": [batch, 20],
                "class_probs": [batch, 20, 3],
            },
            "efficient-nms": {
                "num_detections": [batch, 1],
                "detection_boxes": [batch, 20, 4],
                "detection_scores": [batch, 20],
                "detection_classes": [batch, 20],
            },
        }[head],
    }
    sizes = {tuple(shape[2:]) for shape in report.info.parity["inputs"]}
    batches = {shape[0] for shape in report.info.parity["inputs"]}
    assert sizes == ({(96, 128), (96, 96)} if "size" in dynamic else {(96, 128)})
    assert batches == ({1, 3} if "batch" in dynamic else {1})
    assert report.info.parity["detections"] > 10
    assert report.info.parity["agreement"] > 0.9
    assert (report.info.dynamic_batch, report.info.dynamic_size) == ("batch" in dynamic, "size" in dynamic)
    operators = {node.op_type for node in proto.graph.node}
    assert not {"Identity", "Constant", "If", "Loop", "NonMaxSuppression", "BatchNormalization"} & operators
    assert dynamic in ("size", "batch and size") or not {"Shape", "Range", "Expand"} & operators


def test_suppression_of_full_tensorrt_is_told_all_it_needs(model, tmp_path):
    report = export_onnx(
        model,
        tmp_path / "model.onnx",
        size_wh=SIZE_WH,
        head="efficient-nms",
        score_threshold=0.3,
        nms_iou_threshold=0.45,
        max_detections=50,
    )

    proto = onnx.load(report.path)
    (node,) = (node for node in proto.graph.node if node.domain == "TRT")
    attributes = {a.name: onnx.helper.get_attribute_value(a) for a in node.attribute}
    assert node.op_type == "EfficientNMS_TRT"
    assert attributes.pop("score_threshold") == pytest.approx(0.3)
    assert attributes.pop("iou_threshold") == pytest.approx(0.45)
    assert attributes == {
        "plugin_version": b"1",
        "max_output_boxes": 50,
        "background_class": -1,
        "score_activation": 0,
        "class_agnostic": 1,
        "box_coding": 1,
    }
    shapes = {value.name: [d.dim_value for d in value.type.tensor_type.shape.dim] for value in proto.graph.value_info}
    assert [shapes[name] for name in node.input] == [[1, ROWS, 4], [1, ROWS, 3]]
    with pytest.raises(onnxruntime.capi.onnxruntime_pybind11_state.Fail, match="EfficientNMS_TRT"):
        onnxruntime.InferenceSession(str(report.path), providers=["CPUExecutionProvider"])


def test_a_fine_level_is_exported_too(fine_model, photo, tmp_path):
    report = export_onnx(fine_model, tmp_path / "model.onnx", size_wh=SIZE_WH, images=[photo])

    assert ports(onnx.load(report.path))["output"] == [1, ROWS + 3 * 24 * 16, 7]
    assert report.info.parity["detections"] > 10


def test_a_small_input_has_no_more_detections_than_rows(model, tmp_path):
    report = export_onnx(model, tmp_path / "model.onnx", size_wh=(32, 32), head="end2end")

    assert report.info.max_detections == 63
    assert ports(onnx.load(report.path))["scores"] == [1, 63]


def test_initial_weights_are_those_the_network_remembers(tmp_path):
    network = YoloV5("n", 1, ["light"])
    network.initial_weights = InitialWeights(name="yolov5n.pt", sha256="1" * 64, licence="AGPL-3.0")

    report = export_onnx(network.train(), tmp_path / "model.onnx", size_wh=(32, 32))

    assert report.info.initial_weights == network.initial_weights
    assert network.training


@pytest.mark.parametrize("head", ["raw", "end2end", "efficient-nms"])
def test_a_wrong_export_is_not_written(model, tmp_path, monkeypatch, head):
    right = heads._table_constants

    def larger(network):
        constants = right(network)
        constants[:, :, 4:6] *= 1.05
        return constants

    monkeypatch.setattr(heads, "_table_constants", larger)

    with pytest.raises(ParityError, match=r"differs from the network in .*detection_px .*; nothing was written"):
        export_onnx(model, tmp_path / "model.onnx", size_wh=SIZE_WH, head=head)

    assert list(tmp_path.iterdir()) == []


def test_suppression_that_stops_too_early_is_not_written(model, tmp_path, monkeypatch):
    monkeypatch.setattr(heads, "SUPPRESSION_ROUNDS", 1)

    with pytest.raises(ParityError, match="unmatched"):
        export_onnx(model, tmp_path / "model.onnx", size_wh=SIZE_WH, head="end2end")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        pytest.param({"size_wh": (640, 400)}, "must be multiples of 32 px, got 640x400", id="stride"),
        pytest.param({"size_wh": (0, 32)}, "must be multiples of 32 px, got 0x32", id="zero"),
        pytest.param({"size_wh": (-32, 32)}, "must be multiples of 32 px, got -32x32", id="negative"),
        pytest.param(
            {"size_wh": (64, 96), "head": "end2end", "dynamic_size": True},
            "and at least 96 px for a dynamic end2end head, got 64x96",
            id="few-candidates",
        ),
        pytest.param({"opset": 16}, "operator set must be one of 17 to 20, got 16", id="opset"),
        pytest.param({"half_io": True}, "need --precision fp16", id="half-io"),
    ],
)
def test_what_cannot_be_exported_says_why(model, tmp_path, options, text):
    with pytest.raises(UsageError, match=text):
        export_onnx(model, tmp_path / "model.onnx", **{"size_wh": SIZE_WH, **options})


def test_each_operator_set_is_written(model, tmp_path):
    for opset in export.OPSETS:
        report = export_onnx(model, tmp_path / f"{opset}.onnx", size_wh=SIZE_WH, head="end2end", opset=opset)

        assert {entry.domain: entry.version for entry in onnx.load(report.path).opset_import} == {"": opset}
        assert report.info.opset == opset
