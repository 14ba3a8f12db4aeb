"""What a reader of ``model.onnx`` must know about it."""

from pathlib import Path
from typing import Any, Literal, Self, TypeAlias

from pydantic import Field, model_validator

from autolights.core.config import Config
from autolights.core.errors import BundleError
from autolights.core.json_files import read_json_object, validated

# Of the bundle and of the description beside a model: they change together.
FORMAT_VERSION = 3  # 1 knew raw, fp32 and one fixed size only, 2 no temperature

Head: TypeAlias = Literal["raw", "end2end", "efficient-nms"]
Precision: TypeAlias = Literal["fp32", "fp16", "int8"]


class InitialWeights(Config):
    """What the training started from: name, SHA-256 and licence."""

    name: str
    sha256: str
    licence: str


class ModelInfo(Config):
    """Classes, ports, precision and proof of a model; written by the export and kept in the manifest.

    The input is called ``images``: (B, 3, H, W) RGB in [0, 1]. What comes out depends on the head:

    - ``raw``: ``output`` (B, N, 5 + C) centre x, y, width, height in input pixels, objectness, class probabilities.
    - ``end2end``: ``boxes`` (B, K, 4) xyxy in input pixels, ``scores`` (B, K) objectness times the largest class
      probability, best first and 0 where there is nothing more, ``classes`` (B, K), ``class_probs`` (B, K, C).
    - ``efficient-nms``: the outputs of TensorRT's plug-in, without class vectors: not for tracking.

    Attributes:
        classes: In the order of the class probabilities.
        size_wh: Input width and height in pixels; with `dynamic_size` the size that it is meant for.
        head: See above.
        precision: Of weights and arithmetic; of int8 the sensitive layers stay in float.
        half_io: Input and outputs are float16 instead of float32.
        dynamic_batch: B is free instead of 1.
        dynamic_size: H and W are free multiples of 32.
        opset: ONNX operator set.
        score_threshold: Detections below it are dropped; also that of the confusion matrix.
        nms_iou_threshold: Of two boxes that overlap more than this the worse one goes.
        max_detections: K of the heads with suppression; the most lights that any head reports.
        initial_weights: What the training started from; None if it started from nothing.
        parity: Largest differences between the network and its export, on what.
        accuracy: Figures of the float and of the quantised model on the same images, if they were measured.
        training: Figures of the training run (AP, epochs, ...).
    """

    classes: tuple[str, ...] = Field(min_length=1)
    size_wh: tuple[int, int]
    head: Head = "raw"
    precision: Precision = "fp32"
    half_io: bool = False
    dynamic_batch: bool = False
    dynamic_size: bool = False
    opset: int
    score_threshold: float = Field(default=0.25, gt=0, lt=1)
    nms_iou_threshold: float = Field(default=0.5, gt=0, lt=1)
    max_detections: int = Field(default=100, ge=1)
    initial_weights: InitialWeights | None = None
    parity: dict[str, Any] = Field(default_factory=dict)
    accuracy: dict[str, Any] = Field(default_factory=dict)
    training: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if min(self.size_wh) < 32 or any(side % 32 for side in self.size_wh):
            raise ValueError(f"size_wh must be multiples of 32 px, got {list(self.size_wh)}")
        return self


def load_model_info(model_path: Path) -> ModelInfo:
    """Read the description that the export wrote beside a model (``model.onnx`` → ``model.json``).

    Raises:
        BundleError: If it is missing or breaks the format.
    """
    path = model_path.with_suffix(".json")
    values = read_json_object(path, error=BundleError, hint="`autolights export` writes it")
    return validated(ModelInfo, values, path, error=BundleError)
