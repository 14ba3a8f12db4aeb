import copy
from collections import Counter

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto

from autolights.core.errors import ParityError, UsageError
from autolights.infer import Detector
from autolights.train.deliver import half_precision
from autolights.train.deliver.export import export_onnx
from autolights.train.deliver.half_precision import half_arithmetic

SIZE_WH = (320, 192)


def types(proto):
    inferred = onnx.shape_inference.infer_shapes(proto, check_type=True, strict_mode=True)
    values = (*inferred.graph.value_info, *inferred.graph.input, *inferred.graph.output)
    return {
        **{value.name: value.type.tensor_type.elem_type for value in values},
        **{tensor.name: tensor.data_type for tensor in proto.graph.initializer},
    }


@pytest.mark.parametrize("half_io", [False, True], ids=["float-io", "half-io"])
@pytest.mark.parametrize("head", ["raw", "end2end", "efficient-nms"])
def test_network_is_half_and_the_head_is_not(base, street, tmp_path, head, half_io):
    report = export_onnx(
        base,
        tmp_path / "model.onnx",
        size_wh=SIZE_WH,
        head=head,
        precision="fp16",
        half_io=half_io,
        dynamic_batch=True,
        images=[street],
    )

    proto = onnx.load(report.path)
    kinds = types(proto)
    for node in proto.graph.node:
        if node.op_type in ("Conv", "MaxPool"):
            assert {kinds[name] for name in (*node.input, *node.output)} == {TensorProto.FLOAT16}
        if node.op_type in ("TopK", "ReduceMax", "Split", "EfficientNMS_TRT"):
            assert kinds[node.input[0]] == TensorProto.FLOAT
    outputs = {port.name: port.type.tensor_type.elem_type for port in proto.graph.output}
    integers = {name for name, kind in outputs.items() if kind == TensorProto.INT32}
    assert (
        integers
        == {
            "raw": set(),
            "end2end": {"classes"},
            "efficient-nms": {"num_detections", "detection_classes"},
        }[head]
    )
    io_type = TensorProto.FLOAT16 if half_io else TensorProto.FLOAT
    assert kinds["images"] == io_type
    assert {outputs[name] for name in set(outputs) - integers} == {io_type}
    levels = 4
    casts = Counter(node.op_type for node in proto.graph.node)["Cast"]
    in_float = Counter(node.op_type for node in onnx.load(_float(base, tmp_path, head)).graph.node)["Cast"]
    assert casts - in_float == levels + (len(set(outputs) - integers) if half_io else 1)
    assert report.info.parity["detections"] > 15
    assert report.info.parity["half_arithmetic"]["detections"] == report.info.parity["detections"]
    assert (report.info.precision, report.info.half_io) == ("fp16", half_io)


def _float(network, tmp_path, head):
    return export_onnx(network, tmp_path / "float.onnx", size_wh=SIZE_WH, head=head, dynamic_batch=True).path


def test_half_file_is_half_the_size_and_runs(base, street, tmp_path):
    half = export_onnx(base, tmp_path / "half.onnx", size_wh=SIZE_WH, precision="fp16", half_io=True)
    single = export_onnx(base, tmp_path / "single.onnx", size_wh=SIZE_WH)

    assert half.path.stat().st_size < 0.55 * single.path.stat().st_size
    found, wanted = Detector(half.path, half.info)(street), Detector(single.path, single.info)(street)
    assert abs(len(found) - len(wanted)) <= 1
    assert len(wanted) > 5


def test_half_arithmetic_rounds_each_result(base, street):
    images = np.ascontiguousarray(street[None, :, :, ::-1].transpose(0, 3, 1, 2), dtype=np.float32) / 255

    with half_precision._RoundToHalf():
        total = torch.tensor(2048.0) + 1.0
    rows = half_arithmetic(base)(images)

    assert total == 2048
    with torch.inference_mode():
        wanted = base(torch.from_numpy(images)).numpy()
    assert 1e-5 < np.abs(rows[..., 4] - wanted[..., 4]).max() < 0.05
    assert not any(isinstance(module.bn, torch.nn.Identity) for module in base.modules() if hasattr(module, "bn"))


def test_a_network_beyond_half_is_refused(base, tmp_path):
    loud = copy.deepcopy(base)
    loud.model[0].bn.weight.data *= 1e9
    with pytest.raises(UsageError, match=r"weights '.*' reach .*, float16 ends at 65504; export with --precision fp32"):
        export_onnx(loud, tmp_path / "model.onnx", size_wh=SIZE_WH, precision="fp16")

    overflowing = copy.deepcopy(base)
    overflowing.model[0].bn.weight.data *= 1e4
    overflowing.model[1].bn.weight.data *= 1e4
    with pytest.raises(ParityError, match=r"nothing was written"):
        export_onnx(overflowing, tmp_path / "model.onnx", size_wh=SIZE_WH, precision="fp16")

    assert list(tmp_path.iterdir()) == []


def test_outputs_in_half_hold_no_pixels_beyond_2048(base, tmp_path):
    with pytest.raises(UsageError, match="no whole pixels beyond 2048, got an input of 2080x64; leave --half-io away"):
        export_onnx(base, tmp_path / "model.onnx", size_wh=(2080, 64), precision="fp16", half_io=True)
