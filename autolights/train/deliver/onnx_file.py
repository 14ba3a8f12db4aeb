"""From a head to a checked ONNX graph that tells what it is."""

import json
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path

import onnx
import torch
from onnx import GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

import autolights
from autolights.core import ModelInfo
from autolights.core.model_info import FORMAT_VERSION
from autolights.train.deliver.heads import build_head, row_count
from autolights.train.network.model import YoloV5

# Read by TensorRT 8.5 and later, 10 and 11 among them (operators.md of 10.15: 9 to 24), and by every ONNX Runtime since
# 1.12. All that the heads need is there; later sets bring nothing that these graphs use.
OPSET = 17
OPSETS = range(17, 21)  # up to the last that torch's TorchScript exporter writes
PLUGIN, PLUGIN_DOMAIN = "EfficientNMS_TRT", "TRT"  # the parser finds the plug-in by its name, whatever the domain
PLUGIN_INPUTS = ("nms_boxes", "nms_scores")


def trace(model: YoloV5, info: ModelInfo) -> ModelProto:
    """Write the network and its head as a float32 graph, constants folded.

    Args:
        model: In eval mode.
        info: Head, size, and what is dynamic.
    """
    device = next(model.parameters()).device
    width, height = info.size_wh
    outputs = {port.name: _free_axes(port) for port in _output_ports(model, info)}
    names = list(PLUGIN_INPUTS if info.head == "efficient-nms" else outputs)
    free = {"images": _free_axes(_input_port(info)), **{name: outputs.get(name, {}) for name in names}}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(), torch.no_grad():
        path = Path(folder) / "traced.onnx"
        # The exporter that is to replace it needs another package and folds fewer constants.
        warnings.filterwarnings("ignore", "You are using the legacy TorchScript-based ONNX export", DeprecationWarning)
        warnings.filterwarnings("ignore", "The feature will be removed", DeprecationWarning)
        torch.onnx.export(
            build_head(model, info).to(device).eval(),
            (torch.zeros(2 if info.dynamic_batch else 1, 3, height, width, device=device),),
            path,
            dynamo=False,
            opset_version=info.opset,
            input_names=["images"],
            output_names=names,
            dynamic_axes={name: axes for name, axes in free.items() if axes},
        )
        proto = onnx.load(path)
    _tidy(proto.graph)
    if info.head == "efficient-nms":
        _append_plugin(proto, info)
    del proto.graph.output[:], proto.graph.value_info[:]
    proto.graph.output.extend(_output_ports(model, info))
    return proto


def finish(proto: ModelProto, info: ModelInfo) -> ModelProto:
    """Write down in the model what it is, and check it: operators, types and shapes.

    Raises:
        onnx.checker.ValidationError: If it is no valid model.
        onnx.shape_inference.InferenceError: If a type or shape contradicts another.
    """
    facts = {
        "names": json.dumps(list(info.classes)),
        "size_wh": json.dumps(list(info.size_wh)),
        "head": info.head,
        "precision": info.precision,
        "format_version": str(FORMAT_VERSION),
        "program_version": autolights.__version__,
    }
    helper.set_model_props(proto, facts)
    onnx.checker.check_model(proto, full_check=True)
    return onnx.shape_inference.infer_shapes(proto, check_type=True, strict_mode=True, data_prop=True)


def without_plugin(proto: ModelProto) -> ModelProto:
    """The model up to the plug-in's node, whose inputs become the outputs: what ONNX Runtime can run of it."""
    cut = ModelProto()
    cut.CopyFrom(proto)
    (node,) = (node for node in cut.graph.node if node.op_type == PLUGIN)
    kept = [other for other in cut.graph.node if other != node and not set(other.input) & set(node.output)]
    del cut.graph.output[:], cut.graph.node[:]
    cut.graph.node.extend(kept)
    cut.graph.output.extend(helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in node.input)
    return cut


def _input_port(info: ModelInfo) -> ValueInfoProto:
    width, height = info.size_wh
    sides = ("height", "width") if info.dynamic_size else (height, width)
    return helper.make_tensor_value_info("images", TensorProto.FLOAT, (_batch(info), 3, *sides))


def _output_ports(model: YoloV5, info: ModelInfo) -> list[ValueInfoProto]:
    """Names, types and shapes of what the head yields."""
    batch, most, class_count = _batch(info), info.max_detections, len(info.classes)
    rows = "rows" if info.dynamic_size else row_count(info.size_wh, model.strides)
    heads: dict[str, dict[str, tuple[int, tuple[int | str, ...]]]] = {
        "raw": {"output": (TensorProto.FLOAT, (batch, rows, 5 + class_count))},
        "end2end": {
            "boxes": (TensorProto.FLOAT, (batch, most, 4)),
            "scores": (TensorProto.FLOAT, (batch, most)),
            "classes": (TensorProto.INT32, (batch, most)),
            "class_probs": (TensorProto.FLOAT, (batch, most, class_count)),
        },
        "efficient-nms": {
            "num_detections": (TensorProto.INT32, (batch, 1)),
            "detection_boxes": (TensorProto.FLOAT, (batch, most, 4)),
            "detection_scores": (TensorProto.FLOAT, (batch, most)),
            "detection_classes": (TensorProto.INT32, (batch, most)),
        },
    }
    return [helper.make_tensor_value_info(name, kind, shape) for name, (kind, shape) in heads[info.head].items()]


def _batch(info: ModelInfo) -> int | str:
    return "batch" if info.dynamic_batch else 1


def _free_axes(port: ValueInfoProto) -> dict[int, str]:
    return {axis: dim.dim_param for axis, dim in enumerate(port.type.tensor_type.shape.dim) if dim.dim_param}


def _append_plugin(proto: ModelProto, info: ModelInfo) -> None:
    """Put TensorRT's node for suppression behind boxes and scores."""
    node = helper.make_node(
        PLUGIN,
        PLUGIN_INPUTS,
        ["num_detections", "detection_boxes", "detection_scores", "detection_classes"],
        name="suppression",
        domain=PLUGIN_DOMAIN,
        plugin_version="1",
        score_threshold=info.score_threshold,
        iou_threshold=info.nms_iou_threshold,
        max_output_boxes=info.max_detections,
        background_class=-1,
        score_activation=0,  # the scores are probabilities already
        class_agnostic=1,
        box_coding=1,  # centre and sides
    )
    proto.graph.node.append(node)
    proto.opset_import.append(helper.make_opsetid(PLUGIN_DOMAIN, 1))


def _tidy(graph: GraphProto) -> None:
    """Make constants initializers, compute what depends on constants alone, and drop what no node reads."""
    constants = {tensor.name: tensor for tensor in graph.initializer}
    renamed: dict[str, str] = {}
    nodes = []
    for node in graph.node:
        for i, name in enumerate(node.input):
            node.input[i] = renamed.get(name, name)
        if node.op_type == "Identity" and node.output[0] not in {port.name for port in graph.output}:
            renamed[node.output[0]] = node.input[0]
        elif all(name in constants for name in node.input if name):
            constants.update(_computed(node, [constants[name] for name in node.input if name]))
        else:
            nodes.append(node)
    used = {name for node in nodes for name in node.input}
    del graph.node[:], graph.initializer[:]
    graph.node.extend(nodes)
    graph.initializer.extend(tensor for name, tensor in constants.items() if name in used)


def _computed(node: NodeProto, inputs: Sequence[TensorProto]) -> dict[str, TensorProto]:
    """The outputs of a node whose inputs are all constant."""
    values = ReferenceEvaluator(node).run(None, {t.name: numpy_helper.to_array(t) for t in inputs})
    return {name: numpy_helper.from_array(value, name) for name, value in zip(node.output, values, strict=True) if name}
