"""What a network is: its size, its cost, and where a checkpoint's weights come from."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from autolights.core.model_info import InitialWeights
from autolights.train.network.complexity import gflops, parameter_count
from autolights.train.network.model import SIZES, Size, YoloV5
from autolights.train.network.weights import load_checkpoint, read_checkpoint, weights_path

_COCO_CLASSES = 80


@dataclass(frozen=True)
class NetworkInfo:
    """A network in figures.

    Attributes:
        size: n, s, m, l or x.
        classes: Their names.
        parameters: Numbers that training changes.
        fused_parameters: Those that are left once batch norms are folded into their convolutions.
        input_wh: Of the input that `gflops` is meant for, pixels.
        gflops: Floating-point operations for such an input, in thousand millions.
        strides: Pixels in a cell of each level.
        anchors_px: Per level (width, height) of its anchors.
        initial_weights: What the training of a checkpoint started from; None if from nothing, or for a bare size.
        epoch: How many epochs a checkpoint was trained; 0 if it does not tell.
        metrics: Figures of the validation after that epoch.
    """

    size: Size
    classes: tuple[str, ...]
    parameters: int
    fused_parameters: int
    input_wh: tuple[int, int]
    gflops: float
    strides: tuple[int, ...]
    anchors_px: tuple[tuple[tuple[float, float], ...], ...]
    initial_weights: InitialWeights | None = None
    epoch: int = 0
    metrics: dict[str, Any] | None = None

    def to_json(self) -> dict[str, Any]:
        """As JSON-ready values."""
        initial = self.initial_weights
        return {**asdict(self), "initial_weights": initial.model_dump() if initial else None}

    def to_text(self) -> str:
        """As lines for a terminal."""
        width, height = self.input_wh
        lines = [
            f"network     YOLOv5{self.size}, {len(self.classes)} classes",
            f"parameters  {self.parameters:,} ({self.fused_parameters:,} with batch norms folded in)",
            f"cost        {self.gflops:.2f} GFLOPs at {width}x{height}",
        ]
        for stride, anchors in zip(self.strides, self.anchors_px, strict=True):
            lines.append(f"stride {stride:<4} anchors {'  '.join(f'{w:.0f}x{h:.0f}' for w, h in anchors)} px")
        if self.metrics is not None:
            lines += [f"classes     {', '.join(self.classes)}", f"started     {_origin(self.initial_weights)}"]
            figures = [
                f"{name} {self.metrics[name]:.3f}" for name in ("ap", "ap50") if self.metrics.get(name) is not None
            ]
            lines.append(f"trained     {self.epoch} epochs" + (f"; {', '.join(figures)}" if figures else ""))
        return "\n".join(lines)


def describe_network(source: str, *, input_wh: tuple[int, int], class_count: int = _COCO_CLASSES) -> NetworkInfo:
    """Describe a network.

    Args:
        source: n, s, m, l or x for a bare size; ``base`` for the shipped checkpoint; or a checkpoint file.
        input_wh: Input that the cost is counted for; multiples of 32 pixels.
        class_count: Of a bare size.

    Raises:
        UsageError: If there is no such checkpoint.
        CheckpointError: If it cannot be read.
    """
    if source in SIZES:
        return _describe(YoloV5(source, class_count), input_wh)
    path: Path = weights_path(source)
    checkpoint = read_checkpoint(path)
    return _describe(load_checkpoint(path), input_wh, epoch=checkpoint.epoch, metrics=checkpoint.metrics)


def _describe(model: YoloV5, input_wh: tuple[int, int], **training: Any) -> NetworkInfo:
    return NetworkInfo(
        size=model.size,
        classes=model.classes,
        parameters=parameter_count(model),
        fused_parameters=parameter_count(model, fused=True),
        input_wh=input_wh,
        gflops=round(gflops(model, input_wh), 4),
        strides=model.strides,
        anchors_px=tuple(tuple((w, h) for w, h in level) for level in model.anchors_px.tolist()),
        initial_weights=model.initial_weights,
        **training,
    )


def _origin(initial: InitialWeights | None) -> str:
    return f"from {initial.name}, {initial.licence}" if initial else "from nothing"
