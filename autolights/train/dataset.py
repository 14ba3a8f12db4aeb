"""Training samples: images from a cache, placed, changed and put into batches."""

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from autolights.core.arrays import FloatArray, ImageArray, IntArray
from autolights.core.boxes import cxcywh_from_xyxy
from autolights.core.errors import DataError
from autolights.core.progress import track
from autolights.data.image_dataset import ImageDataset
from autolights.infer.letterbox import GREY
from autolights.train.augment import PixelChanges, flip, may_flip
from autolights.train.config import TrainConfig
from autolights.train.placement import Placement, place_crop, place_mosaic, place_whole, visible_part

_DECODING_THREADS = 2


@dataclass(frozen=True)
class Visit:
    """One image's turn: the sample depends on nothing else, so it is the same in whatever process it is made."""

    epoch: int
    position: int
    index: int


@dataclass(frozen=True, eq=False)
class Sample:
    """A training image of (S, S, 3) RGB and its labels: (n, 5) class, centre, width, height as fractions."""

    image_rgb: ImageArray
    labels: FloatArray
    index: int


@dataclass(frozen=True, eq=False)
class Batch:
    """Samples that pass the network together.

    Attributes:
        images: (B, S, S, 3) RGB, uint8: a quarter of what floats would cost on the way between processes.
        labels: (n, 6) index in the batch, class, centre x, centre y, width, height as fractions.
        indices: Which images of the data set these are.
    """

    images: Tensor
    labels: Tensor
    indices: tuple[int, ...]

    def network_input(self, device: torch.device) -> Tensor:
        """(B, 3, S, S) in [0, 1]; the memory stays channels-last, which is twice as fast on CPUs."""
        return self.images.to(device, non_blocking=True).permute(0, 3, 1, 2).float().div_(255)


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
        """The image, BGR; read-only."""
        return self._kept[index] if index < len(self._kept) else self._read(index)

    def _read(self, index: int) -> ImageArray:
        image = self._images.read(index)
        if self._long_side_px is None or max(image.shape[:2]) == self._long_side_px:
            return image
        scale = self._long_side_px / max(image.shape[:2])
        size_wh = (max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1))
        return np.asarray(cv2.resize(image, size_wh, interpolation=cv2.INTER_LINEAR))


class TrainingSamples(Dataset[Sample]):
    """Random samples of labelled images; indexed by `Visit`."""

    def __init__(self, images: ImageDataset, mirrors: IntArray, config: TrainConfig) -> None:
        """Read the images into memory.

        Args:
            images: What to train on.
            mirrors: (C,) mirror class of each class, −1 for none.
            config: Of the run.
        """
        self._images = images
        self._mirrors = mirrors
        self._config = config
        self._changes = PixelChanges(config.augment)
        self._cache = ImageCache(
            images, long_side_px=None if config.crops else config.image_size, budget_mb=config.cache_mb
        )

    def __len__(self) -> int:
        return len(self._images)

    def __getitem__(self, visit: Visit) -> Sample:
        """Make the sample of a visit."""
        config = self._config.augment
        rng = np.random.default_rng((self._config.seed, visit.epoch, visit.position))
        side_px = self._config.input_side_px
        canvas = np.full((side_px, side_px, 3), GREY, dtype=np.uint8)
        boxes, class_ids = [], []
        for index, placement in self._placements(visit.index, rng):
            image = self._cache[index]
            placement.draw(image, canvas)
            boxes.append(placement.boxes(self._boxes(index, image)))
            class_ids.append(self._images.class_ids[index])
        clipped, kept, seen = visible_part(np.concatenate(boxes), side_px, config)
        ids = np.concatenate(class_ids)
        image_rgb: ImageArray = np.asarray(cv2.cvtColor(canvas, cv2.COLOR_BGR2RGB))
        flipped = rng.random() < config.flip and may_flip(ids[seen], self._mirrors)
        clipped, ids = clipped[kept], ids[kept]
        if flipped:
            image_rgb, clipped, ids = flip(image_rgb, clipped, ids, self._mirrors)
        labels = np.column_stack([ids, cxcywh_from_xyxy(clipped) / side_px]).astype(np.float32)
        return Sample(self._changes(image_rgb, rng), labels, visit.index)

    def _placements(self, index: int, rng: np.random.Generator) -> list[tuple[int, Placement]]:
        config = self._config
        image = self._cache[index]
        if config.crops:
            boxes = self._boxes(index, image)
            return [(index, place_crop(_size_wh(image), boxes, config.crops, config.augment.rotate_deg, rng))]
        if rng.random() >= config.augment.mosaic:
            return [(index, place_whole(_size_wh(image), config.image_size, config.augment, rng))]
        indices = [index, *rng.integers(len(self._images), size=3).tolist()]
        sizes = [_size_wh(self._cache[i]) for i in indices]
        return list(zip(indices, place_mosaic(sizes, config.image_size, config.augment, rng), strict=True))

    def _boxes(self, index: int, image: ImageArray) -> FloatArray:
        return self._images.boxes_xyxy(index, _size_wh(image))


class EpochOrder(Sampler[Visit]):
    """All images in a new order each epoch, each as often as asked."""

    def __init__(self, image_count: int, *, repeats: int, seed: int) -> None:
        self._image_count = image_count
        self._repeats = repeats
        self._seed = seed
        self.epoch = 0

    def __len__(self) -> int:
        return self._image_count * self._repeats

    def __iter__(self) -> Iterator[Visit]:
        order = np.random.default_rng((self._seed, self.epoch)).permutation(len(self)) % self._image_count
        return (Visit(self.epoch, position, index) for position, index in enumerate(order.tolist()))


def batch_loader(samples: TrainingSamples, order: EpochOrder, config: TrainConfig) -> DataLoader[Sample]:
    """Batches of an epoch; set `order.epoch` before each."""
    # Forked workers see the cache without a copy of it; where there is no fork they each get one.
    forked = config.workers > 0 and "fork" in multiprocessing.get_all_start_methods()
    return DataLoader(
        samples,
        batch_size=config.batch,
        sampler=order,
        num_workers=config.workers,
        collate_fn=collate,
        persistent_workers=config.workers > 0,
        multiprocessing_context="fork" if forked else None,
        worker_init_fn=_start_worker,
    )


def iterate(loader: DataLoader[Sample]) -> Iterator[Batch]:
    """The batches of an epoch.

    Raises:
        DataError: If an image does not decode; the text names it.
    """
    try:
        yield from loader
    except DataError as error:
        # From a worker it arrives wrapped in its traceback; what it said is the last line.
        text = str(error).strip()
        if "\n" not in text:
            raise
        raise DataError(text.splitlines()[-1].removeprefix(f"{DataError.__module__}.DataError: ")) from error


def collate(samples: Sequence[Sample]) -> Batch:
    """Put samples into one batch."""
    labels = [
        np.column_stack([np.full(len(sample.labels), i, np.float32), sample.labels]) for i, sample in enumerate(samples)
    ]
    return Batch(
        images=torch.from_numpy(np.stack([sample.image_rgb for sample in samples])),
        labels=torch.from_numpy(np.concatenate(labels)),
        indices=tuple(sample.index for sample in samples),
    )


def _start_worker(_worker_id: int) -> None:
    cv2.setNumThreads(0)  # the training process needs the cores


def _size_wh(image: ImageArray) -> tuple[int, int]:
    return image.shape[1], image.shape[0]
