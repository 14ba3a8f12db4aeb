"""Models as the export writes them pass; those that reach out of the file, or could not be meant, do not."""

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from autolights.core import model_guard
from autolights.core.errors import BundleError
from autolights.core.model_guard import inspect_model


def plain_model() -> onnx.ModelProto:
    """Two operators and a weight."""
    weight = numpy_helper.from_array(np.ones((3, 4), dtype=np.float32), "weight")
    return helper.make_model(
        helper.make_graph(
            [
                helper.make_node("MatMul", ["x", "weight"], ["y"], name="product"),
                helper.make_node("Relu", ["y"], ["z"], name="positive"),
            ],
            "plain",
            [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 3])],
            [helper.make_tensor_value_info("z", TensorProto.FLOAT, [1, 4])],
            [weight],
        ),
        opset_imports=[helper.make_opsetid("", 17)],
    )


PLAIN = plain_model().SerializeToString()


def test_a_plain_model_passes() -> None:
    contents = inspect_model(PLAIN)

    assert (contents.operators, contents.opset, contents.parameters) == ({"MatMul": 1, "Relu": 1}, 17, 12)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.int8, np.int64, np.bool_])
def test_constants_of_every_type_that_is_exported(dtype) -> None:
    model = plain_model()
    model.graph.initializer.append(numpy_helper.from_array(np.zeros((2, 5), dtype=dtype), "constant"))
    model.graph.initializer.append(numpy_helper.from_array(np.array(1, dtype=dtype), "scalar"))

    assert inspect_model(model.SerializeToString()).parameters == 12 + 10 + 1


def test_typed_values_instead_of_raw_bytes_pass() -> None:
    model = plain_model()
    model.graph.initializer.append(helper.make_tensor("sizes", TensorProto.INT64, [3], [1, -1, 300]))
    model.graph.initializer.append(helper.make_tensor("scale", TensorProto.FLOAT, [2], [0.5, 2.0]))

    assert inspect_model(model.SerializeToString()).parameters == 12 + 3 + 2


def outside(model: onnx.ModelProto, location: str) -> None:
    weight = model.graph.initializer[0]
    weight.ClearField("raw_data")
    weight.data_location = TensorProto.EXTERNAL
    weight.external_data.add(key="location", value=location)


def hidden_in_an_attribute(model: onnx.ModelProto) -> None:
    secret = numpy_helper.from_array(np.zeros(2, dtype=np.float32))
    secret.data_location = TensorProto.EXTERNAL
    model.graph.node.append(helper.make_node("Constant", [], ["c"], name="constant", value=secret))


def with_a_loop(model: onnx.ModelProto) -> None:
    body = helper.make_graph([], "body", [], [])
    model.graph.node.append(helper.make_node("Loop", ["n", "c"], ["o"], name="endless", body=body))


def with_a_function(model: onnx.ModelProto) -> None:
    model.functions.append(helper.make_function("", "F", ["a"], ["b"], [], [helper.make_opsetid("", 17)]))


def giant(model: onnx.ModelProto) -> None:
    model.graph.initializer[0].dims[:] = [1 << 40, 1 << 40]


def giant_without_raw(model: onnx.ModelProto) -> None:
    giant(model)
    model.graph.initializer[0].ClearField("raw_data")


def negative(model: onnx.ModelProto) -> None:
    model.graph.initializer[0].dims[:] = [-3, -4]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param(lambda m: outside(m, "/etc/passwd"), "tensor 'weight' keeps its data", id="passwd"),
        pytest.param(lambda m: outside(m, "../weights"), "tensor 'weight' keeps its data in another", id="parent"),
        pytest.param(hidden_in_an_attribute, r"node 'constant' \(Constant\) keeps its data in another", id="attribute"),
        pytest.param(with_a_loop, r"node 'endless' \(Loop\) holds a graph of its own", id="loop"),
        pytest.param(with_a_function, "the model holds functions", id="function"),
        pytest.param(lambda m: m.training_info.add(), "a training graph", id="training"),
        pytest.param(lambda m: m.graph.sparse_initializer.add(), "sparse tensors", id="sparse"),
        pytest.param(giant, r"tensor 'weight' of size \[1099511627776, .* holds 48 bytes", id="giant"),
        pytest.param(giant_without_raw, "does not hold that many values", id="giant-without-data"),
        pytest.param(negative, r"negative size \[-3, -4\]", id="negative"),
        pytest.param(lambda m: m.opset_import.add(domain="evil", version=1), "the domain 'evil'", id="domain"),
        pytest.param(
            lambda m: setattr(m.graph.node[1], "domain", "com.microsoft"),
            r"node 'positive' \(Relu\) uses operators of the domain 'com.microsoft'",
            id="node-domain",
        ),
        pytest.param(lambda m: setattr(m.graph.initializer[0], "data_type", 99), "data type 99", id="data-type"),
        pytest.param(lambda m: m.ClearField("graph"), "0 graphs instead of one", id="no-graph"),
    ],
)
def test_what_no_export_writes_is_refused(change, message) -> None:
    model = plain_model()
    change(model)

    with pytest.raises(BundleError, match=message):
        inspect_model(model.SerializeToString())


def test_absurdly_large_models_are_refused(monkeypatch) -> None:
    monkeypatch.setattr(model_guard, "_MAX_NODES", 1)
    with pytest.raises(BundleError, match="2 nodes, more than the 1"):
        inspect_model(PLAIN)

    monkeypatch.setattr(model_guard, "MAX_MODEL_BYTES", 100)
    with pytest.raises(BundleError, match="more than the 100"):
        inspect_model(PLAIN)


@given(st.binary(max_size=400))
def test_random_bytes_are_refused_in_words(data: bytes) -> None:
    with pytest.raises(BundleError, match=r"model"):
        inspect_model(data)


@given(st.integers(0, len(PLAIN) - 1), st.binary(min_size=0, max_size=12), st.integers(0, 12))
def test_damaged_models_pass_or_are_refused_in_words(position: int, inserted: bytes, removed: int) -> None:
    damaged = PLAIN[:position] + inserted + PLAIN[position + removed :]
    try:
        contents = inspect_model(damaged)
    except BundleError:
        return
    assert contents.parameters <= len(damaged)


@pytest.mark.parametrize("length", [1, len(PLAIN) // 2, len(PLAIN) - 1])
def test_cut_off_models_are_refused(length: int) -> None:
    with pytest.raises(BundleError, match="no ONNX model"):
        inspect_model(PLAIN[:length])
