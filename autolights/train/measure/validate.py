"""Run a network over labelled images and measure it.

`evaluate_detector` gives the figures alone; `detect_dataset` also what they were counted from, for files and pictures.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torchvision.ops import batched_nms, box_convert

from autolights.core import ConfusionMatrix, FloatArray
from autolights.core.boxes import match_boxes
from autolights.core.calibration import Calibration
from autolights.core.errors import DataError, UsageError
from autolights.core.progress import say, track
from autolights.data.image_dataset import ImageDataset
from autolights.infer.decode import decode
from autolights.infer.letterbox import InputBuffer, Letterbox, rectangle_for
from autolights.train.measure.average_precision import average_precision
from autolights.train.measure.calibration import fit_calibration
from autolights.train.measure.confusion import count_confusions
from autolights.train.measure.metrics import DetectionMetrics
from autolights.train.measure.operating_point import THRESHOLDS, recall_by_height, sweep_thresholds
from autolights.train.measure.predictions import Labels, Predictions
from autolights.train.memory import keep_freed_memory
from autolights.train.processes import ALONE, Processes

COCO_SCORE_THRESHOLD = 0.001
COCO_NMS_IOU_THRESHOLD = 0.6
COCO_MAX_DETECTIONS = 300
_MAX_CANDIDATES = 4096  # of the best enter the suppression; an untrained network would offer a hundred thousand
_NAMED_FILES = 8  # in a message


@dataclass(frozen=True, eq=False)
class DatasetDetections:
    """What is labelled and what was seen, image by image.

    Attributes:
        dataset: The labelled images.
        indices: Of the images in it that were looked at, rising; the next three have an entry for each.
        labels: The truth.
        predictions: For average precision: each class of each cell, down to a score of 0.001.
        reported: What the runtime would report at 0.05 (`THRESHOLDS` begins there), or `score_threshold` if lower.
        score_threshold: Of the runtime.
        unreadable: Indices of images that do not decode.
    """

    dataset: ImageDataset
    indices: tuple[int, ...]
    labels: tuple[Labels, ...]
    predictions: tuple[Predictions, ...]
    reported: tuple[Predictions, ...]
    score_threshold: float
    unreadable: tuple[int, ...] = ()

    @property
    def image_paths(self) -> tuple[Path, ...]:
        """Of the images that were looked at."""
        return tuple(self.dataset.image_paths[i] for i in self.indices)

    def metrics(self, *, iou_threshold: float = 0.5) -> DetectionMetrics:
        """Count.

        Args:
            iou_threshold: From which a detection counts as a label's, in all that depends on the score threshold.
        """
        class_count = len(self.dataset.classes)
        reported = [image.above(self.score_threshold) for image in self.reported]
        counts = np.zeros((class_count + 1, class_count + 1), dtype=np.int64)
        for truth, seen in zip(self.labels, reported, strict=True):
            counts += count_confusions(
                truth.boxes_xyxy,
                truth.class_ids,
                seen.boxes_xyxy,
                seen.class_ids,
                class_count=class_count,
                iou_threshold=iou_threshold,
            )
        return DetectionMetrics(
            **vars(average_precision(self.labels, self.predictions, self.dataset.classes)),
            images=len(self.indices),
            labels=sum(len(image.class_ids) for image in self.labels),
            confusion=ConfusionMatrix(
                self.dataset.classes,
                counts,
                self.score_threshold,
                iou_threshold,
                _calibration(self.labels, reported, iou_threshold),
            ),
            heights=recall_by_height(self.labels, reported, iou_threshold=iou_threshold),
            sweep=sweep_thresholds(self.labels, self.reported, iou_threshold=iou_threshold),
            unreadable=tuple(self.dataset.image_paths[i].name for i in self.unreadable),
        )


def _calibration(labels: Sequence[Labels], reported: Sequence[Predictions], iou_threshold: float) -> Calibration | None:
    """What the class probabilities of detected labels are worth."""
    class_probs, truth_ids = [], []
    for truth, seen in zip(labels, reported, strict=True):
        truths, detections = match_boxes(truth.boxes_xyxy, seen.boxes_xyxy, iou_threshold=iou_threshold)
        if seen.class_probs is not None and len(detections):
            class_probs.append(seen.class_probs[detections])
            truth_ids.append(truth.class_ids[truths])
    return fit_calibration(np.concatenate(class_probs), np.concatenate(truth_ids)) if class_probs else None


def evaluate_detector(
    model: nn.Module,
    dataset: ImageDataset,
    *,
    long_side: int,
    batch_size: int = 8,
    score_threshold: float = 0.25,
    device: str = "cpu",
    bad_images: float = 0.01,
    processes: Processes = ALONE,
    progress: bool = True,
) -> DetectionMetrics:
    """Measure a detector on labelled images; see `detect_dataset`."""
    return detect_dataset(
        model,
        dataset,
        long_side=long_side,
        batch_size=batch_size,
        score_threshold=score_threshold,
        device=device,
        bad_images=bad_images,
        processes=processes,
        progress=progress,
    ).metrics()


def detect_dataset(
    model: nn.Module,
    dataset: ImageDataset,
    *,
    long_side: int,
    batch_size: int = 8,
    score_threshold: float = 0.25,
    device: str = "cpu",
    bad_images: float = 0.01,
    processes: Processes = ALONE,
    progress: bool = True,
) -> DatasetDetections:
    """Show labelled images to a detector.

    Images are letterboxed as at runtime, into the smallest stride-32 rectangle.

    Args:
        model: Called on (B, 3, H, W) RGB in [0, 1] it returns (B, N, 5 + C) raw. It is put into eval mode for the
            time being.
        dataset: Images and labels; its classes are the columns of the output.
        long_side: Of the input, pixels.
        batch_size: Images that pass the network together.
        score_threshold: Of the runtime.
        device: Where the network runs. It is moved there, its weights in channels-last order (on a CPU two thirds
            of the time).
        bad_images: Largest share of images that do not decode; they are named on stderr and left out.
        processes: Each looks at its share of the images; all must call this, and all get the whole result.
        progress: Show how far it is; of several processes the main one does.

    Raises:
        UsageError: If there are no images or the network does not know as many classes as the data.
        DataError: If more images do not decode than `bad_images` allows; the text names them.
    """
    if not len(dataset):
        raise UsageError(f"{dataset.root}: no images to validate on")
    indices: Iterable[int] = range(processes.rank, len(dataset), processes.size)
    if progress and processes.is_main:
        total = len(range(0, len(dataset), processes.size))
        indices = track(indices, description="validate", total=total, unit="images")
    lowest_threshold = min(score_threshold, float(THRESHOLDS[0]))
    seen: dict[int, tuple[Labels, Predictions, Predictions]] = {}
    unreadable: list[int] = []
    keep_freed_memory()
    was_training = model.training
    model.to(device=device, memory_format=torch.channels_last).eval()  # type: ignore[call-overload]
    try:
        with torch.inference_mode():
            for batch in _batches(dataset, indices, long_side, batch_size, unreadable):
                raws = model(_tensor(batch.blob, device)).cpu().float()
                _check_columns(raws.shape[2], dataset)
                for i, letterbox, raw in zip(batch.indices, batch.letterboxes, raws, strict=True):
                    reported = decode(raw.numpy(), letterbox, score_threshold=lowest_threshold)
                    seen[i] = (
                        Labels(dataset.boxes_xyxy(i, letterbox.image_wh), dataset.class_ids[i]),
                        decode_every_class(raw, letterbox),
                        Predictions(reported.boxes_xyxy, reported.class_ids, reported.scores, reported.class_probs),
                    )
    finally:
        model.train(was_training)
    for others_seen, others_unreadable in processes.gather((seen, unreadable)):
        seen |= others_seen
        unreadable = sorted({*unreadable, *others_unreadable})
    _check_unreadable(dataset, unreadable, bad_images, tell=processes.is_main)
    images = sorted(seen)
    labels, predictions, all_reported = zip(*(seen[i] for i in images), strict=True)
    return DatasetDetections(
        dataset, tuple(images), labels, predictions, all_reported, score_threshold, tuple(unreadable)
    )


def _check_columns(columns: int, dataset: ImageDataset) -> None:
    if columns != 5 + len(dataset.classes):
        raise UsageError(f"the network knows {columns - 5} classes, the data of {dataset.root} {len(dataset.classes)}")


def _check_unreadable(dataset: ImageDataset, unreadable: list[int], bad_images: float, *, tell: bool) -> None:
    """Name the images that do not decode; raise if they are more than allowed, or all."""
    if not unreadable:
        return
    names = ", ".join(str(dataset.image_paths[i]) for i in unreadable[:_NAMED_FILES])
    more = f" and {len(unreadable) - _NAMED_FILES} more" if len(unreadable) > _NAMED_FILES else ""
    text = f"{len(unreadable)} of {len(dataset)} validation images do not decode: {names}{more}"
    if len(unreadable) > bad_images * len(dataset) or len(unreadable) == len(dataset):
        raise DataError(f"{text}; bad_images allows a share of {bad_images:g}; replace or delete them")
    if tell:
        say(f"{text}; left out")


def decode_every_class(raw: Tensor, letterbox: Letterbox) -> Predictions:
    """Decode for COCO's average precision: each class of each cell is a detection of its own, suppressed by class.

    Args:
        raw: (N, 5 + C) of one image, on the CPU.
        letterbox: Where the image lies in the input.

    Returns:
        At most 300 predictions from a score of 0.001, in pixels of the image, best first.
    """
    raw = raw[raw[:, 4] >= COCO_SCORE_THRESHOLD]
    scores = raw[:, 4:5] * raw[:, 5:]
    cells, class_ids = torch.nonzero(scores >= COCO_SCORE_THRESHOLD, as_tuple=True)
    scores = scores[cells, class_ids]
    if len(scores) > _MAX_CANDIDATES:
        scores, best = scores.topk(_MAX_CANDIDATES)
        cells, class_ids = cells[best], class_ids[best]
    boxes = box_convert(raw[cells, :4], "cxcywh", "xyxy")
    kept = batched_nms(boxes, scores, class_ids, COCO_NMS_IOU_THRESHOLD)[:COCO_MAX_DETECTIONS]
    return Predictions(
        letterbox.boxes_to_image(boxes[kept].numpy().astype(np.float64)),
        class_ids[kept].numpy(),
        scores[kept].numpy(),
    )


def _tensor(blob: FloatArray, device: str) -> Tensor:
    return torch.from_numpy(blob).to(device=device, memory_format=torch.channels_last)


@dataclass
class _Batch:
    """Images of one input size: their indices, where they lie in the input, and the (B, 3, H, W) input itself."""

    blob: FloatArray
    indices: list[int] = field(default_factory=list)
    letterboxes: list[Letterbox] = field(default_factory=list)


def _batches(
    dataset: ImageDataset, indices: Iterable[int], long_side: int, batch_size: int, unreadable: list[int]
) -> Iterator[_Batch]:
    """Read images and collect those of equal input size; the last batch of a size may be smaller.

    Images that do not decode are added to `unreadable`.
    """
    buffers: dict[tuple[int, int], InputBuffer] = {}
    waiting: dict[tuple[int, int], _Batch] = {}
    for i in indices:
        try:
            image_bgr = dataset.read(i)
        except DataError:
            unreadable.append(i)
            continue
        width, height = input_wh = rectangle_for((image_bgr.shape[1], image_bgr.shape[0]), long_side)
        if input_wh not in waiting:
            waiting[input_wh] = _Batch(np.empty((batch_size, 3, height, width), dtype=np.float32))
        batch = waiting[input_wh]
        buffer = buffers.setdefault(input_wh, InputBuffer(input_wh))
        batch.letterboxes.append(buffer.fill(image_bgr, batch.blob[len(batch.indices)]))
        batch.indices.append(i)
        if len(batch.indices) == batch_size:
            yield waiting.pop(input_wh)
    for batch in waiting.values():
        batch.blob = batch.blob[: len(batch.indices)]
        yield batch
