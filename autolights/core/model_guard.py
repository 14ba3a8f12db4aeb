"""Look through an ONNX file before a runtime opens it: nothing in it may reach out of the file or be absurd.

A hash says that a bundle is whole, not who made it. What `autolights export` writes is plain: one graph of standard
operators with all weights inside. Everything else that ONNX can hold (data in other files, operators from libraries,
loops, functions, training graphs) is refused here, in one pass over the file that copies no weights. It needs no ONNX
package, which the runtime does not have.

References:
    https://github.com/onnx/onnx/blob/main/onnx/onnx.proto (field numbers)
"""

import hashlib
import math
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, TypeAlias

from autolights.core.errors import BundleError
from autolights.core.protobuf_wire import BYTES, Field, fields, integers

MAX_MODEL_BYTES = 512 * 2**20  # size x in fp32 has 347 MB
_MAX_NODES = 20_000  # far more than size x, quantised, has
_STANDARD_DOMAINS = ("", "ai.onnx")
_BITS = {1: 32, 2: 8, 3: 8, 4: 16, 5: 16, 6: 32, 7: 64, 9: 8, 10: 16, 11: 64, 12: 32, 13: 64, 16: 16}  # by data type
_Messages: TypeAlias = dict[int, list[Field]]


class _Model:
    GRAPH, TRAINING, FUNCTIONS, OPSETS = 7, 20, 25, 8


class _Graph:
    NODE, INITIALIZER, SPARSE = 1, 5, 15


class _Node:
    NAME, OPERATOR, ATTRIBUTE, DOMAIN = 3, 4, 5, 7


class _Attribute:
    TENSOR, GRAPH, TENSORS, GRAPHS, SPARSE, SPARSES = 5, 6, 10, 11, 22, 23


class _Tensor:
    DIMS, TYPE, NAME, RAW, EXTERNAL, LOCATION = 1, 2, 8, 9, 13, 14


class ModelContents(NamedTuple):
    """What was found in a model.

    Attributes:
        operators: How often each is used.
        opset: Of the standard operators; 0 if the file does not say.
        parameters: Values in all constant tensors.
    """

    operators: Counter[str]
    opset: int
    parameters: int


def read_model(path: Path, wanted_sha256: str = "") -> bytes:
    """The bytes of a model file in one go: what was hashed is what a runtime gets to see.

    Args:
        path: The ONNX file.
        wanted_sha256: What it must hash to; empty: anything.

    Raises:
        BundleError: If the file is missing, too large, or another one.
    """
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            data = file.read() if size <= MAX_MODEL_BYTES else b""
    except OSError as error:
        raise BundleError(f"{path}: no such model; make one with `autolights export` ({error.strerror})") from error
    if size > MAX_MODEL_BYTES:
        raise BundleError(
            f"{path}: the model has {size:,} bytes, more than the {MAX_MODEL_BYTES:,} that any size needs"
        )
    if wanted_sha256 and hashlib.sha256(data).hexdigest() != wanted_sha256:
        raise BundleError(f"{path}: its SHA-256 differs from the manifest's: altered or damaged since bundling")
    return data


def inspect_model(data: bytes | memoryview) -> ModelContents:
    """Check the bytes of an ONNX file.

    Raises:
        BundleError: If they are no ONNX model, or the model holds what an export never does; the text names the node
            or tensor. It does not name the file.
    """
    if len(data) > MAX_MODEL_BYTES:
        raise BundleError(f"the model has {len(data):,} bytes, more than the {MAX_MODEL_BYTES:,} that any size needs")
    try:
        return _inspect(_grouped(memoryview(data)))
    except (ValueError, UnicodeDecodeError) as error:
        raise BundleError(f"no ONNX model ({error})") from error


def _inspect(model: _Messages) -> ModelContents:
    for number, what in ((_Model.TRAINING, "a training graph"), (_Model.FUNCTIONS, "functions")):
        if number in model:
            raise BundleError(f"the model holds {what}, which no export has")
    if len(model.get(_Model.GRAPH, ())) != 1:
        raise ValueError(f"it holds {len(model.get(_Model.GRAPH, ()))} graphs instead of one")
    opset = 0
    for imported in model.get(_Model.OPSETS, ()):
        entry = _grouped(_message(imported))
        domain = _text(entry, 1)
        _check_domain(domain, "the model")
        opset = entry[2][-1].value if 2 in entry else 0
    graph = _grouped(_message(model[_Model.GRAPH][0]))
    if _Graph.SPARSE in graph:
        raise BundleError("the model holds sparse tensors, which no export has")
    nodes = graph.get(_Graph.NODE, [])
    if len(nodes) > _MAX_NODES:
        raise BundleError(f"the model has {len(nodes):,} nodes, more than the {_MAX_NODES:,} that any size needs")
    parameters = sum(_check_tensor(_grouped(_message(field))) for field in graph.get(_Graph.INITIALIZER, ()))
    operators: Counter[str] = Counter()
    for field in nodes:
        operator, values = _check_node(_grouped(_message(field)))
        operators[operator] += 1
        parameters += values
    return ModelContents(operators, opset, parameters)


def _check_node(node: _Messages) -> tuple[str, int]:
    """The operator, and how many constants its attributes hold."""
    operator, name = _text(node, _Node.OPERATOR), _text(node, _Node.NAME)
    where = f"node '{name}' ({operator})"
    _check_domain(_text(node, _Node.DOMAIN), where)
    values = 0
    for field in node.get(_Node.ATTRIBUTE, ()):
        attribute = _grouped(_message(field))
        if any(number in attribute for number in (_Attribute.GRAPH, _Attribute.GRAPHS)):
            raise BundleError(f"{where} holds a graph of its own (a loop or a branch), which no export has")
        if any(number in attribute for number in (_Attribute.SPARSE, _Attribute.SPARSES)):
            raise BundleError(f"{where} holds sparse tensors, which no export has")
        for number in (_Attribute.TENSOR, _Attribute.TENSORS):
            values += sum(_check_tensor(_grouped(_message(tensor)), where) for tensor in attribute.get(number, ()))
    return operator, values


def _check_tensor(tensor: _Messages, where: str = "") -> int:
    """How many values a tensor has, all of them in this file."""
    where = where or f"tensor '{_text(tensor, _Tensor.NAME)}'"
    if _Tensor.EXTERNAL in tensor or any(field.value for field in tensor.get(_Tensor.LOCATION, ())):
        raise BundleError(f"{where} keeps its data in another file; export again, weights belong into the model")
    dims = [size for field in tensor.get(_Tensor.DIMS, ()) for size in integers(field)]
    data_type = tensor[_Tensor.TYPE][-1].value if _Tensor.TYPE in tensor else 0
    if data_type not in _BITS:
        raise BundleError(f"{where} is of ONNX data type {data_type}, which no export uses")
    if any(size < 0 for size in dims):
        raise BundleError(f"{where} has a negative size {dims}")
    count = math.prod(dims)
    if _Tensor.RAW in tensor:
        stored_bytes = sum(len(field.content) for field in tensor[_Tensor.RAW])
        if stored_bytes * 8 != count * _BITS[data_type]:
            raise BundleError(f"{where} of size {dims} holds {stored_bytes} bytes of data")
    # Without raw data each value takes at least one byte in one of the typed fields.
    elif count > sum(len(field.content) or 1 for number in tensor for field in tensor[number]):
        raise BundleError(f"{where} of size {dims} does not hold that many values")
    return count


def _check_domain(domain: str, where: str) -> None:
    if domain not in _STANDARD_DOMAINS:
        raise BundleError(f"{where} uses operators of the domain '{domain}'; only ONNX's own are run")


def _grouped(message: memoryview) -> _Messages:
    """Fields by number."""
    grouped: _Messages = {}
    for field in fields(message):
        grouped.setdefault(field.number, []).append(field)
    return grouped


def _message(field: Field) -> memoryview:
    if field.wire_type != BYTES:
        raise ValueError(f"field {field.number} is no message")
    return field.content


def _text(message: _Messages, number: int) -> str:
    found: Iterator[Field] = reversed(message.get(number, []))
    return next((str(_message(field), "utf-8") for field in found), "")
