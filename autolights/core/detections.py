"""What a detector says about one image."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from autolights.core.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Detections:
    """Boxes with their whole class vectors, a row for each detection.

    Attributes:
        boxes_xyxy: (n, 4) pixels of the original image, edge coordinates.
        objectness: (n,) in [0, 1].
        class_probs: (n, C) independent sigmoids, without objectness: rows need not sum to 1.

    Raises:
        ValueError: If shapes do not fit each other or a number is not finite.
    """

    boxes_xyxy: FloatArray
    objectness: FloatArray
    class_probs: FloatArray

    def __post_init__(self) -> None:
        n = len(self.boxes_xyxy)
        if self.boxes_xyxy.shape != (n, 4) or self.objectness.shape != (n,) or len(self.class_probs) != n:
            raise ValueError(
                f"Detections want (n, 4) boxes, (n,) objectness and (n, C) class_probs, got "
                f"{self.boxes_xyxy.shape}, {self.objectness.shape} and {self.class_probs.shape}"
            )
        if self.class_probs.ndim != 2:
            raise ValueError(f"class_probs must be (n, C), got {self.class_probs.shape}")
        for name in ("boxes_xyxy", "objectness", "class_probs"):
            values = getattr(self, name)
            if not np.isfinite(values).all():
                raise ValueError(f"{name} of detections must be finite, got {values[~np.isfinite(values)][0]}")

    @classmethod
    def empty(cls, class_count: int) -> Self:
        """No detection, for `class_count` classes."""
        return cls(np.empty((0, 4)), np.empty(0), np.empty((0, class_count)))

    @classmethod
    def joined(cls, parts: Sequence["Detections"]) -> Self:
        """The detections of several images, one after the other; at least one image."""
        return cls._of_checked(
            np.concatenate([part.boxes_xyxy for part in parts]),
            np.concatenate([part.objectness for part in parts]),
            np.concatenate([part.class_probs for part in parts]),
        )

    @cached_property
    def scores(self) -> FloatArray:
        """(n,) objectness times the largest class probability."""
        return np.asarray(self.objectness * self.class_probs.max(axis=1, initial=0.0))

    @cached_property
    def class_ids(self) -> IntArray:
        """(n,) index of the most probable class."""
        return np.argmax(self.class_probs, axis=1) if len(self) else np.empty(0, dtype=np.int64)

    def __len__(self) -> int:
        return len(self.boxes_xyxy)

    def __getitem__(self, index: IntArray | BoolArray | slice) -> Self:
        return self._of_checked(self.boxes_xyxy[index], self.objectness[index], self.class_probs[index])

    @classmethod
    def _of_checked(cls, boxes_xyxy: FloatArray, objectness: FloatArray, class_probs: FloatArray) -> Self:
        """Rows of detections that were checked when they were made."""
        rows = object.__new__(cls)
        rows.__dict__.update(boxes_xyxy=boxes_xyxy, objectness=objectness, class_probs=class_probs)
        return rows
