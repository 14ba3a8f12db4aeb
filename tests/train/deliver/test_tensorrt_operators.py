import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from autolights.core.errors import DataError
from autolights.train.deliver import onnx_file
from autolights.train.deliver.export import export_onnx
from autolights.train.deliver.tensorrt_operators import check_operators


def model_of(*nodes, opset=17, constants=()):
    graph = helper.make_graph(
        nodes,
        "graph",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 9])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, None)],
        [numpy_helper.from_array(np.array([value], dtype=np.int64), name) for name, value in constants],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)])


@pytest.mark.parametrize(
    ("model", "text"),
    [
        pytest.param(
            model_of(helper.make_node("Relu", ["x"], ["a"]), helper.make_node("Unique", ["a"], ["y"], name="odd")),
            r"node 'odd' uses Unique, which is not in TensorRT 10.15's list of operators \(https://",
            id="operator",
        ),
        pytest.param(
            model_of(helper.make_node("QLinearConv", ["x"] * 8, ["y"], name="c")),
            "uses QLinearConv",
            id="int8-operator",
        ),
        pytest.param(
            model_of(helper.make_node("Relu", ["x"], ["y"], name="r", domain="com.microsoft")),
            "node 'r' uses com.microsoft::Relu",
            id="domain",
        ),
        pytest.param(
            model_of(helper.make_node("EfficientNMS_TRT", ["x", "x"], ["y"], domain="other")),
            "other::EfficientNMS_TRT",
            id="plug-in-elsewhere",
        ),
        pytest.param(model_of(helper.make_node("Relu", ["x"], ["y"]), opset=8), r"operator set 8 .*9 to 24", id="old"),
        pytest.param(
            model_of(helper.make_node("TopK", ["x", "k"], ["y", "i"], name="t"), constants=[("k", 3841)]),
            "node 't': TopK must select a constant number of at most 3840",
            id="many",
        ),
        pytest.param(
            model_of(helper.make_node("TopK", ["x", "n"], ["y", "i"], name="t")), "constant number", id="unknown-count"
        ),
        pytest.param(
            model_of(helper.make_node("TopK", ["x", "k"], ["y", "i"], name="t", sorted=0), constants=[("k", 3)]),
            "must be sorted",
            id="unsorted",
        ),
    ],
)
def test_what_tensorrt_refuses_is_named(model, text):
    with pytest.raises(DataError, match=text):
        check_operators(model)


def test_published_operators_and_the_plug_in_pass():
    check_operators(
        model_of(
            helper.make_node("TopK", ["x", "k"], ["a", "i"], name="t"),
            helper.make_node("EfficientNMS_TRT", ["a", "a"], ["y"], domain="TRT"),
            constants=[("k", 3840)],
        )
    )


def test_an_export_with_another_operator_is_not_written(model, tmp_path, monkeypatch):
    tidy = onnx_file._tidy

    def with_det(graph):
        tidy(graph)
        graph.node.insert(0, onnx.helper.make_node("Det", ["images"], ["unused"], name="surprise"))

    monkeypatch.setattr(onnx_file, "_tidy", with_det)

    with pytest.raises(DataError, match="node 'surprise' uses Det"):
        export_onnx(model, tmp_path / "model.onnx", size_wh=(96, 64))

    assert list(tmp_path.iterdir()) == []
