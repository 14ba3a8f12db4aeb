"""Run a network, or an exported model, over labelled images and measure it.

`evaluate_detector` gives the figures alone; `detect_dataset` also what they were counted from, for files and pictures.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch import nn

from autolights.core import ConfusionMatrix, CountedWith, Detections, FloatArray
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
from autolights.train.measure.every_class import decode_every_class
from autolights.train.measure.metrics import DetectionMetrics
from autolights.train.measure.onnx_model import ExportedModel
from autolights.train.measure.operating_point import THRESHOLDS, recall_by_height, sweep_thresholds
from autolights.train.measure.predictions import Labels, Predictions
from autolights.train.memory import keep_freed_memory
from autolights.train.processes import ALONE, Processes

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
        counted_with: The model file; None for a network in memory.
    """

    dataset: ImageDataset
    indices: tuple[int, ...]
    labels: tuple[Labels, ...]
    predictions: tuple[Predictions, ...]
    reported: tuple[Predictions, ...]
    score_threshold: float
    unreadable: tuple[int, ...] = ()
    counted_with: CountedWith | None = None

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
                self.counted_with,
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
    model: nn.Module | ExportedModel,
    dataset: ImageDataset,
    *,
    long_side: int | None = None,
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
    model: nn.Module | ExportedModel,
    dataset: ImageDataset,
    *,
    long_side: int | None = None,
    batch_size: int = 8,
    score_threshold: float = 0.25,
    device: str = "cpu",
    bad_images: float = 0.01,
    processes: Processes = ALONE,
    progress: bool = True,
) -> DatasetDetections:
    """Show labelled images to a detector.

    Images are letterboxed as at runtime: for a network into the smallest stride-32 rectangle, for an exported model
    into its input.

    Args:
        model: A network that, called on (B, 3, H, W) RGB in [0, 1], returns (B, N, 5 + C) raw; it is put into eval mode
            for the time being. Or an exported model.
        dataset: Images and labels; its classes are the columns of the output.
        long_side: Of a network's input, pixels; an exported model has an input of its own.
        batch_size: Images that pass the network together.
        score_threshold: Of the runtime.
        device: Where a network runs. It is moved there, its weights in channels-last order (on a CPU two thirds
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
    with _ready(model, dataset, long_side, device) as detector:
        for batch in _batches(dataset, indices, detector.view, batch_size, unreadable):
            answers = detector.detect(batch.blob, batch.views, score_threshold=lowest_threshold)
            for i, view, (predictions, reported) in zip(batch.indices, batch.views, answers, strict=True):
                seen[i] = (
                    Labels(dataset.boxes_xyxy(i, view.image_wh), dataset.class_ids[i]),
                    predictions,
                    Predictions(reported.boxes_xyxy, reported.class_ids, reported.scores, reported.class_probs),
                )
    for others_seen, others_unreadable in processes.gather((seen, unreadable)):
        seen |= others_seen
        unreadable = sorted({*unreadable, *others_unreadable})
    _check_unreadable(dataset, unreadable, bad_images, tell=processes.is_main)
    images = sorted(seen)
    labels, all_predictions, all_reported = zip(*(seen[i] for i in images), strict=True)
    return DatasetDetections(
        dataset,
        tuple(images),
        labels,
        all_predictions,
        all_reported,
        score_threshold,
        tuple(unreadable),
        model.counted_with if isinstance(model, ExportedModel) else None,
    )


class _Detector(Protocol):
    """A network or an exported model, ready to be shown images."""

    def view(self, image_wh: tuple[int, int]) -> Letterbox:
        """Where an image lies in the input."""
        ...

    def detect(
        self, blob: FloatArray, views: Sequence[Letterbox], *, score_threshold: float
    ) -> list[tuple[Predictions, Detections]]:
        """See `ExportedModel`."""
        ...


class _Network:
    """The network itself, with the runtime's decoding."""

    def __init__(self, model: nn.Module, device: str, long_side: int, dataset: ImageDataset) -> None:
        self._model = model
        self._device = device
        self._long_side = long_side
        self._dataset = dataset

    def view(self, image_wh: tuple[int, int]) -> Letterbox:
        return Letterbox(image_wh, rectangle_for(image_wh, self._long_side))

    def detect(
        self, blob: FloatArray, views: Sequence[Letterbox], *, score_threshold: float
    ) -> list[tuple[Predictions, Detections]]:
        images = torch.from_numpy(blob).to(device=self._device, memory_format=torch.channels_last)
        raws = self._model(images).cpu().float()
        if raws.shape[2] != 5 + len(self._dataset.classes):
            raise UsageError(
                f"the network knows {raws.shape[2] - 5} classes, "
                f"the data of {self._dataset.root} {len(self._dataset.classes)}"
            )
        return [
            (decode_every_class(raw, view), decode(raw.numpy(), view, score_threshold=score_threshold))
            for raw, view in zip(raws, views, strict=True)
        ]


@contextmanager
def _ready(
    model: nn.Module | ExportedModel, dataset: ImageDataset, long_side: int | None, device: str
) -> Iterator[_Detector]:
    """Bring a network into eval mode and onto the device for the time being."""
    if isinstance(model, ExportedModel):
        if model.info.classes != dataset.classes:
            raise UsageError(
                f"the model knows the classes {list(model.info.classes)}, "
                f"the data of {dataset.root} {list(dataset.classes)}"
            )
        yield model
        return
    if long_side is None:
        raise ValueError("to measure a network, long_side must be given")
    was_training = model.training
    model.to(device=device, memory_format=torch.channels_last).eval()  # type: ignore[call-overload]
    try:
        with torch.inference_mode():
            yield _Network(model, device, long_side, dataset)
    finally:
        model.train(was_training)


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


@dataclass
class _Batch:
    """Images of one input size: their indices, where they lie in the input, and the (B, 3, H, W) input itself."""

    blob: FloatArray
    indices: list[int] = field(default_factory=list)
    views: list[Letterbox] = field(default_factory=list)


def _batches(
    dataset: ImageDataset,
    indices: Iterable[int],
    view_of: Callable[[tuple[int, int]], Letterbox],
    batch_size: int,
    unreadable: list[int],
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
        view = view_of((image_bgr.shape[1], image_bgr.shape[0]))
        width, height = view.input_wh
        if view.input_wh not in waiting:
            waiting[view.input_wh] = _Batch(np.empty((batch_size, 3, height, width), dtype=np.float32))
        batch = waiting[view.input_wh]
        buffer = buffers.setdefault(view.input_wh, InputBuffer(view.input_wh))
        buffer.fill(image_bgr, batch.blob[len(batch.indices)], view)
        batch.indices.append(i)
        batch.views.append(view)
        if len(batch.indices) == batch_size:
            yield waiting.pop(view.input_wh)
    for batch in waiting.values():
        batch.blob = batch.blob[: len(batch.indices)]
        yield batch
