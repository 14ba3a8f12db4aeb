"""The detector's confusion matrix, background included."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from autolights.core.arrays import IntArray
from autolights.core.calibration import Calibration
from autolights.core.errors import DataError
from autolights.core.json_files import read_json_object, write_json


@dataclass(frozen=True)
class CountedWith:
    """The model file whose detections were counted.

    Attributes:
        sha256: Of ``model.onnx``, or of the checkpoint.
        precision: Of its weights and arithmetic: fp32, fp16 or int8.
    """

    sha256: str
    precision: str

    def to_json(self) -> dict[str, str]:
        """As JSON-ready values."""
        return {"sha256": self.sha256, "precision": self.precision}

    @classmethod
    def from_json(cls, values: Any) -> Self | None:
        """Read what `to_json` gave; nothing gives None.

        Raises:
            DataError: If it is something else.
        """
        if values is None:
            return None
        if not (isinstance(values, dict) and set(values) == {"sha256", "precision"}):
            raise DataError(f"counted_with must hold sha256 and precision, got {values!r}")
        return cls(str(values["sha256"]), str(values["precision"]))

    def __str__(self) -> str:
        return f"the {self.precision} model {self.sha256[:12]}…"


@dataclass(frozen=True, eq=False)
class ConfusionMatrix:
    """How often a class was shown and another one seen.

    Attributes:
        classes: C names, in the detector's order.
        counts: (C + 1, C + 1) integers `[truth, predicted]`; the last row counts false alarms, the last column misses.
        score_threshold: Detections below it were not counted.
        iou_threshold: Overlap from which a detection counts as the truth's.
        calibration: What the class probabilities of the same detections are worth; None if nobody measured it.
        counted_with: The model; None if it is not known (files of before there were 8-bit models).
    """

    classes: tuple[str, ...]
    counts: IntArray
    score_threshold: float
    iou_threshold: float
    calibration: Calibration | None = None
    counted_with: CountedWith | None = None

    def __post_init__(self) -> None:
        size = len(self.classes) + 1
        if self.counts.shape != (size, size):
            raise ValueError(f"counts must be ({size}, {size}) for {size - 1} classes, got {self.counts.shape}")
        if (self.counts < 0).any():
            raise ValueError("counts must not be negative")

    def to_json(self) -> dict[str, Any]:
        """The matrix as JSON-ready values."""
        return {
            "classes": list(self.classes),
            "counts": self.counts.tolist(),
            "score_threshold": self.score_threshold,
            "iou_threshold": self.iou_threshold,
            "calibration": None if self.calibration is None else self.calibration.to_json(),
            **({"counted_with": self.counted_with.to_json()} if self.counted_with else {}),
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Read what `to_json` gave.

        Raises:
            DataError: If a field is missing or the counts do not fit the classes.
        """
        calibration = values.get("calibration")
        try:
            return cls(
                classes=tuple(values["classes"]),
                counts=np.asarray(values["counts"], dtype=np.int64),
                score_threshold=float(values["score_threshold"]),
                iou_threshold=float(values["iou_threshold"]),
                calibration=None if calibration is None else Calibration.from_json(calibration),
                counted_with=CountedWith.from_json(values.get("counted_with")),
            )
        except KeyError as error:
            raise DataError(f"confusion matrix: field {error} is missing") from error
        except (TypeError, ValueError) as error:
            raise DataError(f"confusion matrix: {error}") from error

    def save(self, path: Path) -> None:
        """Write the matrix as JSON."""
        write_json(path, self.to_json())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a matrix that `save` wrote.

        Raises:
            DataError: If the file is missing, is no JSON or breaks the format; the text names the file.
        """
        values = read_json_object(path)
        try:
            return cls.from_json(values)
        except DataError as error:
            raise DataError(f"{path}: {error}") from error
