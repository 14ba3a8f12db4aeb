"""Which ONNX operators TensorRT's parser reads, as its authors publish it (``tensorrt_operators.json``)."""

from pathlib import Path
from typing import Any

from onnx import ModelProto, helper, numpy_helper

from autolights.core.errors import DataError
from autolights.core.json_files import read_json_object
from autolights.train.deliver.onnx_file import PLUGIN, PLUGIN_DOMAIN

_MAX_TOPK = 3840
_LIST = Path(__file__).with_name("tensorrt_operators.json")


def check_operators(proto: ModelProto) -> None:
    """Refuse what TensorRT would refuse on the target; its plug-in for suppression is the one exception.

    Raises:
        DataError: If a node's operator is not on the list, it selects more than TensorRT's TopK does, or the operator
            set is out of range; the text names node, operator and list.
    """
    published = read_json_object(_LIST)
    name = f"TensorRT {published['tensorrt']}'s list of operators"
    first, last = published["opsets"]
    opset = next(entry.version for entry in proto.opset_import if entry.domain in ("", "ai.onnx"))
    if not first <= opset <= last:
        raise DataError(f"operator set {opset} is out of the range of {name} ({first} to {last})")
    known = set(published["operators"])
    constants: dict[str, Any] = {tensor.name: tensor for tensor in proto.graph.initializer}
    for node in proto.graph.node:
        where = f"node '{node.name}'"
        if (node.op_type, node.domain) == (PLUGIN, PLUGIN_DOMAIN):
            continue
        if node.domain not in ("", "ai.onnx") or node.op_type not in known:
            operator = f"{node.domain}::{node.op_type}" if node.domain else node.op_type
            raise DataError(f"{where} uses {operator}, which is not in {name} ({published['source']})")
        if node.op_type == "TopK":
            count = constants.get(node.input[1])
            if count is None or numpy_helper.to_array(count).item() > _MAX_TOPK:
                raise DataError(f"{where}: TopK must select a constant number of at most {_MAX_TOPK} for TensorRT")
            if any(a.name == "sorted" and helper.get_attribute_value(a) != 1 for a in node.attribute):
                raise DataError(f"{where}: TopK must be sorted for TensorRT")
