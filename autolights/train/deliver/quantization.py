"""8-bit models by static QDQ: which tensors of a float graph pass through 8 bits, written for the runtime in mind.

Two targets want two ways of writing:

- ``tensorrt``: weights and inputs of convolutions, symmetric and signed as TensorRT demands; all else stays in float,
  so that convolution, bias and SiLU remain one kernel. OpenVINO runs this form fastest too.
- ``onnxruntime``: unsigned activations, and everything between two quantised convolutions in 8 bits as well, because
  ONNX Runtime's CPU kernels are fast on exactly that. TensorRT refuses it.

Boxes and scores are always computed in float: a pixel coordinate does not fit into 8 bits.
"""

import re
from collections.abc import Collection, Mapping
from functools import cached_property
from typing import Literal, TypeAlias, cast

import numpy as np
import onnx
from onnx import ModelProto, NodeProto
from onnxruntime.quantization import CalibrationMethod, QDQQuantizer, QuantType
from onnxruntime.quantization.calibrate import TensorsData

Int8Target: TypeAlias = Literal["tensorrt", "onnxruntime"]

_PASSING = frozenset({"Sigmoid", "Mul", "Add", "Concat", "Resize", "MaxPool"})  # what lies between two convolutions


class QuantizableModel:
    """A float32 graph, seen as layers that can be quantised or not.

    Args:
        model: Float32, BatchNorm folded, constants as initializers or ``Constant`` nodes.

    Attributes:
        layers: Name of each layer → names of its convolutions: the blocks of the network by their names in the
            checkpoint, and the last convolution of each level of the detection head by itself.
    """

    def __init__(self, model: ModelProto) -> None:
        self._model = onnx.shape_inference.infer_shapes(model)
        for number, node in enumerate(self._model.graph.node):
            node.name = node.name or f"{node.op_type}_{number}"
        self._producers = {name: node for node in self._model.graph.node for name in node.output}
        self._constants = {tensor.name for tensor in self._model.graph.initializer}
        self._constants |= {name for node in self._nodes("Constant") for name in node.output}
        self.layers: dict[str, list[str]] = {}
        heads = 0
        for node in self._nodes("Conv"):
            if node.name in self._before_convolutions:
                name = _layer_name(node.name)
            else:
                name, heads = f"head.{heads}", heads + 1
            self.layers.setdefault(name, []).append(node.name)

    def tensors(self, target: Int8Target) -> list[str]:
        """Whose ranges `quantize` needs if no layer stays in float."""
        return sorted(self._activations(self._quantized_nodes(target, ()), target))

    def cost(self, layer: str) -> float:
        """Share of the network's multiplications that are done by a layer."""
        return sum(self._multiplications[name] for name in self.layers[layer]) / sum(self._multiplications.values())

    def quantize(
        self, target: Int8Target, ranges: Mapping[str, tuple[float, float]], float_layers: Collection[str] = ()
    ) -> ModelProto:
        """Write the model with 8-bit layers.

        Args:
            target: Who is to run it.
            ranges: Lowest and highest value of each of `tensors`.
            float_layers: Names of layers to leave as they are.

        Returns:
            A new model: QuantizeLinear and DequantizeLinear around what is quantised, weights per output channel.
        """
        model = ModelProto()
        model.CopyFrom(self._model)
        nodes = self._quantized_nodes(target, float_layers)
        if not nodes:
            return model
        signed = target == "tensorrt"
        quantizer = QDQQuantizer(
            model,
            per_channel=True,
            reduce_range=False,
            weight_qType=QuantType.QInt8,
            activation_qType=QuantType.QInt8 if signed else QuantType.QUInt8,
            tensors_range=_library_ranges(ranges),
            nodes_to_quantize=nodes,
            nodes_to_exclude=[],
            op_types_to_quantize=["Conv"] if signed else ["Conv", *sorted(_PASSING)],
            extra_options={
                "ActivationSymmetric": signed,
                "WeightSymmetric": True,
                "QuantizeBias": not signed,  # TensorRT refuses 32-bit integers as biases
                "OpTypesToExcludeOutputQuantization": ["Conv"] if signed else [],
            },
        )
        quantizer.quantize_model()
        quantizer.model.topological_sort()
        if signed:
            _read_float(quantizer.model.model, {name for layer in float_layers for name in self.layers[layer]})
        return cast(ModelProto, quantizer.model.model)

    def _nodes(self, op_type: str) -> list[NodeProto]:
        return [node for node in self._model.graph.node if node.op_type == op_type]

    @cached_property
    def _before_convolutions(self) -> set[str]:
        """Names of the nodes whose result reaches a convolution: all but the last of each level, and what follows."""
        found: set[str] = set()
        waiting = [node.input[0] for node in self._nodes("Conv")]
        while waiting:
            node = self._producers.get(waiting.pop())
            if node is not None and node.name not in found:
                found.add(node.name)
                waiting += node.input
        return found

    @cached_property
    def _multiplications(self) -> dict[str, int]:
        """By convolution, for the size that the model was traced with; a relative measure where the size is free."""
        shapes = {
            port.name: [dim.dim_value or 1 for dim in port.type.tensor_type.shape.dim]
            for port in self._model.graph.value_info
        }
        weights = {tensor.name: tensor.dims for tensor in self._model.graph.initializer}
        return {
            node.name: int(np.prod(weights[node.input[1]]) * np.prod(shapes.get(node.output[0], [1])[2:]))
            for node in self._nodes("Conv")
        }

    def _quantized_nodes(self, target: Int8Target, float_layers: Collection[str]) -> list[str]:
        convolutions = {name for layer, names in self.layers.items() if layer not in float_layers for name in names}
        if target == "tensorrt":
            return [node.name for node in self._nodes("Conv") if node.name in convolutions]
        # Between convolutions 8 bits pass on: an operator is quantised if all that it reads already is.
        names: list[str] = []
        tensors: set[str] = set()
        for node in self._model.graph.node:
            reads = [name for name in node.input if name and name not in self._constants]
            passes = node.op_type in _PASSING and node.name in self._before_convolutions and tensors.issuperset(reads)
            if node.name in convolutions or passes:
                names.append(node.name)
                tensors.update(node.output)
        return names

    def _activations(self, nodes: Collection[str], target: Int8Target) -> set[str]:
        """Tensors that get QDQ when `nodes` are quantised."""
        found: set[str] = set()
        for node in self._model.graph.node:
            if node.name in nodes:
                found.update(name for name in node.input if name and name not in self._constants)
                found.update(() if target == "tensorrt" else node.output)
        return found


def _read_float(model: ModelProto, convolutions: Collection[str]) -> None:
    """Let convolutions in float read the float tensor, where the library gives all readers the rounded one."""
    producers = {name: node for node in model.graph.node for name in node.output}
    for node in model.graph.node:
        source = producers.get(node.input[0]) if node.name in convolutions else None
        if source is not None and source.op_type == "DequantizeLinear":
            node.input[0] = producers[source.input[0]].input[0]


def _layer_name(node_name: str) -> str:
    """``/rows/model.4/cv1/conv/Conv`` → ``model.4``: the exporter writes the module's path before the operator."""
    found = re.search(r"(?:^|/)(model\.\d+|fine)/", node_name)
    return found.group(1) if found else node_name


def _library_ranges(ranges: Mapping[str, tuple[float, float]]) -> TensorsData:
    values = {name: (np.float32(low), np.float32(high)) for name, (low, high) in ranges.items()}
    return TensorsData(CalibrationMethod.MinMax, values)
