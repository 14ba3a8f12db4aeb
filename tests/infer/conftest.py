"""Networks whose output is known beforehand."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from autolights.core import ModelInfo

OPSET = 17
CELL = 8  # px
CHOSEN = 5  # of the end2end head


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
        return _saved(graph, tmp_path / "constant.onnx"), ModelInfo(
            classes=classes, size_wh=size_wh, opset=OPSET, **info
        )

    return make


@pytest.fixture
def spot_model(tmp_path: Path) -> Callable[..., tuple[Path, ModelInfo]]:
    """Write a model that finds bright spots: a box of one cell, objectness its brightest value, classes red and green.

    It takes every form that a `ModelInfo` can describe: heads raw and end2end (without suppression), half input and
    output, free batch and size.
    """

    def make(*, size_wh=(64, 32), **info) -> tuple[Path, ModelInfo]:
        described = ModelInfo(classes=("3-red", "3-green"), size_wh=size_wh, opset=OPSET, max_detections=CHOSEN, **info)
        name = "_".join(f"{key}-{value}" for key, value in {"spot": "", **info}.items())
        return _saved(_spot_graph(described), tmp_path / f"{name}.onnx"), described

    return make


def _spot_graph(info: ModelInfo) -> onnx.GraphProto:
    constants = {
        "zero": np.float32(0),
        "one": np.float32(1),
        "half": np.float32(0.5),
        "cell": np.float32(CELL),
        "axis_x": np.int64(3),
        "axis_y": np.int64(2),
        "axis_channel": np.array([1], dtype=np.int64),
        "flat": np.array([0, 7, -1], dtype=np.int64),
        "parts": np.array([1, 1, 1], dtype=np.int64),
    }
    node = helper.make_node
    nodes = [
        node("Cast", ["images"], ["pixels"], to=TensorProto.FLOAT),
        node("MaxPool", ["pixels"], ["cells"], kernel_shape=[CELL, CELL], strides=[CELL, CELL]),
        node("Split", ["cells", "parts"], ["red", "green", "blue"], axis=1),
        node("ReduceMax", ["cells"], ["objectness"], axes=[1], keepdims=1),
        node("Mul", ["objectness", "zero"], ["zeros"]),
        node("Add", ["zeros", "one"], ["ones"]),
        node("CumSum", ["ones", "axis_x"], ["right"]),
        node("Sub", ["right", "half"], ["middle_x"]),
        node("Mul", ["middle_x", "cell"], ["x"]),
        node("CumSum", ["ones", "axis_y"], ["bottom"]),
        node("Sub", ["bottom", "half"], ["middle_y"]),
        node("Mul", ["middle_y", "cell"], ["y"]),
        node("Mul", ["ones", "cell"], ["side"]),
        node("Concat", ["x", "y", "side", "side", "objectness", "red", "green"], ["maps"], axis=1),
        node("Reshape", ["maps", "flat"], ["columns"]),
        node("Transpose", ["columns"], ["raw"], perm=[0, 2, 1]),
    ]
    io_type = TensorProto.FLOAT16 if info.half_io else TensorProto.FLOAT
    batch = "B" if info.dynamic_batch else 1
    width, height = info.size_wh
    size = ["H", "W"] if info.dynamic_size else [height, width]
    if info.head == "raw":
        count = "N" if info.dynamic_size else width * height // CELL**2
        nodes.append(node("Cast", ["raw"], ["output"], to=io_type))
        outputs = {"output": [batch, count, 7]}
    else:
        constants |= {
            "k": np.array([CHOSEN], dtype=np.int64),
            "columns_of_raw": np.array([2, 2, 1, 2], dtype=np.int64),
            "last": np.array([2], dtype=np.int64),
            "seven": np.array([1, 1, 7], dtype=np.int64),
        }
        nodes += [
            node("Split", ["raw", "columns_of_raw"], ["centre", "sides", "object", "probs"], axis=2),
            node("ReduceMax", ["probs"], ["largest"], axes=[2], keepdims=0),
            node("Squeeze", ["object", "last"], ["object_flat"]),
            node("Mul", ["object_flat", "largest"], ["all_scores"]),
            node("TopK", ["all_scores", "k"], ["best", "which"], axis=1),
            node("Unsqueeze", ["which", "last"], ["which_rows"]),
            node("Expand", ["which_rows", "seven"], ["which_all"]),
            node("GatherElements", ["raw", "which_all"], ["chosen"], axis=1),
            node("Split", ["chosen", "columns_of_raw"], ["c", "s", "o", "p"], axis=2),
            node("Mul", ["s", "half"], ["halves"]),
            node("Sub", ["c", "halves"], ["low"]),
            node("Add", ["c", "halves"], ["high"]),
            node("Concat", ["low", "high"], ["corners"], axis=2),
            node("ArgMax", ["p"], ["best_class"], axis=2, keepdims=0),
            node("Cast", ["corners"], ["boxes"], to=io_type),
            node("Cast", ["best"], ["scores"], to=io_type),
            node("Cast", ["best_class"], ["classes"], to=io_type),
            node("Cast", ["p"], ["class_probs"], to=io_type),
        ]
        k = CHOSEN
        outputs = {"boxes": [batch, k, 4], "scores": [batch, k], "classes": [batch, k], "class_probs": [batch, k, 2]}
    return helper.make_graph(
        nodes,
        "spots",
        [helper.make_tensor_value_info("images", io_type, [batch, 3, *size])],
        [helper.make_tensor_value_info(name, io_type, shape) for name, shape in outputs.items()],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )


def _saved(graph: onnx.GraphProto, path: Path) -> Path:
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return path
