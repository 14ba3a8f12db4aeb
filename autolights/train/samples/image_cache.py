"""Decoded training images: read once, kept in memory or in a file as far as the budget reaches."""

import hashlib
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from autolights.core.arrays import ImageArray, IntArray
from autolights.core.errors import DataError
from autolights.core.progress import say, track
from autolights.data.image_dataset import ImageDataset
from autolights.train.samples.pixel_file import (
    Inventory,
    only_one_process,
    read_pixel_file,
    take_inventory,
    write_pixel_file,
)

_DECODING_THREADS = min(os.cpu_count() or 1, 8)
_IN_FLIGHT = 64  # images that are decoded ahead
_NAMED_FILES = 8  # in a message


class ImageCache:
    """Decoded images; workers that are forked later share them.

    All images are decoded once at the start, so that those which do not decode are known before the first epoch.

    Attributes:
        images: Those that decode.
        sizes_wh: (n, 2) of each as it is kept, pixels.
    """

    def __init__(
        self,
        images: ImageDataset,
        *,
        long_side_px: int | None,
        budget_mb: int,
        folder: Path | None = None,
        bad_share: float = 0.0,
    ) -> None:
        """Read the images.

        Args:
            images: Where they come from.
            long_side_px: Resize to this long side; None keeps the size.
            budget_mb: Megabytes; images beyond are decoded each time they are asked for.
            folder: Keep them in a file in this folder, for the next run and for other processes; None: in memory.
            bad_share: Largest share of images that do not decode; they are left out.

        Raises:
            DataError: If more of them do not decode; the text names them.
        """
        self._long_side_px = long_side_px
        if folder is None:
            pixels: list[ImageArray] = []
            inventory = take_inventory(_decoded(images, long_side_px), budget_mb * 10**6, pixels.append)
        else:
            inventory, pixels = _from_file(folder, images, long_side_px, budget_mb)
        _refuse_too_many(images, [error for error in inventory.errors if error], bad_share)
        good = [index for index, error in enumerate(inventory.errors) if not error]
        kept = dict(zip(inventory.kept, pixels, strict=True))
        self.images = images.subset(good)
        self.sizes_wh: IntArray = np.array([inventory.sizes_wh[index] for index in good])
        self._pixels = [kept.get(index) for index in good]

    def __getitem__(self, index: int) -> ImageArray:
        """The image, RGB; read-only."""
        kept = self._pixels[index]
        return _decode(self.images, index, self._long_side_px) if kept is None else kept


def _from_file(
    folder: Path, images: ImageDataset, long_side_px: int | None, budget_mb: int
) -> tuple[Inventory, list[ImageArray]]:
    """The images from a file that was written of just these; it is written now if there is none."""
    # A folder of images has one file for each long side, so that what changes replaces it and leaves nothing behind.
    place = hashlib.sha256(f"{images.image_paths[0].parent.resolve()} {long_side_px}".encode()).hexdigest()[:16]
    content = hashlib.sha256(str(budget_mb).encode())
    for path in images.image_paths:
        status = path.stat()
        content.update(f"{path.name} {status.st_size} {status.st_mtime_ns}\n".encode())
    path, key = folder / f"{place}.pixels", content.hexdigest()
    with only_one_process(folder / f"{place}.lock"):
        stored = read_pixel_file(path, key=key)
        if stored is None:
            write_pixel_file(path, _decoded(images, long_side_px), budget_mb * 10**6, key=key)
            stored = read_pixel_file(path, key=key)
    assert stored is not None
    return stored


def _refuse_too_many(images: ImageDataset, errors: list[str], bad_share: float) -> None:
    if not errors:
        return
    shown = "; ".join(errors[:_NAMED_FILES])
    more = f"; and {len(errors) - _NAMED_FILES} more" if len(errors) > _NAMED_FILES else ""
    found = f"{len(errors)} of {len(images)} images cannot be used ({shown}{more})"
    if len(errors) > bad_share * len(images) or len(errors) == len(images):
        raise DataError(f"{images.root}: {found}; bad_images={bad_share:g} is the largest share that is left out")
    say(f"{images.root}: {found}; left out")


def _decoded(images: ImageDataset, long_side_px: int | None) -> Iterator[ImageArray | DataError]:
    """All images in their order, or what is wrong with them."""

    def decode(index: int) -> ImageArray | DataError:
        try:
            return _decode(images, index, long_side_px)
        except DataError as error:
            return error

    starts = range(0, len(images), _IN_FLIGHT)
    with ThreadPoolExecutor(_DECODING_THREADS) as pool:
        for start in track(starts, description="read images", total=len(starts), unit=f"× {_IN_FLIGHT} images"):
            yield from pool.map(decode, range(start, min(start + _IN_FLIGHT, len(images))))


def _decode(images: ImageDataset, index: int, long_side_px: int | None) -> ImageArray:
    image = images.read(index)
    if long_side_px is not None and max(image.shape[:2]) != long_side_px:
        scale = long_side_px / max(image.shape[:2])
        size_wh = (max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1))
        image = np.asarray(cv2.resize(image, size_wh, interpolation=cv2.INTER_LINEAR))
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
