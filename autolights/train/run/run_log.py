"""The figures of a run's epochs for people: lines of results.csv and TensorBoard's curves."""

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from autolights.core.arrays import ImageArray
from autolights.core.atomic import write_text
from autolights.train.measure.metrics import DetectionMetrics

_FIGURES = ("ap", "ap50", "ap75", "ap_s", "ap_m")


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

    @property
    def losses(self) -> dict[str, float]:
        """By column."""
        return {"box": self.box, "obj": self.objectness, "cls": self.classes}

    @property
    def figures(self) -> dict[str, float]:
        """By column; NaN where there are none."""
        return {name: getattr(self.metrics, name) if self.metrics else math.nan for name in _FIGURES}

    def cells(self) -> dict[str, str]:
        """The line as text, by column."""
        numbers = {**self.losses, **self.figures}
        return {
            "epoch": str(self.epoch),
            "lr": f"{self.rate:.3g}",
            **{name: "" if math.isnan(value) else f"{value:.5f}" for name, value in numbers.items()},
            "seconds": f"{self.seconds:.1f}",
        }

    def summary(self, epochs: int) -> str:
        """The line for the terminal, with the time that is left at this pace."""
        text = (
            f"epoch {self.epoch}/{epochs}: box {self.box:.4f}, obj {self.objectness:.4f}, cls {self.classes:.4f}, "
            f"{self.seconds:.0f} s"
        )
        if self.metrics:
            text += f"; AP {self.metrics.ap:.3f}, AP50 {self.metrics.ap50:.3f}"
        left_min = (epochs - self.epoch) * self.seconds / 60
        return f"{text}; {left_min:.0f} min left" if left_min >= 1 else text


def write_results(path: Path, rows: list[dict[str, str]]) -> None:
    """Write results.csv: whole, so that a run that goes on leaves no line twice."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


class Curves:
    """TensorBoard's view of a run."""

    def __init__(self, folder: Path, *, epochs_done: int) -> None:
        """Go on after so many epochs; what a run that was stopped has noted of later ones is hidden."""
        self._writer = SummaryWriter(str(folder), purge_step=epochs_done + 1 if epochs_done else None)

    def epoch(self, row: EpochRow) -> None:
        """Note an epoch."""
        self._writer.add_scalar("rate", row.rate, row.epoch)
        for name, value in row.losses.items():
            self._writer.add_scalar(f"loss/{name}", value, row.epoch)
        for name, value in row.figures.items():
            if not math.isnan(value):
                self._writer.add_scalar(f"metrics/{name}", value, row.epoch)
        self._writer.flush()

    def picture(self, name: str, image_rgb: ImageArray, epoch: int) -> None:
        """Show a picture."""
        self._writer.add_image(name, image_rgb, epoch, dataformats="HWC")

    def close(self) -> None:
        """Write what is left."""
        self._writer.close()
