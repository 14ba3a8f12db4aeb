"""What goes into a model and what comes out, held against its description."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from autolights.core import ModelInfo
from autolights.core.errors import DataError, UsageError


@dataclass(frozen=True)
class Port:
    """An input or output of a model file.

    Attributes:
        name: In the graph.
        shape: None where a length is free.
        dtype: ``float32``, ``float16``, ...
    """

    name: str
    shape: tuple[int | None, ...]
    dtype: str


def check_ports(
    inputs: Sequence[Port], outputs: Sequence[Port], model_path: Path, info: ModelInfo
) -> tuple[str, tuple[str, ...]]:
    """Refuse a model that is not what its description says.

    Returns:
        Name of the input, and the names of the outputs that decoding wants, in its order: of a ``raw`` head the one
        there is, of an ``end2end`` head boxes, scores and class_probs.

    Raises:
        UsageError: If the head yields no class vectors.
        DataError: If an input or output differs from `info`.
    """
    width, height = info.size_wh
    batch = None if info.dynamic_batch else 1
    wanted: list[int | None] = [batch, 3, *((None, None) if info.dynamic_size else (height, width))]
    if len(inputs) != 1 or list(inputs[0].shape) != wanted:
        raise DataError(
            f"{model_path}: input must be {_shown(wanted)} as described, "
            f"got [{', '.join(_shown(port.shape) for port in inputs)}]; export again"
        )
    dtype = "float16" if info.half_io else "float32"
    if inputs[0].dtype != dtype:
        raise DataError(f"{model_path}: input must be {dtype} as described, got {inputs[0].dtype}; export again")
    return inputs[0].name, _output_names(outputs, model_path, info)


def _output_names(outputs: Sequence[Port], model_path: Path, info: ModelInfo) -> tuple[str, ...]:
    shapes = f"[{', '.join(_shown(port.shape) for port in outputs)}]"
    class_count = len(info.classes)
    if info.head == "raw":
        columns = 5 + class_count
        if len(outputs) != 1 or len(outputs[0].shape) != 3 or outputs[0].shape[2] != columns:
            raise DataError(
                f"{model_path}: output must be [{'B' if info.dynamic_batch else 1}, N, {columns}] "
                f"for {class_count} classes, got {shapes}; export again"
            )
        return (outputs[0].name,)
    if info.head == "end2end":
        by_name = {port.name: port for port in outputs}
        widths = {"boxes": (4,), "scores": (), "class_probs": (class_count,)}
        for name, tail in widths.items():
            if name not in by_name:
                raise DataError(
                    f"{model_path}: an end2end model has the outputs boxes, scores, classes and class_probs, "
                    f"got {', '.join(by_name)}; export again"
                )
            if len(by_name[name].shape) != 2 + len(tail) or by_name[name].shape[2:] != tail:
                raise DataError(
                    f"{model_path}: output {name} must be {_shown([None, None, *tail])} for {class_count} classes, "
                    f"got {_shown(by_name[name].shape)}; export again"
                )
        return tuple(widths)
    raise UsageError(
        f"{model_path}: its head '{info.head}' is for programs that call TensorRT themselves and yields no class "
        "vectors; export with --head raw or --head end2end"
    )


def _shown(shape: Sequence[int | None]) -> str:
    """Free lengths as a question mark."""
    return f"[{', '.join('?' if length is None else str(length) for length in shape)}]"
