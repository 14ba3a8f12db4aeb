import sys

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from autolights.core import ModelInfo, parse_config
from autolights.core.errors import ConfigError, DataError, UsageError
from autolights.infer import Detector, Execution, OnnxSession
from autolights.infer.openvino_session import OpenVinoSession

pytest.importorskip("openvino", reason="needs autolights[openvino]")
pytestmark = pytest.mark.alone


@pytest.fixture
def random_network(tmp_path):
    """Six convolutions with SiLU, random weights: what rounding to 16 bits would show in."""
    random = np.random.default_rng(0)
    nodes, weights, last = [], [], "images"
    for i, (channels, wanted) in enumerate([(3, 16), (16, 32), (32, 32), (32, 32), (32, 32), (32, 7)]):
        kernel = random.normal(0, (2.0 / (9 * channels)) ** 0.5, (wanted, channels, 3, 3)).astype(np.float32)
        weights.append(numpy_helper.from_array(kernel, f"w{i}"))
        nodes.append(helper.make_node("Conv", [last, f"w{i}"], [f"c{i}"], pads=[1, 1, 1, 1], strides=[1 + i % 2] * 2))
        nodes.append(helper.make_node("Sigmoid", [f"c{i}"], [f"s{i}"]))
        nodes.append(helper.make_node("Mul", [f"c{i}", f"s{i}"], [f"a{i}"]))
        last = f"a{i}"
    weights.append(numpy_helper.from_array(np.array([1, 7, -1]), "flat"))
    nodes.append(helper.make_node("Reshape", [last, "flat"], ["columns"]))
    nodes.append(helper.make_node("Transpose", ["columns"], ["output"], perm=[0, 2, 1]))
    graph = helper.make_graph(
        nodes,
        "random",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, 64, 96])],
        [helper.make_tensor_value_info("output", TensorProto.FLOAT, [1, 96, 7])],
        weights,
    )
    path = tmp_path / "random.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path, ModelInfo(classes=("red", "green"), size_wh=(96, 64), opset=17)


def test_computes_what_onnx_runtime_computes(random_network):
    blob = np.random.default_rng(1).random((1, 3, 64, 96), dtype=np.float32)

    (wanted,) = OnnxSession(*random_network, threads=1).run(blob)
    (got,) = OpenVinoSession(*random_network, threads=1).run(blob)

    assert np.abs(wanted).max() > 0.3
    np.testing.assert_allclose(got, wanted, atol=2e-5)


def test_bfloat16_only_where_it_is_asked_for(random_network):
    blob = np.random.default_rng(1).random((1, 3, 64, 96), dtype=np.float32)

    (wanted,) = OnnxSession(*random_network, threads=1).run(blob)
    (got,) = OpenVinoSession(*random_network, threads=1, bfloat16=True).run(blob)

    np.testing.assert_allclose(got, wanted, atol=0.05)  # equal on a CPU that has no bfloat16


@pytest.mark.parametrize("head", ["raw", "end2end"])
@pytest.mark.parametrize("half_io", [False, True])
@pytest.mark.parametrize("free", [False, True])
def test_detects_what_onnx_runtime_detects(spot_model, head, half_io, free):
    model = spot_model(size_wh=(192, 96), head=head, half_io=half_io, dynamic_batch=free, dynamic_size=free)
    images = [np.zeros((96, 192, 3), np.uint8), np.zeros((192, 192, 3), np.uint8)]
    images[0][9:13, 33:37, 1] = 200
    images[0][17:21, 9:13, 2] = 170
    images[1][40:44, 8:12, 2] = 250

    wanted = Detector(*model, Execution(threads=1)).batch(images)
    found = Detector(*model, Execution(backend="openvino", threads=2, streams=2)).batch(images)

    for a, b in zip(found, wanted, strict=True):
        assert len(b)
        np.testing.assert_array_equal(a.boxes_xyxy, b.boxes_xyxy)
        np.testing.assert_array_equal(a.class_probs, b.class_probs)


def test_bad_models(constant_model, tmp_path):
    path, info = constant_model([[32, 16, 10, 20, 0.9, 0.8, 0.1]])
    (tmp_path / "broken.onnx").write_bytes(b"not a protobuf")

    with pytest.raises(UsageError, match=r"gone\.onnx: no such model"):
        OpenVinoSession(tmp_path / "gone.onnx", info)
    with pytest.raises(DataError, match=r"broken\.onnx: OpenVINO cannot read it \(.+\)"):
        OpenVinoSession(tmp_path / "broken.onnx", info)
    with pytest.raises(DataError, match=r"input must be \[1, 3, 416, 640\] as described"):
        OpenVinoSession(path, info.model_copy(update={"size_wh": (640, 416)}))


def test_without_the_package(constant_model, monkeypatch):
    monkeypatch.setitem(sys.modules, "openvino", None)

    with pytest.raises(UsageError, match=r"pip install 'autolights\[openvino\]'"):
        OpenVinoSession(*constant_model([[32, 16, 10, 20, 0.9, 0.8, 0.1]]))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"backend": "openvino", "providers": ["CUDAExecutionProvider"]},
            "providers and spin_us are choices of the backend",
        ),
        ({"bfloat16": True}, "bfloat16 is a choice of the backend 'openvino'"),
    ],
)
def test_choices_that_do_not_go_together(values, message):
    with pytest.raises(ConfigError, match=message):
        parse_config(values, Execution, source="execution")
