"""Which input shapes an engine is built for: the sizes that stay free have a smallest, a usual and a largest."""

from pathlib import Path
from typing import NamedTuple, TypeAlias

from autolights.core import ModelInfo
from autolights.infer.letterbox import STRIDE

MIN_DYNAMIC_SIDE = 96  # px; a square of it has 567 rows, enough candidates for suppression in the graph
MAX_BATCH = 8  # images at once: more cameras than a car has
Shape: TypeAlias = tuple[int, int, int, int]


class InputShapes(NamedTuple):
    """(B, 3, H, W) of an optimisation profile; all equal where nothing is free."""

    smallest: Shape
    usual: Shape
    largest: Shape


def input_shapes(info: ModelInfo) -> InputShapes:
    """From one to eight images; from the smallest size that the head takes to twice the described sides."""
    width, height = info.size_wh
    least = MIN_DYNAMIC_SIDE if info.head == "end2end" else STRIDE
    most_images = MAX_BATCH if info.dynamic_batch else 1
    if info.dynamic_size:
        return InputShapes((1, 3, least, least), (1, 3, height, width), (most_images, 3, 2 * height, 2 * width))
    return InputShapes((1, 3, height, width), (1, 3, height, width), (most_images, 3, height, width))


def is_dynamic(info: ModelInfo) -> bool:
    """Whether an engine needs an optimisation profile."""
    return info.dynamic_batch or info.dynamic_size


def trtexec_command(path: Path, info: ModelInfo) -> str:
    """The command that builds an engine on the target, with TensorRT 10 or 11.

    The types are written in the graph, so that TensorRT 10 is told to keep to them as 11 always does.
    """
    parts = ["trtexec", f"--onnx={path}", f"--saveEngine={path.with_suffix('.engine')}", "--stronglyTyped"]
    if is_dynamic(info):
        names = ("minShapes", "optShapes", "maxShapes")
        parts += [
            f"--{name}=images:{'x'.join(map(str, shape))}"
            for name, shape in zip(names, input_shapes(info), strict=True)
        ]
    return " ".join(parts)
