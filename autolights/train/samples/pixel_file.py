"""Decoded images in one file that is mapped into memory: processes share it, and the next run has it at once.

The pixels of the images come one after another, then the inventory in JSON, then its length in eight bytes.
"""

import fcntl
import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from autolights.core.arrays import ImageArray
from autolights.core.atomic import new_file
from autolights.core.errors import DataError

_FORMAT = 1
_LENGTH_BYTES = 8


@dataclass(frozen=True)
class Inventory:
    """What was found when images were decoded.

    Attributes:
        sizes_wh: Of each image, pixels; zeros where it does not decode.
        errors: What is wrong with each; empty where it decodes.
        kept: Indices of those whose pixels were kept.
    """

    sizes_wh: list[tuple[int, int]]
    errors: list[str]
    kept: list[int]


def take_inventory(
    images: Iterable[ImageArray | DataError], budget_bytes: int, keep: Callable[[ImageArray], object]
) -> Inventory:
    """Go through images and keep their pixels until the budget is used."""
    sizes_wh: list[tuple[int, int]] = []
    errors: list[str] = []
    kept: list[int] = []
    for index, image in enumerate(images):
        if isinstance(image, DataError):
            sizes_wh.append((0, 0))
            errors.append(str(image))
            continue
        sizes_wh.append((image.shape[1], image.shape[0]))
        errors.append("")
        if image.nbytes <= budget_bytes:
            keep(image)
            kept.append(index)
            budget_bytes -= image.nbytes
    return Inventory(sizes_wh, errors, kept)


def write_pixel_file(path: Path, images: Iterable[ImageArray | DataError], budget_bytes: int, *, key: str) -> None:
    """Store (H, W, 3) images; `key` says of what they were made."""
    with new_file(path) as temporary, temporary.open("wb") as file:
        inventory = take_inventory(images, budget_bytes, lambda image: file.write(image.data))
        description = json.dumps({"format": _FORMAT, "key": key, **asdict(inventory)}).encode()
        file.write(description)
        file.write(len(description).to_bytes(_LENGTH_BYTES, "little"))


def read_pixel_file(path: Path, *, key: str) -> tuple[Inventory, list[ImageArray]] | None:
    """The inventory and the kept images, read-only; None if there is no such file or it was made of something else."""
    try:
        content = np.memmap(path, dtype=np.uint8, mode="r").view(np.ndarray)
        length = int.from_bytes(content[-_LENGTH_BYTES:].tobytes(), "little")
        description = json.loads(content[-_LENGTH_BYTES - length : -_LENGTH_BYTES].tobytes())
    except (FileNotFoundError, ValueError):  # the latter if it is empty or was cut
        return None
    if (description.pop("format"), description.pop("key")) != (_FORMAT, key):
        return None
    inventory = Inventory(**description)
    images, start = [], 0
    for index in inventory.kept:
        width, height = inventory.sizes_wh[index]
        stop = start + height * width * 3
        images.append(content[start:stop].reshape(height, width, 3))
        start = stop
    return inventory, images


@contextmanager
def only_one_process(lock: Path) -> Iterator[None]:
    """Let the processes of this machine into the block one after another; a killed one lets go of the lock."""
    lock.parent.mkdir(parents=True, exist_ok=True)
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
