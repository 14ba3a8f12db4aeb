"""Networks whose output is known beforehand."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from autolights.core import ModelInfo


@pytest.fixture
def constant_model(tmp_path: Path) -> Callable[..., tuple[Path, ModelInfo]]:
    """Write a model that says the same of every image: (N, 5 + C) rows of the raw layout."""

    def make(rows, *, size_wh=(64, 32), classes=("3-red", "3-green"), **info) -> tuple[Path, ModelInfo]:
        raw = np.array(rows, dtype=np.float32).reshape(1, -1, 5 + len(classes))
        width, height = size_wh
        graph = helper.make_graph(
            [
                helper.make_node("ReduceMax", ["images"], ["brightest"], keepdims=0),
                helper.make_node("Mul", ["brightest", "zero"], ["nothing"]),
                helper.make_node("Add", ["raw", "nothing"], ["output"]),
            ],
            "constant",
            [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, height, width])],
            [helper.make_tensor_value_info("output", TensorProto.FLOAT, list(raw.shape))],
            [numpy_helper.from_array(raw, "raw"), numpy_helper.from_array(np.float32(0), "zero")],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        onnx.checker.check_model(model)
        path = tmp_path / "constant.onnx"
        onnx.save(model, path)
        return path, ModelInfo(classes=classes, size_wh=size_wh, opset=17, **info)

    return make
