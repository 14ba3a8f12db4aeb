"""Half precision: the network's weights and arithmetic in float16, decoding and suppression in float32.

The converters at hand (onnxruntime's and onnxconverter-common's) cast outputs through float16, which has no odd pixels
beyond 2048, and wrap each excepted node in casts of its own. Here the border is known: what leads to a convolution is
the network, what follows the last ones is the head.
"""

import copy
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np
import torch
from onnx import ModelProto, NodeProto, TensorProto, helper, numpy_helper
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval
from torch.overrides import TorchFunctionMode

from autolights.core import FloatArray, ModelInfo
from autolights.core.errors import UsageError
from autolights.train.network.model import Conv, YoloV5

LARGEST_EXACT_PX = 2048  # float16 holds every whole number up to here
_LARGEST = float(np.finfo(np.float16).max)


def to_half(proto: ModelProto, info: ModelInfo) -> ModelProto:
    """Turn a float32 graph into a half-precision one.

    Args:
        proto: As traced; it is changed.
        info: With `half_io` input and outputs become float16 too.

    Raises:
        UsageError: If a weight is beyond float16, or with `half_io` a side beyond its whole numbers.
    """
    if info.half_io and max(info.size_wh) > LARGEST_EXACT_PX:
        raise UsageError(
            f"half-precision outputs hold no whole pixels beyond {LARGEST_EXACT_PX}, "
            f"got an input of {info.size_wh[0]}x{info.size_wh[1]}; leave --half-io away"
        )
    graph = proto.graph
    network = _network_nodes(graph.node)
    weights = {tensor.name: tensor for tensor in graph.initializer if tensor.data_type == TensorProto.FLOAT}
    halves: dict[str, TensorProto] = {}
    produced = {name for node in network for name in node.output}
    nodes: list[NodeProto] = [] if info.half_io else [_cast("images", "images_half", TensorProto.FLOAT16)]
    widened: set[str] = set()
    for node in graph.node:
        inside = id(node) in {id(one) for one in network}
        for i, name in enumerate(node.input):
            if inside:
                if name == "images" and not info.half_io:
                    node.input[i] = "images_half"
                elif name in weights and not (node.op_type == "Resize" and i > 0):  # its scales are always float32
                    halves.setdefault(name, _as_half(weights[name]))
                    node.input[i] = halves[name].name
            elif name in produced:
                node.input[i] = f"{name}_float"
                if name not in widened:
                    widened.add(name)
                    nodes.append(_cast(name, f"{name}_float", TensorProto.FLOAT))
        nodes.append(node)
    if info.half_io:
        nodes += _narrow_ports(proto, nodes)
    used = {name for node in nodes for name in node.input}
    initializers = [tensor for tensor in (*graph.initializer, *halves.values()) if tensor.name in used]
    nodes = [copy.deepcopy(node) for node in nodes]
    del graph.node[:], graph.initializer[:]
    graph.node.extend(nodes)
    graph.initializer.extend(initializers)
    return proto


def half_arithmetic(model: YoloV5) -> Callable[[FloatArray], FloatArray]:
    """The network as a GPU runs it in float16: weights and the result of every operator are rounded, sums are not.

    ONNX Runtime on a CPU computes half-precision graphs in float32 and would not show what rounding or overflow do.

    Args:
        model: In eval mode; it is not changed.

    Returns:
        A function from (B, 3, H, W) to the decoded (B, N, 5 + C), both float32.
    """
    device = next(model.parameters()).device
    rounded = copy.deepcopy(model)
    for module in rounded.modules():
        if isinstance(module, Conv):
            module.conv = fuse_conv_bn_eval(module.conv, module.bn)
            module.bn = cast(nn.BatchNorm2d, nn.Identity())
    for module in rounded.modules():
        if isinstance(module, nn.Conv2d):
            for weights in module.parameters():
                weights.data = weights.data.half().float()

    def run(batch: FloatArray) -> FloatArray:
        images = torch.from_numpy(batch).to(device).half().float()
        with torch.inference_mode():
            with _RoundToHalf():
                maps = rounded.logits(images)
            return rounded.detect.decode(maps).cpu().numpy()

    return run


class _RoundToHalf(TorchFunctionMode):
    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: tuple[Any, ...] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        result = func(*args, **(kwargs or {}))
        if isinstance(result, Tensor) and result.dtype == torch.float32:
            with torch._C.DisableTorchFunction():
                return result.half().float()
        return result


def _network_nodes(nodes: Any) -> list[NodeProto]:
    """Every convolution and what leads to it, in order."""
    makers = {name: node for node in nodes for name in node.output}
    pending = [node for node in nodes if node.op_type == "Conv"]
    found: dict[int, NodeProto] = {}
    while pending:
        node = pending.pop()
        if id(node) not in found:
            found[id(node)] = node
            pending += [makers[name] for name in node.input if name in makers]
    return list(found.values())


def _cast(source: str, target: str, data_type: int) -> NodeProto:
    return helper.make_node("Cast", [source], [target], name=f"{target}_cast", to=data_type)


def _as_half(tensor: TensorProto) -> TensorProto:
    values = numpy_helper.to_array(tensor)
    largest = float(np.abs(values).max(initial=0.0))
    if not largest <= _LARGEST:
        raise UsageError(
            f"weights '{tensor.name}' reach {largest:.4g}, float16 ends at {_LARGEST:g}; export with --precision fp32"
        )
    return numpy_helper.from_array(values.astype(np.float16), f"{tensor.name}_half")


def _narrow_ports(proto: ModelProto, nodes: list[NodeProto]) -> list[NodeProto]:
    """Make input and float outputs float16; returns the casts behind the outputs."""
    casts = []
    proto.graph.input[0].type.tensor_type.elem_type = TensorProto.FLOAT16
    for port in proto.graph.output:
        if port.type.tensor_type.elem_type != TensorProto.FLOAT:
            continue
        port.type.tensor_type.elem_type = TensorProto.FLOAT16
        wide = f"{port.name}_float"
        for node in nodes:
            for names in (node.input, node.output):
                for i, name in enumerate(names):
                    if name == port.name:
                        names[i] = wide
        casts.append(_cast(wide, port.name, TensorProto.FLOAT16))
    return casts
