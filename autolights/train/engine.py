"""A training run from configuration to best checkpoint: the loop to read in one sitting."""

import math
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch.optim import Optimizer

import autolights
from autolights.core import IntArray, load_signals
from autolights.core.atomic import refuse_existing
from autolights.core.config import save_config
from autolights.core.errors import TrainingError, UsageError
from autolights.core.progress import say, track
from autolights.data.image_dataset import ImageDataset, load_image_dataset
from autolights.train.augment import mirror_table
from autolights.train.checkpoint import Checkpoint
from autolights.train.config import TrainConfig
from autolights.train.dataset import TrainingSamples
from autolights.train.ema import WeightAverage
from autolights.train.loader import Batch, BatchLoader
from autolights.train.loss import detection_loss
from autolights.train.metrics import DetectionMetrics
from autolights.train.model import YoloV5
from autolights.train.optimizer import build_optimizer, set_rates
from autolights.train.run_log import EpochRow, RunLog
from autolights.train.schedule import Schedule
from autolights.train.validate import evaluate_detector
from autolights.train.weights import start_from

BEST, LAST, CONFIG, METRICS = "best.pt", "last.pt", "config.yaml", "metrics.json"
_OUTPUTS = (BEST, LAST, CONFIG, METRICS, "results.csv", "tensorboard")
_NAMED_FILES = 8  # of a batch, in an error


@dataclass(frozen=True, eq=False)
class TrainResult:
    """What a run ended with.

    Attributes:
        best_path: Checkpoint of the epoch with the best figures.
        last_path: Checkpoint of the last epoch.
        best_epoch: Which one that was, from 1.
        metrics: The best epoch's figures.
        seconds: How long the run took.
    """

    best_path: Path
    last_path: Path
    best_epoch: int
    metrics: DetectionMetrics
    seconds: float


@dataclass(eq=False)
class _State:
    """All that changes from step to step."""

    model: YoloV5
    average: WeightAverage
    optimizer: Optimizer
    schedule: Schedule
    step: int = 0
    summed_batches: int = 0  # since the optimiser's last step


def train(config: TrainConfig, out_dir: Path, *, force: bool = False) -> TrainResult:
    """Train a detector.

    Args:
        config: Of the run.
        out_dir: Gets ``best.pt``, ``last.pt`` (both with averaged weights), ``config.yaml``, ``results.csv``,
            ``metrics.json`` (of the best epoch) and ``tensorboard/``.
        force: Replace an earlier run in `out_dir`.

    Returns:
        Where the best checkpoint lies and how good it is.

    Raises:
        UsageError: If data or weights are missing, or `out_dir` exists and `force` is not set.
        DataError: If a label or image breaks its format.
        TrainingError: If the loss is no longer finite; the last whole epoch's checkpoint stays.
        KeyboardInterrupt: When interrupted; the last whole epoch's checkpoint stays.
    """
    started = time.monotonic()
    refuse_existing(out_dir, force=force)
    device = _device(config)
    if config.threads:
        torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    images, held_out = _load(config, "train"), _load(config, "val")
    say(f"{len(images)} images with {images.label_count} labels to train on, {len(held_out)} held out")
    model = YoloV5(config.size, len(images.classes), images.classes)
    if config.weights:
        say(f"{config.weights}: {start_from(model, config.weights)}")
    samples = TrainingSamples(images, _mirrors(config, images), config)
    loader = BatchLoader(samples, config)
    state = _start(model.to(device).to(memory_format=torch.channels_last), config, len(loader))
    _clear(out_dir)
    save_config(config, out_dir / CONFIG, comment=f"autolights {autolights.__version__}")

    best: tuple[float, int, DetectionMetrics] | None = None
    epoch = 0
    with RunLog(out_dir) as log:
        try:
            for epoch in range(1, config.epochs + 1):
                epoch_started = time.monotonic()
                losses = _train_epoch(state, loader, samples.images, config, log, epoch)
                metrics = _validate(state, held_out, config) if _validates(config, epoch) else None
                checkpoint = _checkpoint(state.average.model, config, epoch, metrics)
                checkpoint.save(out_dir / LAST)
                if metrics and (best is None or _fitness(metrics) >= best[0]):
                    best = (_fitness(metrics), epoch, metrics)
                    checkpoint.save(out_dir / BEST)
                    metrics.save(out_dir / METRICS)
                rate = state.schedule.at(state.step - 1).rate
                row = EpochRow(epoch, rate, *losses, metrics, time.monotonic() - epoch_started)
                log.epoch(row)
                say(_summary(row, config.epochs))
        except (KeyboardInterrupt, TrainingError):
            if epoch > 1:
                kept = f"{out_dir / LAST} holds epoch {epoch - 1}"
            else:
                _clear(out_dir)
                kept = "no epoch was finished, nothing is kept"
            say(f"stopped in epoch {epoch} of {config.epochs}; {kept}")
            raise
    assert best is not None  # the last epoch is always validated
    return TrainResult(out_dir / BEST, out_dir / LAST, best[1], best[2], time.monotonic() - started)


def _device(config: TrainConfig) -> torch.device:
    try:
        device = torch.device(config.device)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UsageError(f"device '{config.device}' cannot be used here: {str(error).splitlines()[0]}") from error
    return device


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


def _start(model: YoloV5, config: TrainConfig, steps_per_epoch: int) -> _State:
    optimizer = config.optimizer
    # The decay is meant for a step over a nominal batch.
    summed = config.batch * _batches_per_step(config, 1.0)
    return _State(
        model=model,
        average=WeightAverage(model, decay=optimizer.ema_decay, ramp_steps=optimizer.ema_ramp_steps),
        optimizer=build_optimizer(
            model, optimizer, weight_decay=optimizer.weight_decay * summed / config.nominal_batch
        ),
        schedule=Schedule(
            config.schedule,
            steps=config.epochs * steps_per_epoch,
            steps_per_epoch=steps_per_epoch,
            momentum=optimizer.momentum,
        ),
    )


def _batches_per_step(config: TrainConfig, warmed_up: float) -> int:
    """How many batches an optimiser step sums; each batch is one in the warm-up's beginning."""
    wanted = config.nominal_batch / config.batch
    return max(round(1 + warmed_up * (wanted - 1)), 1)


def _clear(out_dir: Path) -> None:
    """Remove what an earlier run left, and nothing else."""
    out_dir.mkdir(parents=True, exist_ok=True)
    for name in _OUTPUTS:
        path = out_dir / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _train_epoch(
    state: _State, loader: BatchLoader, images: ImageDataset, config: TrainConfig, log: RunLog, epoch: int
) -> tuple[float, float, float]:
    """Go once through the loader; mean box, objectness and class losses."""
    device = next(state.model.parameters()).device
    state.model.train()
    sums = np.zeros(3)
    for batch in track(
        loader.epoch(epoch), description=f"epoch {epoch}/{config.epochs}", total=len(loader), unit="batches"
    ):
        if state.step == 0:
            log.batch_picture(batch, images.classes)
        set_rates(state.optimizer, state.schedule.at(state.step))
        maps = state.model.logits(batch.network_input(device))
        losses = detection_loss(
            maps,
            batch.labels.to(device),
            state.model.anchors,
            strides=state.model.strides,
            input_side_px=config.input_side_px,
            config=config.loss,
        )
        if not torch.isfinite(losses.total):
            raise TrainingError(_not_finite(losses.total.item(), batch, images, epoch))
        torch.autograd.backward(losses.total)
        state.summed_batches += 1
        if state.summed_batches >= _batches_per_step(config, state.schedule.warmed_up(state.step)):
            _step(state, config)
        state.step += 1
        sums += [losses.box.item(), losses.objectness.item(), losses.classes.item()]
    box, objectness, classes = (sums / len(loader)).tolist()
    return box, objectness, classes


def _step(state: _State, config: TrainConfig) -> None:
    torch.nn.utils.clip_grad_norm_(state.model.parameters(), config.optimizer.clip_norm)
    state.optimizer.step()
    state.optimizer.zero_grad()
    state.average.update(state.model)
    state.summed_batches = 0


def _not_finite(loss: float, batch: Batch, images: ImageDataset, epoch: int) -> str:
    names = [images.image_paths[i].name for i in batch.indices]
    shown = ", ".join(names[:_NAMED_FILES])
    more = f" and {len(names) - _NAMED_FILES} more" if len(names) > _NAMED_FILES else ""
    return (
        f"the loss became {loss} in epoch {epoch}, on the batch of {shown}{more}; "
        "lower schedule.max_rate, or look at these images' labels"
    )


def _validates(config: TrainConfig, epoch: int) -> bool:
    return epoch == config.epochs or (config.val_every > 0 and epoch % config.val_every == 0)


def _validate(state: _State, held_out: ImageDataset, config: TrainConfig) -> DetectionMetrics:
    return evaluate_detector(
        state.average.model,
        held_out,
        long_side=config.val_long_side or config.image_size,
        score_threshold=config.val_score_threshold,
        device=config.device,
    )


def _fitness(metrics: DetectionMetrics) -> float:
    """AP with a tenth of AP50, as YOLOv5 chooses; 0 where there is nothing to find."""
    fitness = 0.9 * metrics.ap + 0.1 * metrics.ap50
    return 0.0 if math.isnan(fitness) else fitness


def _checkpoint(model: YoloV5, config: TrainConfig, epoch: int, metrics: DetectionMetrics | None) -> Checkpoint:
    return Checkpoint(
        size=model.size,
        classes=model.classes,
        state=dict(model.state_dict()),
        initial_weights=model.initial_weights,
        epoch=epoch,
        metrics=metrics.to_json() if metrics else {},
        config=config.model_dump(mode="json"),
        strides=model.strides,
    )


def _summary(row: EpochRow, epochs: int) -> str:
    text = (
        f"epoch {row.epoch}/{epochs}: box {row.box:.4f}, obj {row.objectness:.4f}, cls {row.classes:.4f}, "
        f"{row.seconds:.0f} s"
    )
    if row.metrics:
        text += f"; AP {row.metrics.ap:.3f}, AP50 {row.metrics.ap50:.3f}"
    return text
