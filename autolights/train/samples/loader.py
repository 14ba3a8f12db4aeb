"""Batches of training samples: in which order, shared among which processes, made by which workers."""

import itertools
import math
import multiprocessing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler, get_worker_info

from autolights.core.arrays import IntArray
from autolights.core.errors import DataError
from autolights.train.config import TrainConfig
from autolights.train.processes import ALONE, Processes
from autolights.train.samples.dataset import TrainingSamples, Visit

_AHEAD = 2  # batches that each worker makes in advance


@dataclass(frozen=True, eq=False)
class Batch:
    """Samples that pass the network together.

    Attributes:
        images: (B, H, W, 3) RGB, uint8: a quarter of what floats would cost on the way between processes.
        labels: (n, 6) index in the batch, class, centre x, centre y, width, height as fractions; float32.
        indices: Which images of the data set these are.
    """

    images: Tensor
    labels: Tensor
    indices: tuple[int, ...]

    def network_input(self, device: torch.device) -> Tensor:
        """(B, 3, H, W) in [0, 1]; the memory stays channels-last, which is twice as fast on CPUs."""
        return self.images.to(device, non_blocking=True).permute(0, 3, 1, 2).float().div_(255)

    def pin_memory(self) -> Self:
        """The same in memory from which a GPU can copy while it computes; torch's loader calls this."""
        return replace(self, images=self.images.pin_memory(), labels=self.labels.pin_memory())


class BatchLoader:
    """The batches of each epoch, as this process gets them."""

    def __init__(self, samples: TrainingSamples, config: TrainConfig, processes: Processes = ALONE) -> None:
        """Prepare the workers; they start with the first epoch.

        Args:
            samples: What the batches are made of.
            config: Of the run; its `batch` is that of all processes together.
            processes: Which share is wanted.
        """
        self._order = EpochOrder(
            samples.canvases_wh,
            repeats=config.crops.per_image if config.crops else 1,
            seed=config.seed,
            batch=config.batch,
            processes=processes,
        )
        # Forked workers see the cache without a copy of it; where there is no fork they each get one.
        forked = config.workers > 0 and "fork" in multiprocessing.get_all_start_methods()
        self._loader: DataLoader[Batch] = DataLoader(
            _Batches(samples, -(-config.batch // processes.size)),
            batch_size=None,  # what the order yields is a batch already
            sampler=self._order,
            num_workers=config.workers,
            persistent_workers=config.workers > 0,
            multiprocessing_context="fork" if forked else None,
            prefetch_factor=_AHEAD if config.workers else None,
            pin_memory=torch.device(config.device).type == "cuda",
            worker_init_fn=_start_worker,
        )

    def __len__(self) -> int:
        """Batches in an epoch; the same for each process."""
        return len(self._order)

    def epoch(self, number: int) -> Iterator[Batch]:
        """The batches of an epoch, counted from 1; each is overwritten some time after the next is asked for.

        Raises:
            DataError: If an image no longer decodes; the text names it.
        """
        self._order.epoch = number
        try:
            yield from self._loader
        except DataError as error:
            # From a worker it arrives wrapped in its traceback; what it said is the last line.
            text = str(error).strip()
            if "\n" not in text:
                raise
            raise DataError(text.splitlines()[-1].removeprefix(f"{DataError.__module__}.DataError: ")) from error


class EpochOrder(Sampler[list[Visit]]):
    """All images in a new order each epoch, each as often as asked, in batches.

    A batch gets the smallest canvas that holds what each of its images asks for; images that ask alike come together.
    The order over all processes does not depend on how many they are: each batch is dealt out among them in turn. A
    last batch that is not full is cut to a multiple of their number.
    """

    def __init__(
        self, canvases_wh: IntArray, *, repeats: int, seed: int, batch: int, processes: Processes = ALONE
    ) -> None:
        """Set up.

        Args:
            canvases_wh: (n, 2) size of the input that each image asks for, pixels.
            repeats: Visits of each image in an epoch.
            seed: Of the order.
            batch: Images in a batch of all processes together; a multiple of their number.
            processes: Which share is wanted.
        """
        self._canvases_wh = canvases_wh
        self._repeats = repeats
        self._seed = seed
        self._batch = batch
        self._processes = processes
        self.epoch = 0

    def __len__(self) -> int:
        size = self._processes.size
        return -(-(len(self._canvases_wh) * self._repeats // size * size) // self._batch)

    def __iter__(self) -> Iterator[list[Visit]]:
        order = self._shuffled()
        rank, size = self._processes.rank, self._processes.size
        for start in range(0, len(order) // size * size, self._batch):
            indices = order[start : start + self._batch]
            width, height = self._canvases_wh[indices].max(axis=0).tolist()
            for_all = [
                Visit(self.epoch, position, index, (width, height))
                for position, index in enumerate(indices.tolist(), start=start)
            ]
            yield for_all[rank : len(for_all) // size * size : size]

    def _shuffled(self) -> IntArray:
        """Indices of images, in batches of like shape; images of a shape are shuffled, and so are the full batches."""
        generator = np.random.default_rng((self._seed, self.epoch))
        count = len(self._canvases_wh)
        order = generator.permutation(count * self._repeats) % count
        order = order[np.lexsort(self._canvases_wh[order].T)]  # keeps the order of equals
        full = len(order) // self._batch
        batches = order[: full * self._batch].reshape(full, self._batch)
        return np.concatenate([generator.permutation(batches).ravel(), order[full * self._batch :]])


class _Batches(Dataset[Batch]):
    """Batches made where they are asked for, in a worker or here."""

    def __init__(self, samples: TrainingSamples, largest_batch: int) -> None:
        self._samples = samples
        self._largest_bytes = largest_batch * int(samples.canvases_wh.max(axis=0).prod()) * 3
        self._shared: Iterator[Tensor] | None = None

    def __getitem__(self, visits: Sequence[Visit]) -> Batch:
        width, height = visits[0].canvas_wh
        images = self._empty((len(visits), height, width, 3))
        labels = []
        for i, visit in enumerate(visits):
            rows = self._samples.draw(visit, images[i].numpy())
            labels.append(np.column_stack([np.full(len(rows), i), rows]))
        return Batch(
            images=images,
            labels=torch.from_numpy(np.concatenate(labels).astype(np.float32)),
            indices=tuple(visit.index for visit in visits),
        )

    def _empty(self, shape: tuple[int, ...]) -> Tensor:
        """Memory for images; that of a worker is shared with the training process and used again and again.

        Fresh shared memory would cost as much as what is drawn in it. The training process asks for a batch of this
        worker when it is done with the one before, and then `_AHEAD` may be waiting or in the making.
        """
        if not get_worker_info():
            return torch.empty(shape, dtype=torch.uint8)
        if self._shared is None:
            buffers = [torch.empty(self._largest_bytes, dtype=torch.uint8) for _ in range(_AHEAD + 1)]
            for buffer in buffers:
                buffer.share_memory_()  # type: ignore[no-untyped-call]
            self._shared = itertools.cycle(buffers)
        return next(self._shared)[: math.prod(shape)].view(shape)


def _start_worker(_worker_id: int) -> None:
    cv2.setNumThreads(0)  # the training process needs the cores
