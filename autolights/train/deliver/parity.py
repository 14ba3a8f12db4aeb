"""Does an ONNX file say what the network says? Rows and lights of both, on random and on real images."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeAlias, cast

import cv2
import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor

from autolights.core import BoolArray, FloatArray, ImageArray, ModelInfo
from autolights.core.boxes import iou_matrix, match_boxes, nms, xyxy_from_cxcywh
from autolights.core.errors import ParityError
from autolights.core.model_info import Precision
from autolights.infer.letterbox import InputBuffer
from autolights.train.deliver.heads import MAX_CANDIDATES
from autolights.train.deliver.near_ties import Near, decided_by_rounding
from autolights.train.deliver.onnx_file import without_plugin
from autolights.train.network.model import MAX_STRIDE, YoloV5


@dataclass(frozen=True)
class Tolerance:
    """What a difference may be at most; see `Parity`."""

    box_px: float
    prob: float
    detection_px: float
    score: float
    unmatched_share: float
    agreement: float
    match_iou: float
    tie_iou: float
    quantile: float


TOLERANCES: dict[Precision, Tolerance] = {
    # Raw rows that see nothing hold boxes a thousand pixels wide: the public nano differs by 0.005 px there, in what it
    # detects by 0.0002.
    "fp32": Tolerance(
        box_px=0.05,
        prob=1e-4,
        detection_px=0.01,
        score=1e-4,
        unmatched_share=0.0,
        agreement=0.5,  # 1 in practice; of a network that knows nothing yet, all scores are nearly equal
        match_iou=0.9,
        tie_iou=1e-3,
        quantile=1.0,
    ),
    # Judged by the lights: of rows that see nothing, class probabilities differ by 0.2. Of those that the shipped nano
    # sees in simulated images, edges by 0.03 px and scores by 0.003; of large objects in photos by 0.3 px. With
    # half-precision outputs edges lie 0.5 px apart from 512 px on, 1 px from 1024 px on. Two boxes of one light that
    # are nearly as good may change places, hence the quantile.
    "fp16": Tolerance(
        box_px=math.inf,
        prob=math.inf,
        detection_px=1.0,
        score=0.02,
        unmatched_share=0.02,
        agreement=0.5,
        match_iou=0.5,
        tie_iou=0.01,
        quantile=0.98,
    ),
}


@dataclass(frozen=True)
class Parity:
    """Largest differences between a network and its export.

    Attributes:
        images: How many runs of one image were compared.
        inputs: Their shapes (B, 3, H, W).
        box_px: Of any centre, width or height of any row, in input pixels; None where the head yields no rows.
        prob: Of any probability of any row; None likewise.
        detections: Lights that the network reports, at the score threshold after greedy suppression.
        detection_px: Of any edge of such a light, in input pixels; of fp16 in all but the worst 2 %.
        score: Of any score or class probability of such a light; of fp16 in all but the worst 2 %.
        unmatched: Such lights that only one of the two reports, left aside those about as good as the threshold, or as
            the last of a full list, and those that a near tie in suppression explains (see `near_ties`).
        agreement: Share of lights that both report when nothing but the 512 best rows of an image limits them, the same
            left aside: mostly lights far below the score threshold.
        candidates: The most rows above the score threshold that an image had.
    """

    images: int
    inputs: tuple[tuple[int, ...], ...]
    box_px: float | None
    prob: float | None
    detections: int
    detection_px: float
    score: float
    unmatched: int
    agreement: float
    candidates: int

    def check(self, tolerance: Tolerance, *, what: str = "the ONNX model") -> None:
        """Compare with what is allowed.

        Args:
            tolerance: See `TOLERANCES`.
            what: Is compared with the network; for the error.

        Raises:
            ParityError: If a difference is beyond its tolerance (or not a number); it names each that is.
        """
        allowed_unmatched = int(tolerance.unmatched_share * self.detections)
        limits = {
            "box_px": (self.box_px, tolerance.box_px),
            "prob": (self.prob, tolerance.prob),
            "detection_px": (self.detection_px, tolerance.detection_px),
            "score": (self.score, tolerance.score),
            "unmatched": (self.unmatched, allowed_unmatched),
        }
        wrong = [
            f"{name} {value:.3g} (allowed: {limit:g})"
            for name, (value, limit) in limits.items()
            if value is not None and not value <= limit
        ]
        if not self.agreement >= tolerance.agreement:
            wrong.append(f"agreement {self.agreement:.3g} (at least: {tolerance.agreement:g})")
        if wrong:
            crowd = (
                f"; {self.candidates} rows of an image are above the score threshold, of which the graph looks at "
                f"{MAX_CANDIDATES}"
                if self.box_px is None and self.candidates > MAX_CANDIDATES
                else ""
            )
            raise ParityError(f"{what} differs from the network in {', '.join(wrong)}{crowd}; nothing was written")

    def to_json(self) -> dict[str, Any]:
        """For the model's description."""
        values = {**asdict(self), "inputs": [list(shape) for shape in self.inputs]}
        return {
            name: float(f"{value:.3g}") if isinstance(value, float) else value
            for name, value in values.items()
            if value is not None
        }


Run: TypeAlias = Callable[[FloatArray], Sequence[FloatArray]]


def compare(model: YoloV5, run: Run, info: ModelInfo, images: Sequence[ImageArray] = ()) -> Parity:
    """Run a network and what was made of it on the same inputs.

    Args:
        model: In eval mode.
        run: From (B, 3, H, W) float32 to the outputs of `info.head`; see `onnx_run`.
        info: What it was exported as. A dynamic batch is tried with 1 and 3 images, a dynamic size with the size that
            it is meant for and with a smaller one of another shape.
        images: BGR images, of any size, besides two random ones.
    """
    device = next(model.parameters()).device
    found = _Differences(info)
    for batch in _batches(info, images):
        with torch.inference_mode():
            wanted = cast(Tensor, model(torch.from_numpy(batch).to(device))).cpu().numpy()
        found.inputs.add(batch.shape)
        found.add(wanted, run(batch))
    return found.parity()


def onnx_run(path: Path, info: ModelInfo) -> Run:
    """A file in ONNX Runtime on the CPU; of one that ends in TensorRT's plug-in all up to the plug-in."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    source = str(path)
    if info.head == "efficient-nms":
        source = without_plugin(onnx.load(path)).SerializeToString()
    session = onnxruntime.InferenceSession(source, options, providers=["CPUExecutionProvider"])

    def run(batch: FloatArray) -> Sequence[FloatArray]:
        outputs = session.run(None, {"images": batch.astype(np.float16) if info.half_io else batch})
        return [np.asarray(output) for output in outputs]

    return run


@dataclass(frozen=True, eq=False)
class _Lights:
    """Boxes in input pixels with scores and class probabilities."""

    boxes_xyxy: FloatArray
    scores: FloatArray
    class_probs: FloatArray

    @classmethod
    def candidates(cls, rows: FloatArray, info: ModelInfo) -> "_Lights":
        """Of (N, 5 + C) rows the best 512, or all above the score threshold if these are more."""
        scores = _scores(rows)
        least = np.partition(scores, -MAX_CANDIDATES)[-MAX_CANDIDATES] if len(scores) > MAX_CANDIDATES else 0.0
        chosen = rows[scores >= min(least, info.score_threshold)].astype(np.float64)
        return cls(xyxy_from_cxcywh(chosen[:, :4]), _scores(chosen), chosen[:, 5:])

    def suppressed(self, info: ModelInfo) -> "_Lights":
        """What greedy suppression leaves."""
        kept = nms(self.boxes_xyxy, self.scores, iou_threshold=info.nms_iou_threshold, max_boxes=info.max_detections)
        return _Lights(self.boxes_xyxy[kept], self.scores[kept], self.class_probs[kept])

    @classmethod
    def reported(cls, boxes: FloatArray, scores: FloatArray, _classes: FloatArray, probs: FloatArray) -> "_Lights":
        """Of the outputs of an end2end head."""
        there = scores > 0
        return cls(boxes[there].astype(np.float64), scores[there].astype(np.float64), probs[there].astype(np.float64))


class _Differences:
    """Collects over images."""

    def __init__(self, info: ModelInfo) -> None:
        self.info = info
        self.tolerance = TOLERANCES[info.precision]
        self.inputs: set[tuple[int, ...]] = set()
        self.images = self.detections = self.unmatched = self.candidates = self.both = self.all = 0
        self.box_px = self.prob = 0.0
        self.moved: list[float] = []
        self.scores: list[float] = []

    def add(self, wanted: FloatArray, outputs: Sequence[FloatArray]) -> None:
        """A batch: the network's rows and what came out."""
        for i in range(len(wanted)):
            self._add_image(wanted[i], [np.asarray(output[i]) for output in outputs])

    def _add_image(self, wanted: FloatArray, outputs: Sequence[FloatArray]) -> None:
        info = self.info
        self.images += 1
        self.candidates = max(self.candidates, int(np.count_nonzero(_scores(wanted) >= info.score_threshold)))
        if info.head == "end2end":
            self._add_lights(_Lights.candidates(wanted, info), _Lights.reported(*outputs))
            return
        if info.head == "raw":
            got = outputs[0].astype(np.float32)
        else:
            got = _rows_of_scores(outputs[0], outputs[1])
            wanted = _rows_of_scores(wanted[:, :4], wanted[:, 4:5] * wanted[:, 5:])
        difference = np.abs(got - wanted)
        self.box_px = np.maximum(self.box_px, difference[:, :4].max())  # np.maximum hands NaN on
        self.prob = np.maximum(self.prob, difference[:, 4:].max())
        self._add_lights(_Lights.candidates(wanted, info), _Lights.candidates(got, info).suppressed(info))

    def _add_lights(self, candidates: _Lights, theirs: _Lights) -> None:
        ours = candidates.suppressed(self.info)
        threshold = self.info.score_threshold
        a, b = match_boxes(ours.boxes_xyxy, theirs.boxes_xyxy, iou_threshold=self.tolerance.match_iou)
        self.detections += int(np.count_nonzero(ours.scores >= threshold))
        single = (np.setdiff1d(np.arange(len(ours.scores)), a), np.setdiff1d(np.arange(len(theirs.scores)), b))
        explained = decided_by_rounding(
            (ours.boxes_xyxy, theirs.boxes_xyxy),
            (ours.scores, theirs.scores),
            single,
            Near(self.info.nms_iou_threshold, self.tolerance.tie_iou, self.tolerance.score),
        )
        theirs_alone = theirs.boxes_xyxy[single[1]], theirs.scores[single[1]]
        # What is about as good as the last that the other side could report, or took part at all, it may lack.
        least = float(candidates.scores.min(initial=0.0))
        left = np.concatenate(
            [
                ours.scores[single[0]][~explained[0] & (ours.scores[single[0]] > self._last(theirs, least))],
                theirs_alone[1][
                    ~(explained[1] & self._among(candidates, *theirs_alone))
                    & (theirs_alone[1] > self._last(ours, least))
                ],
            ]
        )
        self.both += 2 * len(a)
        self.all += 2 * len(a) + len(left)
        self.unmatched += int(np.count_nonzero(left > threshold + self.tolerance.score))
        shown = ours.scores[a] >= threshold
        a, b = a[shown], b[shown]
        self.moved += np.abs(ours.boxes_xyxy[a] - theirs.boxes_xyxy[b]).max(axis=1).tolist()
        probs = np.abs(ours.class_probs[a] - theirs.class_probs[b]).max(axis=1)
        self.scores += np.maximum(np.abs(ours.scores[a] - theirs.scores[b]), probs).tolist()

    def _last(self, lights: _Lights, least: float) -> float:
        """Up to which score a list may lack lights because it is full, or because they were no candidates."""
        full = len(lights.scores) == self.info.max_detections
        return max(float(lights.scores[-1]) if full else least, least) + self.tolerance.score

    def _among(self, candidates: _Lights, boxes_xyxy: FloatArray, scores: FloatArray) -> BoolArray:
        """Which lights the network has as well, if only before suppression."""
        same_box = iou_matrix(boxes_xyxy, candidates.boxes_xyxy) >= self.tolerance.match_iou
        same_score = np.abs(scores[:, None] - candidates.scores) <= self.tolerance.score
        return np.asarray((same_box & same_score).any(axis=1))

    def parity(self) -> Parity:
        """The result."""
        has_rows = self.info.head != "end2end"
        return Parity(
            images=self.images,
            inputs=tuple(sorted(self.inputs)),
            box_px=float(self.box_px) if has_rows else None,
            prob=float(self.prob) if has_rows else None,
            detections=self.detections,
            detection_px=self._most(self.moved),
            score=self._most(self.scores),
            unmatched=self.unmatched,
            agreement=self.both / self.all if self.all else 1.0,
            candidates=self.candidates,
        )

    def _most(self, differences: Sequence[float]) -> float:
        return float(np.quantile(differences, self.tolerance.quantile, method="higher")) if differences else 0.0


def _rows_of_scores(boxes: FloatArray, scores: FloatArray) -> FloatArray:
    """What the plug-in sees, as rows whose objectness is 1."""
    return np.concatenate([boxes, np.ones_like(boxes[:, :1]), scores], axis=1).astype(np.float32)


def _scores(rows: FloatArray) -> FloatArray:
    return np.asarray(rows[:, 4] * rows[:, 5:].max(axis=1))


def _batches(info: ModelInfo, images: Sequence[ImageArray]) -> Iterator[FloatArray]:
    """(B, 3, H, W) inputs of all images, at each size, and in batches if the batch is free."""
    sizes = [info.size_wh]
    if info.dynamic_size:
        sizes.append(_smaller(info.size_wh))
    for size_wh in sizes:
        blobs = np.stack([_blob(image, size_wh) for image in (*_random_images(size_wh), *images)])
        yield from (blob[None] for blob in blobs)
        if info.dynamic_batch:
            yield blobs[[0, 1, -1]]


def _smaller(size_wh: tuple[int, int]) -> tuple[int, int]:
    """Another size of another shape: about two thirds and four fifths of the sides."""
    width, height = (
        max(round(side * share / MAX_STRIDE), 3) * MAX_STRIDE for side, share in zip(size_wh, (0.65, 0.8), strict=True)
    )
    return width, height


def _blob(image: ImageArray, size_wh: tuple[int, int]) -> FloatArray:
    blob = np.empty((3, size_wh[1], size_wh[0]), dtype=np.float32)
    InputBuffer(size_wh).fill(image, blob)
    return blob


def _random_images(size_wh: tuple[int, int]) -> list[ImageArray]:
    """Noise, and the same noise as soft blobs: fine and coarse structure, both always the same."""
    width, height = size_wh
    noise = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    blobs = cv2.resize(noise[: height // 16, : width // 16], size_wh, interpolation=cv2.INTER_CUBIC)
    return [noise, np.asarray(blobs, dtype=np.uint8)]
