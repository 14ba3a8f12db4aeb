"""Decoded training images, kept as far as memory allows."""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np

from autolights.core.arrays import ImageArray
from autolights.core.progress import track
from autolights.data.image_dataset import ImageDataset

_DECODING_THREADS = 2


class ImageCache:
    """Decoded images in memory, as far as the budget reaches; workers that are forked later share it."""

    def __init__(self, images: ImageDataset, *, long_side_px: int | None, budget_mb: int) -> None:
        """Read images until the budget is used.

        Args:
            images: Where they come from.
            long_side_px: Resize to this long side; None keeps the size.
            budget_mb: Megabytes.

        Raises:
            DataError: If an image does not decode; the text names it.
        """
        self._images = images
        self._long_side_px = long_side_px
        self._kept: list[ImageArray] = []
        left = budget_mb * 10**6
        with ThreadPoolExecutor(_DECODING_THREADS) as pool:
            for start in track(
                range(0, len(images), 64), description="read images", total=(len(images) + 63) // 64, unit="× 64 images"
            ):
                if left <= 0:
                    break
                for image in pool.map(self._read, range(start, min(start + 64, len(images)))):
                    left -= image.nbytes
                    self._kept.append(image)

    def __getitem__(self, index: int) -> ImageArray:
        """The image, RGB; read-only."""
        return self._kept[index] if index < len(self._kept) else self._read(index)

    def _read(self, index: int) -> ImageArray:
        image = self._images.read(index)
        if self._long_side_px is not None and max(image.shape[:2]) != self._long_side_px:
            scale = self._long_side_px / max(image.shape[:2])
            size_wh = (max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1))
            image = np.asarray(cv2.resize(image, size_wh, interpolation=cv2.INTER_LINEAR))
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
