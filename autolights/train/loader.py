"""Batches of training samples: in which order, shared among which processes, made by which workers."""

import multiprocessing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from autolights.core.arrays import IntArray
from autolights.core.errors import DataError
from autolights.train.config import TrainConfig
from autolights.train.dataset import TrainingSamples, Visit
from autolights.train.processes import ALONE, Processes


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
            _Batches(samples),
            batch_size=None,  # what the order yields is a batch already
            sampler=self._order,
            num_workers=config.workers,
            persistent_workers=config.workers > 0,
            multiprocessing_context="fork" if forked else None,
            worker_init_fn=_start_worker,
        )

    def __len__(self) -> int:
        """Batches in an epoch; the same for each process."""
        return len(self._order)

    def epoch(self, number: int) -> Iterator[Batch]:
        """The batches of an epoch, counted from 1.

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
        count = len(self._canvases_wh)
        order = np.random.default_rng((self._seed, self.epoch)).permutation(count * self._repeats) % count
        rank, size = self._processes.rank, self._processes.size
        for start in range(0, len(order) // size * size, self._batch):
            indices = order[start : start + self._batch]
            width, height = self._canvases_wh[indices].max(axis=0).tolist()
            for_all = [
                Visit(self.epoch, position, index, (width, height))
                for position, index in enumerate(indices.tolist(), start=start)
            ]
            yield for_all[rank : len(for_all) // size * size : size]


class _Batches(Dataset[Batch]):
    """Batches made where they are asked for, in a worker or here."""

    def __init__(self, samples: TrainingSamples) -> None:
        self._samples = samples

    def __getitem__(self, visits: Sequence[Visit]) -> Batch:
        width, height = visits[0].canvas_wh
        images = torch.empty((len(visits), height, width, 3), dtype=torch.uint8)
        labels = []
        for i, visit in enumerate(visits):
            rows = self._samples.draw(visit, images[i].numpy())
            labels.append(np.column_stack([np.full(len(rows), i), rows]))
        return Batch(
            images=images,
            labels=torch.from_numpy(np.concatenate(labels).astype(np.float32)),
            indices=tuple(visit.index for visit in visits),
        )


def _start_worker(_worker_id: int) -> None:
    cv2.setNumThreads(0)  # the training process needs the cores
