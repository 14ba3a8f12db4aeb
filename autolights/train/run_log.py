"""What a run leaves behind for people: results.csv, TensorBoard curves and a picture of a batch."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np
from torch.utils.tensorboard import SummaryWriter

from autolights.core.arrays import ImageArray
from autolights.train.loader import Batch
from autolights.train.metrics import DetectionMetrics

_FIGURES = ("ap", "ap50", "ap75", "ap_s", "ap_m")
_PICTURED = 16  # samples of the first batch, in rows of four


@dataclass(frozen=True)
class EpochRow:
    """One line of results.csv: mean losses of the epoch, and the figures if it was validated."""

    epoch: int
    rate: float
    box: float
    objectness: float
    classes: float
    metrics: DetectionMetrics | None
    seconds: float


class RunLog:
    """Writes results.csv and TensorBoard events while the run goes on; a context manager."""

    def __init__(self, out_dir: Path) -> None:
        self._writer = SummaryWriter(str(out_dir / "tensorboard"))
        # Line-buffered: whoever looks sees every finished epoch.
        self._file = (out_dir / "results.csv").open("w", encoding="utf-8", newline="", buffering=1)
        self._csv = csv.writer(self._file)
        self._csv.writerow(["epoch", "lr", "box", "obj", "cls", *_FIGURES, "seconds"])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.close()
        self._file.close()

    def epoch(self, row: EpochRow) -> None:
        """Note an epoch."""
        figures = {name: getattr(row.metrics, name) for name in _FIGURES} if row.metrics else {}
        losses = {"box": row.box, "obj": row.objectness, "cls": row.classes}
        cells = [*losses.values(), *(figures.get(name, math.nan) for name in _FIGURES)]
        self._csv.writerow(
            [
                row.epoch,
                f"{row.rate:.3g}",
                *("" if math.isnan(cell) else f"{cell:.5f}" for cell in cells),
                f"{row.seconds:.1f}",
            ]
        )
        self._writer.add_scalar("rate", row.rate, row.epoch)
        for name, value in losses.items():
            self._writer.add_scalar(f"loss/{name}", value, row.epoch)
        for name, value in figures.items():
            if not math.isnan(value):
                self._writer.add_scalar(f"metrics/{name}", value, row.epoch)

    def batch_picture(self, batch: Batch, classes: Sequence[str]) -> None:
        """Show samples of a batch with their labels, as the network sees them."""
        self._writer.add_image("batch", draw_batch(batch, classes), 0, dataformats="HWC")


def draw_batch(batch: Batch, classes: Sequence[str]) -> ImageArray:
    """Up to 16 samples in rows of four, labels drawn in; RGB."""
    pictures = []
    for i, image in enumerate(batch.images[:_PICTURED].numpy()):
        picture = image.copy()
        side_px = picture.shape[0]
        for _, class_id, cx, cy, width, height in batch.labels[batch.labels[:, 0] == i].tolist():
            left, top = round((cx - width / 2) * side_px), round((cy - height / 2) * side_px)
            right, bottom = round((cx + width / 2) * side_px), round((cy + height / 2) * side_px)
            cv2.rectangle(picture, (left, top), (right, bottom), (0, 255, 255), 1)
            cv2.putText(
                picture, classes[int(class_id)], (left, top - 2), cv2.FONT_HERSHEY_SIMPLEX, 0.35, (0, 255, 255), 1
            )
        pictures.append(picture)
    columns = min(4, len(pictures))
    pictures += [np.zeros_like(pictures[0])] * (-len(pictures) % columns)
    rows = [np.concatenate(pictures[i : i + columns], axis=1) for i in range(0, len(pictures), columns)]
    return np.concatenate(rows)
