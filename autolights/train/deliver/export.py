"""Export a network to ONNX, checked number by number against the network it came from."""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import onnx
import torch
from torch import Tensor, nn

import autolights
from autolights.core import ImageArray, InitialWeights, ModelInfo
from autolights.core.atomic import new_file
from autolights.core.boxes import match_boxes
from autolights.core.errors import ParityError, UsageError
from autolights.core.model_info import FORMAT_VERSION
from autolights.infer.decode import decode
from autolights.infer.letterbox import InputBuffer
from autolights.infer.session import OnnxSession
from autolights.train.network.model import MAX_STRIDE, YoloV5

OPSET = 17  # read by TensorRT 8.6 and later and by every ONNX Runtime since 1.12
# Raw rows that see nothing hold boxes a thousand pixels wide: the public nano differs by 0.005 px there, in what it
# detects by 0.0002.
BOX_TOLERANCE_PX = 0.05
DETECTION_TOLERANCE_PX = 0.01
PROB_TOLERANCE = 1e-4


@dataclass(frozen=True)
class ExportReport:
    """What was exported: the file, and its description with the parity figures."""

    path: Path
    info: ModelInfo


@dataclass(frozen=True)
class Parity:
    """Largest differences between a network and its export.

    Attributes:
        images: On how many images.
        box_px: Of any centre, width or height of the raw output, in input pixels.
        prob: Of any objectness or class probability.
        detections: Lights that the network reports on these images.
        detection_px: Of any edge of such a light, in image pixels.
        unmatched: Lights that only one of the two reports, those within the tolerance of the threshold left aside.
    """

    images: int
    box_px: float
    prob: float
    detections: int
    detection_px: float
    unmatched: int

    def check(self) -> None:
        """Raise `ParityError` if a difference is beyond its tolerance (or not a number)."""
        boxes_agree = self.box_px <= BOX_TOLERANCE_PX and self.detection_px <= DETECTION_TOLERANCE_PX
        if not (boxes_agree and self.prob <= PROB_TOLERANCE and self.unmatched == 0):
            raise ParityError(
                f"the ONNX model differs from the network by {self.box_px:.2g} px in the raw output, "
                f"{self.detection_px:.2g} px in the detections, {self.prob:.2g} in probability and {self.unmatched} "
                f"detections (allowed: {BOX_TOLERANCE_PX}, {DETECTION_TOLERANCE_PX}, {PROB_TOLERANCE}, 0); "
                "nothing was written"
            )

    def to_json(self) -> dict[str, Any]:
        """For the model's description."""
        return {
            "images": self.images,
            "box_px": float(f"{self.box_px:.3g}"),
            "prob": float(f"{self.prob:.3g}"),
            "detections": self.detections,
            "detection_px": float(f"{self.detection_px:.3g}"),
        }


def export_onnx(
    model: YoloV5,
    path: Path,
    *,
    size_wh: tuple[int, int],
    opset: int = OPSET,
    score_threshold: float = 0.25,
    initial_weights: InitialWeights | None = None,
    training: Mapping[str, Any] | None = None,
    images: Sequence[ImageArray] = (),
) -> ExportReport:
    """Write ``model.onnx`` for one input size, and its `ModelInfo` as JSON beside it.

    Both files appear only if ONNX Runtime agrees with the network on two random images and the given ones.

    Args:
        model: The network; it is put into eval mode for the time being.
        path: Of the ONNX file; the description gets the ending ``.json``.
        size_wh: Input width and height in pixels, multiples of 32.
        opset: ONNX operator set.
        score_threshold: Of the runtime.
        initial_weights: What the training started from, if the network itself does not say.
        training: Figures of the training run for the manifest.
        images: BGR images, of any size, on which parity is checked as well.

    Raises:
        UsageError: If the size does not fit the strides.
        ParityError: If the model differs from the network.
    """
    width, height = size_wh
    if min(size_wh) < MAX_STRIDE or width % MAX_STRIDE or height % MAX_STRIDE:
        raise UsageError(f"the input size must be multiples of {MAX_STRIDE} px, got {width}x{height}")
    info = ModelInfo(
        classes=model.classes,
        size_wh=size_wh,
        opset=opset,
        score_threshold=score_threshold,
        initial_weights=initial_weights or model.initial_weights,
        training=dict(training or {}),
    )
    was_training = model.training
    model.eval()
    try:
        with new_file(path) as model_file, new_file(path.with_suffix(".json")) as info_file:
            _write_onnx(model, info, model_file)
            parity = _compare(model, OnnxSession(model_file, info), info, [*_random_images(size_wh), *images])
            parity.check()
            info = info.model_copy(update={"parity": parity.to_json()})
            info_file.write_text(json.dumps(info.model_dump(mode="json"), indent=1) + "\n", encoding="utf-8")
    finally:
        model.train(was_training)
    return ExportReport(path, info)


class _FixedSize(nn.Module):
    """The network for one input size: cells and anchors of all rows are constants, the decoding a few operators."""

    strides: Tensor
    offsets: Tensor
    anchors: Tensor

    def __init__(self, model: YoloV5, size_wh: tuple[int, int]) -> None:
        super().__init__()
        self.network = model
        self.columns = 5 + len(model.classes)
        width, height = size_wh
        strides, cells, anchors = [], [], []
        for level, stride in enumerate(model.strides):
            rows, columns = height // stride, width // stride
            y, x = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
            cells.append(torch.stack([x, y], dim=-1).reshape(-1, 2).repeat(3, 1))
            strides.append(torch.full((3 * rows * columns, 1), float(stride)))
            anchors.append((model.anchors[level].cpu() * stride).repeat_interleave(rows * columns, dim=0))
        self.register_buffer("strides", torch.cat(strides))
        self.register_buffer("offsets", (torch.cat(cells) - 0.5) * torch.cat(strides))
        self.register_buffer("anchors", torch.cat(anchors))

    def forward(self, images: Tensor) -> Tensor:
        """(1, 3, H, W) → (1, N, 5 + C), as `YoloV5` in eval mode."""
        maps = self.network.logits(images)
        values = torch.cat([logits.reshape(1, -1, self.columns) for logits in maps], dim=1).sigmoid()
        # The same equations as in `Detect.decode`, sorted so that all that is constant is one constant.
        centres = values[..., 0:2] * (2 * self.strides) + self.offsets
        sides = values[..., 2:4] * values[..., 2:4] * (4 * self.anchors)
        return torch.cat([centres, sides, values[..., 4:]], dim=-1)


def _write_onnx(model: YoloV5, info: ModelInfo, path: Path) -> None:
    device = next(model.parameters()).device
    width, height = info.size_wh
    with warnings.catch_warnings(), torch.no_grad():
        # The exporter that is to replace it needs another package and folds fewer constants.
        warnings.filterwarnings("ignore", "You are using the legacy TorchScript-based ONNX export", DeprecationWarning)
        warnings.filterwarnings("ignore", "The feature will be removed", DeprecationWarning)
        torch.onnx.export(
            _FixedSize(model, info.size_wh).to(device).eval(),
            (torch.zeros(1, 3, height, width, device=device),),
            path,
            dynamo=False,
            opset_version=info.opset,
            input_names=["images"],
            output_names=["output"],
        )
    proto = onnx.load(path)
    facts = {
        "names": json.dumps(list(info.classes)),
        "size_wh": json.dumps(list(info.size_wh)),
        "head": info.head,
        "format_version": str(FORMAT_VERSION),
        "program_version": autolights.__version__,
    }
    onnx.helper.set_model_props(proto, facts)
    onnx.checker.check_model(proto, full_check=True)
    onnx.save(proto, path)


def _compare(model: YoloV5, session: OnnxSession, info: ModelInfo, images: Sequence[ImageArray]) -> Parity:
    """Run both on the same inputs."""
    device = next(model.parameters()).device
    width, height = info.size_wh
    buffer, blob = InputBuffer(info.size_wh), np.empty((1, 3, height, width), dtype=np.float32)
    worst = np.zeros(3)  # box_px, prob, detection_px
    detections = unmatched = 0
    for image in images:
        letterbox = buffer.fill(image, blob[0])
        with torch.inference_mode():
            wanted = cast(Tensor, model(torch.from_numpy(blob).to(device)))[0].cpu().numpy()
        got = session.run(blob)[0][0]
        difference = np.abs(got - wanted)
        ours = decode(wanted, letterbox, score_threshold=info.score_threshold)
        theirs = decode(got, letterbox, score_threshold=info.score_threshold)
        a, b = match_boxes(ours.boxes_xyxy, theirs.boxes_xyxy, iou_threshold=0.9)
        moved = np.abs(ours.boxes_xyxy[a] - theirs.boxes_xyxy[b]).max(initial=0.0)
        worst = np.maximum(worst, [difference[:, :4].max(), difference[:, 4:].max(), moved])
        detections += len(ours)
        single_scores = np.concatenate([np.delete(ours.scores, a), np.delete(theirs.scores, b)])
        unmatched += int(np.count_nonzero(single_scores > info.score_threshold + PROB_TOLERANCE))
    return Parity(len(images), float(worst[0]), float(worst[1]), detections, float(worst[2]), unmatched)


def _random_images(size_wh: tuple[int, int]) -> list[ImageArray]:
    """Noise, and the same noise as soft blobs: fine and coarse structure, both always the same."""
    width, height = size_wh
    noise = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    blobs = cv2.resize(noise[: height // 16, : width // 16], size_wh, interpolation=cv2.INTER_CUBIC)
    return [noise, np.asarray(blobs, dtype=np.uint8)]
