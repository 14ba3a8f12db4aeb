"""Several processes that train one network: how torchrun's processes find each other and share the work."""

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr
from datetime import timedelta
from typing import TypeVar

import torch
import torch.distributed as dist
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from autolights.core.errors import UsageError
from autolights.train.network.model import YoloV5
from autolights.train.processes import ALONE, Processes

T = TypeVar("T")
# A process that waits longer for another gives up; long enough for one that still reads its images.
_LONGEST_WAIT = timedelta(minutes=30)


@contextmanager
def join_processes(device_name: str) -> Iterator[tuple[Processes, torch.device]]:
    """Take this process's place among those that torchrun has started; without torchrun it is alone.

    On GPUs each process takes the one with its number on the machine. All but the first are silent, until they fail.

    Args:
        device_name: As in the configuration.

    Raises:
        UsageError: If the device cannot be used.
    """
    size = int(os.environ.get("WORLD_SIZE", "1"))
    if size == 1:
        yield ALONE, _usable(device_name)
        return
    device = _usable(f"cuda:{os.environ['LOCAL_RANK']}" if device_name == "cuda" else device_name)
    if device.type == "cuda":
        torch.cuda.set_device(device)
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo", timeout=_LONGEST_WAIT)
    processes = Processes(dist.get_rank(), size)
    with ExitStack() as stack:
        if not processes.is_main:
            stack.enter_context(redirect_stderr(stack.enter_context(open(os.devnull, "w"))))
        yield processes, device
    # Not after an error: a farewell would wait for those that have not failed, which wait for this one.
    dist.destroy_process_group()


def share_out(model: YoloV5, processes: Processes, device: torch.device) -> nn.Module:
    """Wrap a network so that backward passes average the gradients of all processes.

    On GPUs its batch norms take their statistics over the whole batch.

    Args:
        model: On its device; its batch norms are exchanged in place, the parameters stay the same objects.
        processes: Who trains.
        device: Where this one computes.

    Returns:
        The network itself if the process is alone.
    """
    if processes.size == 1:
        return model
    on_gpu = device.type == "cuda"
    if on_gpu:
        nn.SyncBatchNorm.convert_sync_batchnorm(model)  # type: ignore[no-untyped-call]
    return DistributedDataParallel(model, device_ids=[device.index] if on_gpu else None)


def copy_from_main(module: nn.Module, processes: Processes) -> None:
    """Give each process the main one's values; without synchronised batch norms the statistics drift apart."""
    if processes.size > 1:
        for tensor in module.state_dict().values():
            dist.broadcast(tensor, src=0)


def told_by_main(value: T, processes: Processes) -> T:
    """What the main process knows, in all of them; the others' `value` does not matter."""
    if processes.size == 1:
        return value
    values = [value]
    dist.broadcast_object_list(values, src=0)
    return values[0]


def _usable(name: str) -> torch.device:
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UsageError(f"device '{name}' cannot be used here: {str(error).splitlines()[0]}") from error
    return device
