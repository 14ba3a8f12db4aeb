"""A picture of a training batch: what the network really sees, with its labels."""

from collections.abc import Sequence

import cv2
import numpy as np

from autolights.core.arrays import ImageArray
from autolights.train.samples.loader import Batch

_PICTURED = 16  # samples, in rows of four
_COLOUR_RGB = (0, 255, 255)


def draw_batch(batch: Batch, classes: Sequence[str]) -> ImageArray:
    """Up to 16 samples in rows of four, labels drawn in; RGB."""
    pictures = []
    for i, image in enumerate(batch.images[:_PICTURED].numpy()):
        picture = image.copy()
        height_px, width_px = picture.shape[:2]
        for _, class_id, cx, cy, width, height in batch.labels[batch.labels[:, 0] == i].tolist():
            left, right = round((cx - width / 2) * width_px), round((cx + width / 2) * width_px)
            top, bottom = round((cy - height / 2) * height_px), round((cy + height / 2) * height_px)
            cv2.rectangle(picture, (left, top), (right, bottom), _COLOUR_RGB, 1)
            cv2.putText(
                picture, classes[int(class_id)], (left, top - 2), cv2.FONT_HERSHEY_SIMPLEX, 0.35, _COLOUR_RGB, 1
            )
        pictures.append(picture)
    columns = min(4, len(pictures))
    pictures += [np.zeros_like(pictures[0])] * (-len(pictures) % columns)
    rows = [np.concatenate(pictures[i : i + columns], axis=1) for i in range(0, len(pictures), columns)]
    return np.concatenate(rows)
