import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from autolights.core import ModelInfo
from autolights.train.deliver.calibration import measure_ranges
from autolights.train.deliver.onnx_file import finish, trace
from autolights.train.deliver.quantization import QuantizableModel

SIZE_WH = (96, 64)


def described(network, head="raw"):
    return ModelInfo(classes=network.classes, size_wh=SIZE_WH, head=head, opset=17)


@pytest.fixture(scope="module")
def nano(model):
    return QuantizableModel(trace(model, described(model)))


@pytest.fixture(scope="module")
def blobs():
    rng = np.random.default_rng(3)
    return [rng.random((1, 3, SIZE_WH[1], SIZE_WH[0]), dtype=np.float32) for _ in range(2)]


@pytest.fixture(scope="module")
def ranges(model, nano, blobs):
    return measure_ranges(trace(model, described(model)), nano.tensors("onnxruntime"), blobs, "minmax")


def producers(proto):
    return {name: node for node in proto.graph.node for name in node.output}


def constants(proto):
    return {tensor.name: numpy_helper.to_array(tensor) for tensor in proto.graph.initializer}


def run(proto, blob):
    return onnxruntime.InferenceSession(proto.SerializeToString()).run(None, {"images": blob})


def test_layers_are_the_blocks_of_the_network(model, fine_model, nano):
    convolutions = {0, *range(1, 11), 13, 14, 17, 18, 20, 21, 23}
    assert set(nano.layers) == {f"model.{i}" for i in convolutions} | {"head.0", "head.1", "head.2"}
    assert sum(map(len, nano.layers.values())) == 60
    assert sum(nano.cost(layer) for layer in nano.layers) == pytest.approx(1)
    # 6 x 6 x 3 x 16 at a quarter of the pixels; the first head 64 x 24 at a 64th
    assert nano.cost("model.0") / nano.cost("head.0") == pytest.approx(36 * 3 * 16 / 4 / (64 * 24 / 64))
    fine = QuantizableModel(trace(fine_model, described(fine_model)))
    assert {"fine", "head.3"} <= set(fine.layers)


@pytest.mark.parametrize("head", ["raw", "end2end"])
def test_tensorrt_gets_signed_inputs_and_weights_of_convolutions_alone(model, nano, ranges, head):
    info = described(model, head)
    proto = finish(QuantizableModel(trace(model, info)).quantize("tensorrt", ranges, ["head.0", "model.9"]), info)

    by_output, values = producers(proto), constants(proto)
    quantized = 0
    for node in proto.graph.node:
        sources = [by_output.get(name) for name in node.input]
        dequantized = [source is not None and source.op_type == "DequantizeLinear" for source in sources]
        if node.op_type == "Conv" and dequantized[0]:
            quantized += 1
            assert dequantized == [True, True, False]  # the bias stays in float
            weights = values[sources[1].input[0]]
            assert weights.dtype == np.int8
            assert values[sources[1].input[1]].shape == weights.shape[:1]
        elif node.op_type in ("Sigmoid", "Mul", "Resize", "Reshape"):
            assert not any(dequantized), node.name  # (additions and concatenations may read what a convolution reads)
        if node.op_type in ("DequantizeLinear", "QuantizeLinear"):
            zero_point = values[node.input[2]]
            assert zero_point.dtype == np.int8
            assert not zero_point.any()
    in_float = len(nano.layers["head.0"]) + len(nano.layers["model.9"])
    assert quantized == 60 - in_float


def test_onnx_runtime_finds_its_integer_kernels(model, nano, ranges, tmp_path):
    path = tmp_path / "int8.onnx"
    onnx.save(finish(nano.quantize("onnxruntime", ranges, ["head.0", "head.1", "head.2"]), described(model)), path)
    options = onnxruntime.SessionOptions()
    options.optimized_model_filepath = str(tmp_path / "optimised.onnx")
    options.log_severity_level = 3  # it warns that such a file is for this machine alone

    onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])

    kinds = [node.op_type for node in onnx.load(tmp_path / "optimised.onnx").graph.node]
    assert kinds.count("QLinearConv") == 57
    assert kinds.count("QLinearSigmoid") == 57
    assert kinds.count("QLinearMul") == 57
    assert kinds.count("QuantizeLinear") == 1  # of the image
    # What leaves for the head: three levels.
    assert kinds.count("DequantizeLinear") == 3
    assert path.stat().st_size < 0.4 * len(trace(model, described(model)).SerializeToString())


def test_operators_beside_a_float_layer_stay_in_float(nano, ranges):
    proto = nano.quantize("onnxruntime", ranges, [name for name in nano.layers if name != "model.3"])

    names = {name for node in proto.graph.node if node.op_type == "QuantizeLinear" for name in node.input[:1]}
    assert names == {
        "/rows/model.2/cv3/act/Mul_output_0",
        "/rows/model.3/conv/Conv_output_0",
        "/rows/model.3/act/Sigmoid_output_0",
        "/rows/model.3/act/Mul_output_0",
    }


@pytest.mark.parametrize("target", ["tensorrt", "onnxruntime"])
def test_all_layers_in_float_is_the_float_model(model, nano, ranges, blobs, target):
    proto = nano.quantize(target, ranges, list(nano.layers))

    np.testing.assert_array_equal(run(proto, blobs[0])[0], run(trace(model, described(model)), blobs[0])[0])


@pytest.mark.parametrize("target", ["tensorrt", "onnxruntime"])
def test_result_is_near_the_float_model(model, nano, ranges, blobs, target):
    (wanted,) = run(trace(model, described(model)), blobs[0])

    (got,) = run(nano.quantize(target, ranges, ["head.0", "head.1", "head.2"]), blobs[0])

    assert 0 < np.abs(got[..., 4:] - wanted[..., 4:]).mean() < 0.05


def test_one_convolution_against_the_definition():
    """y = sum of round(x / s_x) s_x times round(w / s_w) s_w, with one s_w for each output channel."""
    rng = np.random.default_rng(0)
    weights = (rng.normal(size=(2, 3, 1, 1)) * [[[[1.0]]], [[[20.0]]]]).astype(np.float32)
    bias = rng.normal(size=2).astype(np.float32)
    shape = [1, 3, 32, 32]
    graph = helper.make_graph(
        [helper.make_node("Conv", ["images", "w", "b"], ["out"])],
        "one",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("out", TensorProto.FLOAT, [1, 2, 32, 32])],
        [numpy_helper.from_array(weights, "w"), numpy_helper.from_array(bias, "b")],
    )
    x = rng.random(shape, dtype=np.float32) * 0.8
    proto = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)

    (got,) = run(QuantizableModel(proto).quantize("tensorrt", {"images": (0.0, 0.8)}), x)

    steps = 0.8 / 127
    scales = np.abs(weights).max(axis=(1, 2, 3), keepdims=True) / 127
    rounded = np.round(weights / scales) * scales
    wanted = np.einsum("oc,chw->ohw", rounded[:, :, 0, 0], np.round(x[0] / steps) * steps) + bias[:, None, None]
    np.testing.assert_allclose(got[0], wanted, atol=1e-4)
