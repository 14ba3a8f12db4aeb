"""A step of training: forward, loss, backward, and the optimiser whenever enough batches are summed."""

from contextlib import AbstractContextManager, nullcontext

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm
from torch.nn.parallel import DistributedDataParallel

from autolights.core.arrays import FloatArray
from autolights.train.config import TrainConfig
from autolights.train.learning.loss import detection_loss
from autolights.train.learning.optimizer import set_rates
from autolights.train.learning.schedule import Schedule
from autolights.train.processes import Processes
from autolights.train.run.distributed import share_out
from autolights.train.run.preparation import batches_per_step
from autolights.train.run.run_state import RunState
from autolights.train.samples.loader import Batch

AUTOCAST = {"fp32": None, "bf16": torch.bfloat16, "fp16": torch.float16}


class Steps:
    """Takes the steps of a run and keeps count of them in its state."""

    def __init__(
        self,
        state: RunState,
        schedule: Schedule,
        config: TrainConfig,
        *,
        class_weights: Tensor | None,
        processes: Processes,
    ) -> None:
        """Share the network out among the processes, and translate it if that is wanted."""
        self._state = state
        self._schedule = schedule
        self._config = config
        self._processes = processes
        self._device = state.model.anchors.device
        self._class_weights = None if class_weights is None else class_weights.to(self._device)
        self._shared = share_out(state.model, processes, self._device)
        self._network: nn.Module = torch.compile(self._shared) if config.compile else self._shared  # type: ignore[assignment]

    @property
    def last_rate(self) -> float:
        """The learning rate of the last batch."""
        return self._schedule.at(self._state.step - 1).rate

    def start_epoch(self) -> None:
        """Put the network into the mode for training."""
        self._state.model.train()
        if self._config.freeze_batch_norm:
            for module in self._state.model.modules():
                if isinstance(module, _BatchNorm):
                    module.eval()

    def backward(self, batch: Batch, *, ends_epoch: bool) -> FloatArray:
        """Add a batch's gradients to those that wait.

        Returns:
            (3,) losses of boxes, objectness and classes, means over all processes: not finite on one of them is not
            finite on all.
        """
        state = self._state
        set_rates(state.optimizer, self._schedule.at(state.step))
        state.step += 1
        state.summed_batches += 1
        # An epoch's end averages too, so that the state that is saved then holds the gradients of all.
        with self._averaging(self._is_due or ends_epoch):
            with torch.autocast(
                self._device.type, dtype=AUTOCAST[self._config.precision], enabled=self._config.precision != "fp32"
            ):
                maps = self._network(batch.network_input(self._device))
            losses = detection_loss(
                maps,
                batch.labels.to(self._device),
                state.model.anchors,
                strides=state.model.strides,
                input_side_px=self._config.input_side_px,
                config=self._config.loss,
                class_weights=self._class_weights,
                processes=self._processes,
            )
            torch.autograd.backward(state.scaler.scale(losses.total))
        # One transfer for all three, once the GPU has its work.
        return np.array(torch.stack([losses.box, losses.objectness, losses.classes]).tolist())

    def advance(self) -> None:
        """Let the optimiser take its step if enough batches are summed."""
        if not self._is_due:
            return
        state = self._state
        state.scaler.unscale_(state.optimizer)
        torch.nn.utils.clip_grad_norm_(state.model.parameters(), self._config.optimizer.clip_norm)
        state.scaler.step(state.optimizer)
        state.scaler.update()
        state.optimizer.zero_grad()
        state.average.update(state.model)
        state.summed_batches = 0

    @property
    def _is_due(self) -> bool:
        warmed_up = self._schedule.warmed_up(self._state.step - 1)
        return self._state.summed_batches >= batches_per_step(self._config, warmed_up)

    def _averaging(self, wanted: bool) -> AbstractContextManager[None]:
        if wanted or not isinstance(self._shared, DistributedDataParallel):
            return nullcontext()
        return self._shared.no_sync()
