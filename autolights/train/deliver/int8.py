"""A float graph in, an 8-bit one out that is known to see as well: calibrate, quantise, measure, choose."""

import tempfile
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import ModelProto

from autolights.core import Detections, FloatArray, ModelInfo
from autolights.core.errors import DataError, UsageError
from autolights.core.progress import say
from autolights.data.image_dataset import ImageDataset
from autolights.infer.letterbox import Letterbox
from autolights.train.deliver.calibration import Calibration, CalibrationImages, measure_ranges, model_input
from autolights.train.deliver.quantization import Int8Target, QuantizableModel
from autolights.train.deliver.sensitive_layers import LayerChoice, choose_float_layers, disagreement
from autolights.train.measure.metrics import DetectionMetrics
from autolights.train.measure.onnx_model import ExportedModel
from autolights.train.measure.validate import evaluate_detector

_HARM_IMAGES = 16  # on which each layer's harm is measured
_HARM_SCORE_THRESHOLD = 0.05


@dataclass(frozen=True)
class Int8Settings:
    """How a model is brought to 8 bits.

    Attributes:
        calibrate: Images from which ranges are taken; labels are not looked at.
        validate: Labelled images on which accuracy is measured, others than those.
        images: How many of `calibrate` are used, evenly spread.
        method: See `measure_ranges`.
        target: See `autolights.train.deliver.quantization`.
        max_ap50_drop: Largest loss of AP50, in [0, 1].
    """

    calibrate: ImageDataset
    validate: ImageDataset
    images: int = 200
    method: Calibration = "mse"
    target: Int8Target = "tensorrt"
    max_ap50_drop: float = 0.01


def quantize(proto: ModelProto, info: ModelInfo, settings: Int8Settings) -> tuple[ModelProto, dict[str, Any]]:
    """Bring a float32 graph to 8 bits; layers that suffer stay in float.

    Args:
        proto: Float32, with the head that `info` says.
        info: Its description; `precision` is not looked at.
        settings: See there.

    Returns:
        The quantised graph, and the figures before and after for `ModelInfo.accuracy`.

    Raises:
        UsageError: If the head yields nothing that could be measured, the data have other classes, or the float model
            finds nothing in them.
        AccuracyError: If more than `max_ap50_drop` is lost.
        DataError: If images do not decode.
    """
    if info.head == "efficient-nms":
        raise UsageError("8 bits are accepted by measured accuracy, and the head efficient-nms cannot be run here")
    with tempfile.TemporaryDirectory() as folder:
        bench = _Bench(proto, info.model_copy(update={"precision": "int8"}), settings, Path(folder))
        before = bench.evaluate_float()
        if not before.ap50 > 0:
            raise UsageError(
                f"the float model finds nothing in {settings.validate.root}, so a loss in 8 bits cannot be measured"
            )
        model = bench.model
        choice = choose_float_layers(
            {name: model.cost(name) for name in model.layers},
            bench.evaluate,
            bench.harm,
            float_ap50=before.ap50,
            max_drop=settings.max_ap50_drop,
        )
        after = choice.metrics
        say(f"AP50 {before.ap50:.4f} in float, {after.ap50:.4f} in 8 bits; AP {before.ap:.4f}, {after.ap:.4f}")
        return bench.quantized(choice.float_layers), _report(before, choice, settings)


class _Bench:
    """Makes and measures variants of one model."""

    def __init__(self, proto: ModelProto, info: ModelInfo, settings: Int8Settings, folder: Path) -> None:
        self.model = QuantizableModel(proto)
        self._proto = proto
        self._info = info
        self._settings = settings
        self._path = folder / "variant.onnx"
        self._ranges = measure_ranges(
            proto,
            self.model.tensors(settings.target),
            CalibrationImages(settings.calibrate, info, settings.images),
            settings.method,
        )

    def quantized(self, float_layers: Collection[str]) -> ModelProto:
        return self.model.quantize(self._settings.target, self._ranges, float_layers)

    def evaluate_float(self) -> DetectionMetrics:
        return self._evaluate(self._proto)

    def evaluate(self, float_layers: Collection[str]) -> DetectionMetrics:
        return self._evaluate(self.quantized(float_layers))

    def harm(self, layer: str) -> float:
        others = [name for name in self.model.layers if name != layer]
        return disagreement(self._wanted, self._detect(self.quantized(others)))

    def _evaluate(self, proto: ModelProto) -> DetectionMetrics:
        return evaluate_detector(
            self._opened(proto), self._settings.validate, score_threshold=self._info.score_threshold
        )

    def _detect(self, proto: ModelProto) -> list[Detections]:
        model = self._opened(proto)
        seen = []
        for blob, view in self._harm_inputs:
            ((_, reported),) = model.detect(blob, [view], score_threshold=_HARM_SCORE_THRESHOLD)
            seen.append(reported)
        return seen

    @cached_property
    def _harm_inputs(self) -> list[tuple[FloatArray, Letterbox]]:
        images = self._settings.validate
        indices = np.linspace(0, len(images) - 1, min(_HARM_IMAGES, len(images))).round().astype(int)
        inputs = []
        for i in indices.tolist():
            with suppress(DataError):  # a few images that do not decode were let pass
                inputs.append(model_input(images.read(i), self._info))
        return inputs

    @cached_property
    def _wanted(self) -> list[Detections]:
        return self._detect(self._proto)

    def _opened(self, proto: ModelProto) -> ExportedModel:
        onnx.save(proto, self._path)
        return ExportedModel(self._path, self._info)


def _report(before: DetectionMetrics, choice: LayerChoice, settings: Int8Settings) -> dict[str, Any]:
    return {
        "float": _figures(before),
        "int8": _figures(choice.metrics),
        "ap50_drop": round(before.ap50 - choice.metrics.ap50, 5),
        "max_ap50_drop": settings.max_ap50_drop,
        "target": settings.target,
        "calibration": settings.method,
        "calibration_images": min(settings.images, len(settings.calibrate)),
        **choice.to_json(),
    }


def _figures(metrics: DetectionMetrics) -> dict[str, Any]:
    return {**metrics.to_json(), "confusion": metrics.confusion.counts.tolist()}


def accuracy_as_text(accuracy: dict[str, Any]) -> str:
    """What `quantize` reports, for a person."""
    before, after = accuracy["float"], accuracy["int8"]
    lines = [
        f"{before['images']} images: AP50 {before['ap50']:.4f} -> {after['ap50']:.4f}, "
        f"AP {before['ap']:.4f} -> {after['ap']:.4f} in 8 bits",
        f"in float: {', '.join(accuracy['float_layers']) or 'no layer'}, boxes and scores",
    ]
    if accuracy["target"] == "tensorrt":
        lines.append(
            "for TensorRT and OpenVINO; ONNX Runtime is slower on it than in float, for that use --int8-for onnxruntime"
        )
    return "\n".join(lines)
