"""Run a network over labelled images and measure it."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field

import numpy as np
import torch
from torch import Tensor, nn
from torchvision.ops import batched_nms, box_convert

from autolights.core import ConfusionMatrix, FloatArray
from autolights.core.errors import UsageError
from autolights.core.progress import track
from autolights.data.image_dataset import ImageDataset
from autolights.infer.decode import decode
from autolights.infer.letterbox import InputBuffer, Letterbox, rectangle_for
from autolights.train.confusion import count_confusions
from autolights.train.metrics import DetectionMetrics, Labels, Predictions, average_precision

COCO_SCORE_THRESHOLD = 0.001
COCO_NMS_IOU_THRESHOLD = 0.6
COCO_MAX_DETECTIONS = 300
_MAX_CANDIDATES = 4096  # of the best enter the suppression; an untrained network would offer a hundred thousand


def evaluate_detector(
    model: nn.Module,
    dataset: ImageDataset,
    *,
    long_side: int,
    batch_size: int = 8,
    score_threshold: float = 0.25,
    iou_threshold: float = 0.5,
    device: str = "cpu",
    progress: bool = True,
) -> DetectionMetrics:
    """Measure a detector on labelled images.

    Images are letterboxed as at runtime, into the smallest stride-32 rectangle. Average precision is counted from all
    that the network says (per-class suppression), the confusion matrix from what the runtime would report.

    Args:
        model: Called on (B, 3, H, W) RGB in [0, 1] it returns (B, N, 5 + C) raw. It is put into eval mode for the
            time being.
        dataset: Images and labels; its classes are the columns of the output.
        long_side: Of the input, pixels.
        batch_size: Images that pass the network together.
        score_threshold: Of the runtime, for the confusion matrix.
        iou_threshold: From which a detection counts as a label's, for the confusion matrix.
        device: Where the network runs. It is moved there, its weights in channels-last order (on a CPU two thirds
            of the time).
        progress: Show how far it is.

    Raises:
        UsageError: If there are no images or the network does not know as many classes as the data.
        DataError: If an image does not decode; the text names it.
    """
    if not len(dataset):
        raise UsageError(f"{dataset.root}: no images to validate on")
    class_count = len(dataset.classes)
    labels: list[Labels] = []
    predictions: list[Predictions] = []
    counts = np.zeros((class_count + 1, class_count + 1), dtype=np.int64)
    indices: Iterable[int] = range(len(dataset))
    if progress:
        indices = track(indices, description="validate", total=len(dataset), unit="images")
    was_training = model.training
    model.to(device=device, memory_format=torch.channels_last).eval()  # type: ignore[call-overload]
    try:
        with torch.inference_mode():
            for batch in _batches(dataset, indices, long_side, batch_size):
                raws = model(_tensor(batch.blob, device)).cpu().float()
                if raws.shape[2] != 5 + class_count:
                    raise UsageError(
                        f"the network knows {raws.shape[2] - 5} classes, the data of {dataset.root} {class_count}"
                    )
                for i, letterbox, raw in zip(batch.indices, batch.letterboxes, raws, strict=True):
                    truth = Labels(dataset.boxes_xyxy(i, letterbox.image_wh), dataset.class_ids[i])
                    labels.append(truth)
                    predictions.append(decode_every_class(raw, letterbox))
                    reported = decode(raw.numpy(), letterbox, score_threshold=score_threshold)
                    counts += count_confusions(
                        truth.boxes_xyxy,
                        truth.class_ids,
                        reported.boxes_xyxy,
                        reported.class_ids,
                        class_count=class_count,
                        iou_threshold=iou_threshold,
                    )
    finally:
        model.train(was_training)
    return DetectionMetrics(
        **asdict(average_precision(labels, predictions, dataset.classes)),
        images=len(dataset),
        labels=sum(len(image.class_ids) for image in labels),
        confusion=ConfusionMatrix(dataset.classes, counts, score_threshold, iou_threshold),
    )


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


def _batches(dataset: ImageDataset, indices: Iterable[int], long_side: int, batch_size: int) -> Iterator[_Batch]:
    """Read images and collect those of equal input size; the last batch of a size may be smaller."""
    buffers: dict[tuple[int, int], InputBuffer] = {}
    waiting: dict[tuple[int, int], _Batch] = {}
    for i in indices:
        image_bgr = dataset.read(i)
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
