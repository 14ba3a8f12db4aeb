"""What a run starts from: data and their share for this process, the network, and everything at step 0."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor
from torch.amp.grad_scaler import GradScaler

from autolights.core import IntArray, load_signals
from autolights.core.errors import UsageError
from autolights.core.progress import say
from autolights.data.image_dataset import ImageDataset, load_image_dataset
from autolights.train.config import TrainConfig
from autolights.train.learning.anchors import fit_anchors
from autolights.train.learning.ema import WeightAverage
from autolights.train.learning.loss import class_weights
from autolights.train.learning.optimizer import build_optimizer
from autolights.train.learning.schedule import Schedule
from autolights.train.network.model import FINE_STRIDES, STRIDES, YoloV5
from autolights.train.network.weights import start_from
from autolights.train.processes import Processes
from autolights.train.run.run_state import RunState
from autolights.train.samples.augment import mirror_table
from autolights.train.samples.dataset import TrainingSamples
from autolights.train.samples.loader import BatchLoader


@dataclass(frozen=True, eq=False)
class TrainingData:
    """What a run learns from and is measured on.

    Attributes:
        samples: Of the images to train on.
        loader: Their batches, this process's share.
        held_out: For validation.
    """

    samples: TrainingSamples
    loader: BatchLoader
    held_out: ImageDataset

    @property
    def images(self) -> ImageDataset:
        """To train on."""
        return self.samples.images

    @property
    def fingerprint(self) -> str:
        """Changes with any image or label of either part."""
        return f"{self.images.fingerprint}-{self.held_out.fingerprint}"

    def class_weights(self, power: float) -> Tensor | None:
        """For the loss; None if all classes count alike."""
        return class_weights(self.images.class_counts.tolist(), power) if power else None


def check_feasible(config: TrainConfig, processes: Processes, device: torch.device) -> None:
    """Refuse what these processes or this device cannot do.

    Raises:
        UsageError: The text names the setting.
    """
    if config.batch % processes.size:
        nearest = max(round(config.batch / processes.size), 1) * processes.size
        raise UsageError(
            f"batch is that of all processes together and must be a multiple of their number {processes.size}, "
            f"got {config.batch}; try batch={nearest}"
        )
    if config.precision == "fp16" and device.type == "cpu":
        raise UsageError("precision=fp16 needs a GPU; on a CPU take fp32 or bf16")


def load_training_data(config: TrainConfig, processes: Processes) -> TrainingData:
    """Read labels and images, and say what was found.

    Raises:
        UsageError: If data are missing.
        DataError: If a label breaks its format, or too many images do not decode.
    """
    images, held_out = _load(config, "train"), _load(config, "val")
    say(f"{len(images)} images with {images.label_count} labels to train on, {len(held_out)} held out")
    if images.empty_classes:
        say(f"warning: no label to train on for {', '.join(images.empty_classes)}: never to be detected")
    samples = TrainingSamples(images, _mirrors(config, images), config)
    return TrainingData(samples, BatchLoader(samples, config, processes), held_out)


def build_model(config: TrainConfig, classes: tuple[str, ...]) -> YoloV5:
    """The network, with random weights."""
    strides = FINE_STRIDES if config.finest_stride == min(FINE_STRIDES) else STRIDES
    return YoloV5(config.size, len(classes), classes, strides=strides)


def initialise(model: YoloV5, config: TrainConfig) -> None:
    """Give a network the weights that it starts with, and say which.

    Raises:
        UsageError: If the weights' file is missing.
        CheckpointError: If it cannot be read or is of another size.
    """
    if config.weights:
        say(f"{config.weights}: {start_from(model, config.weights)}")


def check_anchors(model: YoloV5, config: TrainConfig, samples: TrainingSamples) -> None:
    """Let the anchors fit the labels, if that is wanted, and say how far they do."""
    if config.anchors == "auto":
        say(fit_anchors(model, samples.sides_px(), seed=config.seed))


def start(model: YoloV5, config: TrainConfig) -> RunState:
    """Everything as it is before the first step.

    Args:
        model: On its device.
        config: Of the run.
    """
    optimizer = config.optimizer
    # The decay is meant for a step over a nominal batch.
    summed = config.batch * batches_per_step(config, 1.0)
    return RunState(
        model=model,
        average=WeightAverage(model, decay=optimizer.ema_decay, ramp_steps=optimizer.ema_ramp_steps),
        optimizer=build_optimizer(
            model, optimizer, weight_decay=optimizer.weight_decay * summed / config.nominal_batch
        ),
        scaler=GradScaler(model.anchors.device.type, enabled=config.precision == "fp16"),
    )


def schedule_of(config: TrainConfig, steps_per_epoch: int) -> Schedule:
    """The rates over the whole run."""
    return Schedule(
        config.schedule,
        steps=config.epochs * steps_per_epoch,
        steps_per_epoch=steps_per_epoch,
        momentum=config.optimizer.momentum,
    )


def batches_per_step(config: TrainConfig, warmed_up: float) -> int:
    """How many batches an optimiser step sums; each batch is one in the warm-up's beginning."""
    wanted = config.nominal_batch / config.batch
    return max(round(1 + warmed_up * (wanted - 1)), 1)


def _load(config: TrainConfig, split: Literal["train", "val"]) -> ImageDataset:
    return load_image_dataset(
        Path(config.data),
        split,
        classes=config.classes or None,
        val_fraction=config.val_fraction,
        group_pattern=config.group_pattern,
    )


def _mirrors(config: TrainConfig, images: ImageDataset) -> IntArray:
    name = config.signals or images.signals
    if config.mirrors or not name:
        return mirror_table(images.classes, None, config.mirrors)
    return mirror_table(images.classes, load_signals(name if "/" in name else f"signals/{name}"), {})
