"""Export a network to ONNX, checked number by number against the network it came from."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx
from onnx import ModelProto

from autolights.core import ImageArray, InitialWeights, ModelInfo
from autolights.core.atomic import new_file
from autolights.core.errors import UsageError
from autolights.core.model_info import Head, Precision
from autolights.train.deliver.half_precision import half_arithmetic, to_half
from autolights.train.deliver.heads import candidate_count
from autolights.train.deliver.int8 import Int8Settings, quantize
from autolights.train.deliver.onnx_file import OPSET, OPSETS, finish, trace
from autolights.train.deliver.parity import TOLERANCES, compare, onnx_run
from autolights.train.deliver.tensorrt_operators import check_operators
from autolights.train.deliver.tensorrt_shapes import MIN_DYNAMIC_SIDE
from autolights.train.network.model import MAX_STRIDE, YoloV5


@dataclass(frozen=True)
class ExportReport:
    """What was exported: the file, and its description with the parity figures."""

    path: Path
    info: ModelInfo


def export_onnx(
    model: YoloV5,
    path: Path,
    *,
    size_wh: tuple[int, int],
    head: Head = "raw",
    precision: Precision = "fp32",
    int8: Int8Settings | None = None,
    half_io: bool = False,
    dynamic_batch: bool = False,
    dynamic_size: bool = False,
    opset: int = OPSET,
    score_threshold: float = 0.25,
    nms_iou_threshold: float = 0.5,
    max_detections: int = 100,
    initial_weights: InitialWeights | None = None,
    training: Mapping[str, Any] | None = None,
    images: Sequence[ImageArray] = (),
) -> ExportReport:
    """Write ``model.onnx``, and its `ModelInfo` as JSON beside it.

    Both files appear only if ONNX Runtime agrees with the network on two random images and the given ones, at more than
    one batch and size where these are free. A model in 8 bits is made of a float one that agrees, and must see nearly
    as well.

    Args:
        model: The network; it is put into eval mode for the time being.
        path: Of the ONNX file; the description gets the ending ``.json``.
        size_wh: Input width and height in pixels, multiples of 32; with `dynamic_size` the size that it is meant for.
        head: What comes out, see `ModelInfo`.
        precision: Of weights and arithmetic.
        int8: How 8 bits are reached and accepted; needed by that precision.
        half_io: Input and outputs are float16.
        dynamic_batch: Any number of images at once instead of one.
        dynamic_size: Any multiples of 32 instead of one size.
        opset: ONNX operator set.
        score_threshold: Of the runtime, and of TensorRT's plug-in.
        nms_iou_threshold: Of suppression.
        max_detections: The most lights of an image.
        initial_weights: What the training started from, if the network itself does not say.
        training: Figures of the training run for the manifest.
        images: BGR images, of any size, on which parity is checked as well.

    Raises:
        UsageError: If a choice does not fit the network or another choice.
        DataError: If TensorRT does not know an operator of the graph.
        ParityError: If the model differs from the network.
        AccuracyError: If too much is lost in 8 bits.
    """
    info = ModelInfo(
        classes=model.classes,
        size_wh=_checked_size(size_wh, head, dynamic_size),
        head=head,
        precision=precision,
        half_io=half_io,
        dynamic_batch=dynamic_batch,
        dynamic_size=dynamic_size,
        opset=opset,
        score_threshold=score_threshold,
        nms_iou_threshold=nms_iou_threshold,
        max_detections=max_detections,
        initial_weights=initial_weights or model.initial_weights,
        training=dict(training or {}),
    )
    if opset not in OPSETS:
        raise UsageError(f"the operator set must be one of {OPSETS.start} to {OPSETS.stop - 1}, got {opset}")
    if (precision == "int8") != (int8 is not None):
        raise UsageError("the precision int8 needs images to calibrate and measure on; no other does")
    if head == "end2end":
        most = min(max_detections, candidate_count(info, model.strides))
        info = info.model_copy(update={"max_detections": most})
    was_training = model.training
    model.eval()
    try:
        in_float = info.model_copy(update={"precision": "fp32"}) if int8 else info
        proto = in_precision(trace(model, in_float), in_float)
        check_operators(proto)
        with new_file(path) as model_file, new_file(path.with_suffix(".json")) as info_file:
            onnx.save(finish(proto, in_float), model_file)
            info = info.model_copy(update={"parity": _checked_parity(model, model_file, in_float, images)})
            if int8:
                proto, accuracy = quantize(proto, info, int8)
                check_operators(proto)
                onnx.save(finish(proto, info), model_file)
                info = info.model_copy(update={"accuracy": accuracy})
            info_file.write_text(json.dumps(info.model_dump(mode="json"), indent=1) + "\n", encoding="utf-8")
    finally:
        model.train(was_training)
    return ExportReport(path, info)


def _checked_parity(model: YoloV5, path: Path, info: ModelInfo, images: Sequence[ImageArray]) -> dict[str, Any]:
    parity = compare(model, onnx_run(path, info), info, images)
    parity.check(TOLERANCES[info.precision])
    figures = parity.to_json()
    if info.precision == "fp16":
        arithmetic = half_arithmetic(model)
        rows = info.model_copy(update={"head": "raw"})
        parity = compare(model, lambda batch: [arithmetic(batch)], rows, images)
        parity.check(TOLERANCES[info.precision], what="the network in half-precision arithmetic")
        figures["half_arithmetic"] = parity.to_json()
    return figures


def in_precision(proto: ModelProto, info: ModelInfo) -> ModelProto:
    """Turn a traced float32 graph into the precision that was asked for; checks, parity and files are the same for all.

    Raises:
        UsageError: If a choice does not fit the precision.
    """
    if info.precision == "fp32":
        if info.half_io:
            raise UsageError("half-precision inputs and outputs need --precision fp16")
        return proto
    if info.precision == "fp16":
        return to_half(proto, info)
    raise ValueError("8 bits need images: see `quantize`")


def _checked_size(size_wh: tuple[int, int], head: Head, dynamic_size: bool) -> tuple[int, int]:
    least = MIN_DYNAMIC_SIDE if dynamic_size and head == "end2end" else MAX_STRIDE
    width, height = size_wh
    if min(size_wh) < least or width % MAX_STRIDE or height % MAX_STRIDE:
        raise UsageError(
            f"the input size must be multiples of {MAX_STRIDE} px"
            + (f", and at least {least} px for a dynamic end2end head" if least > MAX_STRIDE else "")
            + f", got {width}x{height}"
        )
    return size_wh
