"""A training run from configuration to best checkpoint: the loop to read in one sitting."""

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from autolights.core.atomic import refuse_existing
from autolights.core.errors import AutolightsError, TrainingError
from autolights.core.progress import say, track
from autolights.data.image_dataset import ImageDataset
from autolights.train.config import TrainConfig
from autolights.train.measure.metrics import DetectionMetrics
from autolights.train.measure.validate import DatasetDetections, detect_dataset
from autolights.train.memory import keep_freed_memory
from autolights.train.processes import Processes
from autolights.train.run.distributed import copy_from_main, join_processes, told_by_main
from autolights.train.run.environment import describe_environment
from autolights.train.run.out_of_memory import advise
from autolights.train.run.pictures import draw_batch
from autolights.train.run.preparation import (
    TrainingData,
    build_model,
    check_anchors,
    check_feasible,
    initialise,
    load_training_data,
    schedule_of,
    start,
)
from autolights.train.run.run_folder import BEST, LAST, STATE, RunFolder
from autolights.train.run.run_log import EpochRow
from autolights.train.run.run_state import Best, RunState, SavedState
from autolights.train.run.steps import Steps
from autolights.train.samples.loader import Batch

_NAMED_FILES = 8  # of a batch, in an error


@dataclass(frozen=True, eq=False)
class TrainResult:
    """What a run ended with.

    Attributes:
        best_path: Checkpoint of the epoch with the best figures.
        last_path: Checkpoint of the last epoch.
        best_epoch: Which one that was, from 1.
        metrics: The best epoch's figures, as in ``metrics.json``.
        seconds: How long it took, since it was started or resumed.
    """

    best_path: Path
    last_path: Path
    best_epoch: int
    metrics: dict[str, Any]
    seconds: float


@dataclass(frozen=True, eq=False)
class _Run:
    """What stays the same from epoch to epoch, and the state that does not.

    `folder` is None in all processes but the main one.
    """

    config: TrainConfig
    data: TrainingData
    state: RunState
    steps: Steps
    processes: Processes
    device: torch.device
    folder: RunFolder | None


def train(config: TrainConfig, out_dir: Path, *, force: bool = False, resume: bool = False) -> TrainResult:
    """Train a detector; under torchrun together with the other processes.

    Args:
        config: Of the run.
        out_dir: Gets ``best.pt`` and ``last.pt`` (averaged weights), ``state.pt`` (to go on from), ``config.yaml``,
            ``environment.json``, ``results.csv``, ``metrics.json`` (of the best epoch), pictures and ``tensorboard/``.
            Only the main process needs to see it.
        force: Replace an earlier run in `out_dir`, once the first epoch is done.
        resume: Go on with the run in `out_dir` as if it had never been stopped; if it has no whole epoch yet, begin.

    Returns:
        Where the best checkpoint lies and how good it is.

    Raises:
        UsageError: If data or weights are missing, `out_dir` exists and neither `force` nor `resume` is set, or the run
            to go on with had other settings.
        DataError: If a label breaks its format, too many images do not decode, or data have changed since the run to
            go on with began.
        TrainingError: If the loss is no longer finite, the disk is full or the GPU's memory runs out; what the last
            whole epoch has left stays.
        KeyboardInterrupt: When interrupted; likewise.
    """
    started = time.monotonic()
    with join_processes(config.device) as (processes, device):
        check_feasible(config, processes, device)
        saved = told_by_main(_saved_state(out_dir, config, force, resume) if processes.is_main else None, processes)
        if saved and _is_over(saved.epoch, saved.best, config):
            say(f"{out_dir}: this run is finished, after epoch {saved.epoch} of {config.epochs}; nothing to do")
            return _result(out_dir, saved.best, started)
        run = _prepare(config, out_dir, saved, processes, device)
        try:
            while not _is_over(run.state.epoch, run.state.best, config):
                _train_and_validate(run, run.state.epoch + 1)
        except (KeyboardInterrupt, SystemExit, AutolightsError):
            done = run.folder.epochs_kept if run.folder else 0
            kept = f"{out_dir} holds epoch {done}, go on with --resume" if done else "there is nothing to go on from"
            say(f"stopped in epoch {done + 1} of {config.epochs}; {kept}")
            raise
        finally:
            if run.folder:
                run.folder.close()
        return _result(out_dir, run.state.best, started)


def _train_and_validate(run: _Run, epoch: int) -> None:
    started = time.monotonic()
    config, state = run.config, run.state
    losses = _train_epoch(run, epoch)
    rate = run.steps.last_rate
    copy_from_main(state.average.model, run.processes)
    detections = _validate(run) if _is_validated(epoch, config) else None
    metrics = detections.metrics() if detections else None
    row = EpochRow(epoch, rate, *losses, metrics, time.monotonic() - started)
    state.epoch = epoch
    state.rows.append(row.cells())
    if metrics:
        state.best = _better(state.best, metrics, epoch)
    if run.folder:
        run.folder.keep(state, row, detections)
    say(row.summary(config.epochs))
    if epoch < config.epochs and _is_over(epoch, state.best, config):
        say(f"no better figures for {config.patience} epochs (patience): stopped early")


def _train_epoch(run: _Run, epoch: int) -> tuple[float, float, float]:
    """Go once through the loader; mean box, objectness and class losses."""
    loader, images = run.data.loader, run.data.images
    title = f"epoch {epoch}/{run.config.epochs}"
    sums = np.zeros(3)
    memory_ran_out = False
    run.steps.start_epoch()
    try:
        for number, batch in enumerate(
            track(loader.epoch(epoch), description=title, total=len(loader), unit="batches"), start=1
        ):
            if run.folder and epoch == number == 1:
                run.folder.picture_batch(draw_batch(batch, images.classes))
            losses = run.steps.backward(batch, ends_epoch=number == len(loader))
            if not np.isfinite(losses).all():
                raise TrainingError(_not_finite(losses.sum(), batch, images, epoch, run.processes))
            run.steps.advance()
            sums += losses
    except torch.OutOfMemoryError:
        memory_ran_out = True
    if memory_ran_out:  # asked here, where the error no longer holds the batch's memory
        raise TrainingError(advise(run.state.model, run.config, run.processes.size))
    box, objectness, classes = (sums / len(loader)).tolist()
    return box, objectness, classes


def _validate(run: _Run) -> DatasetDetections:
    return detect_dataset(
        run.state.average.model,
        run.data.held_out,
        long_side=run.config.val_long_side or run.config.image_size,
        score_threshold=run.config.val_score_threshold,
        device=str(run.device),
        bad_images=run.config.bad_images,
        processes=run.processes,
    )


def _prepare(
    config: TrainConfig, out_dir: Path, saved: SavedState | None, processes: Processes, device: torch.device
) -> _Run:
    if config.threads:
        torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    if device.type == "cpu":
        keep_freed_memory()
    data = load_training_data(config, processes)
    model = build_model(config, data.images.classes)
    if saved:
        saved.check_data(data.fingerprint)
    else:
        initialise(model, config)
        check_anchors(model, config, data.samples)
    state = start(model.to(device).to(memory_format=torch.channels_last), config)
    if saved:
        saved.restore(state)
        say(f"{out_dir}: goes on after epoch {state.epoch} of {config.epochs}")
    steps = Steps(
        state,
        schedule_of(config, len(data.loader)),
        config,
        class_weights=data.class_weights(config.loss.class_balance),
        processes=processes,
    )
    environment = describe_environment(device, processes)
    folder = None
    if processes.is_main:
        folder = RunFolder(out_dir, config, environment, fingerprint=data.fingerprint, epochs_kept=state.epoch)
    return _Run(config, data, state, steps, processes, device, folder)


def _saved_state(out_dir: Path, config: TrainConfig, force: bool, resume: bool) -> SavedState | None:
    """What to go on from; None to begin, if that is allowed."""
    path = out_dir / STATE
    if resume and path.is_file():
        saved = SavedState.read(path)
        saved.check_config(config)
        return saved
    refuse_existing(out_dir, force=force)
    return None


def _is_over(epoch: int, best: Best | None, config: TrainConfig) -> bool:
    """Whether all epochs are done, or there was none better for too long."""
    out_of_patience = config.patience > 0 and best is not None and epoch - best.reached >= config.patience
    return epoch >= config.epochs or out_of_patience


def _is_validated(epoch: int, config: TrainConfig) -> bool:
    return epoch == config.epochs or (config.val_every > 0 and epoch % config.val_every == 0)


def _better(best: Best | None, metrics: DetectionMetrics, epoch: int) -> Best:
    fitness = _fitness(metrics)
    if best and fitness < best.fitness:
        return best
    reached = best.reached if best and fitness == best.fitness else epoch
    return Best(epoch, reached, fitness, metrics.to_json())


def _fitness(metrics: DetectionMetrics) -> float:
    """AP with a tenth of AP50, as YOLOv5 chooses; 0 where there is nothing to find."""
    fitness = 0.9 * metrics.ap + 0.1 * metrics.ap50
    return 0.0 if math.isnan(fitness) else fitness


def _not_finite(loss: float, batch: Batch, images: ImageDataset, epoch: int, processes: Processes) -> str:
    names = [images.image_paths[i].name for indices in processes.gather(batch.indices) for i in indices]
    shown = ", ".join(names[:_NAMED_FILES])
    more = f" and {len(names) - _NAMED_FILES} more" if len(names) > _NAMED_FILES else ""
    return (
        f"the loss became {loss} in epoch {epoch}, on the batch of {shown}{more}; "
        "lower schedule.max_rate, or look at these images' labels"
    )


def _result(out_dir: Path, best: Best | None, started: float) -> TrainResult:
    assert best is not None  # the last epoch is always validated
    return TrainResult(out_dir / BEST, out_dir / LAST, best.epoch, best.metrics, time.monotonic() - started)
