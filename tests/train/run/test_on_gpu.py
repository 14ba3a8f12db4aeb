"""On a GPU, where there is one: the gradients are the CPU's, and runs of every kind come to their end.

Under torchrun this file is the program: see `_main`.
"""

import math
import os
import subprocess
import sys
from datetime import timedelta
from pathlib import Path

import pytest
import torch
import torch.distributed as dist

from autolights.core import load_config
from autolights.core.config import save_config
from autolights.core.errors import TrainingError
from autolights.train.config import TrainConfig
from autolights.train.measure.validate import evaluate_detector
from autolights.train.network.weights import load_checkpoint, read_checkpoint
from autolights.train.processes import ALONE
from autolights.train.run.distributed import copy_from_main, join_processes, told_by_main
from autolights.train.run.engine import train
from autolights.train.run.preparation import build_model, load_training_data, schedule_of, start
from autolights.train.run.steps import Steps

pytestmark = [
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU that torch can use"),
    pytest.mark.usefixtures("undrawn"),
]


@pytest.fixture(autouse=True)
def exact(monkeypatch):
    """Convolutions in full float32, so that a comparison with the CPU means something."""
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)


def gradients(config, device, processes=ALONE):
    """Of one batch, on the CPU again, by parameter; and the batch's losses."""
    torch.manual_seed(0)
    data = load_training_data(config, processes)
    model = build_model(config, data.images.classes).to(device).to(memory_format=torch.channels_last)
    state = start(model, config)
    steps = Steps(state, schedule_of(config, 2), config, class_weights=None, processes=processes)
    steps.start_epoch()
    losses = torch.tensor(steps.backward(next(iter(data.loader.epoch(1))), ends_epoch=True))
    copy_from_main(state.average.model, processes)
    return {name: parameter.grad.cpu() for name, parameter in state.model.named_parameters()}, losses


def assert_same_gradients(found, expected, share):
    """Within a share of the largest."""
    largest = max(gradient.abs().max() for gradient in expected.values())
    assert found.keys() == expected.keys()
    for name, gradient in expected.items():
        assert (found[name] - gradient).abs().max() < share * largest, name


def test_gradients_are_those_of_the_cpu(tiny):
    config = tiny(batch=12)

    found, losses = gradients(config.model_copy(update={"device": "cuda"}), torch.device("cuda"))

    expected, expected_losses = gradients(config, torch.device("cpu"))
    torch.testing.assert_close(losses, expected_losses, rtol=1e-4, atol=1e-4)
    assert_same_gradients(found, expected, 1e-3)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning")
@pytest.mark.parametrize(
    "settings",
    [
        pytest.param({"precision": "fp32", "workers": 2}, id="fp32"),
        pytest.param({"precision": "bf16"}, id="bf16"),
        pytest.param({"precision": "fp16", "finest_stride": 4}, id="fp16"),
        pytest.param({"precision": "bf16", "compile": True}, id="compiled"),
    ],
)
def test_a_run_finds_the_lights_and_goes_on_after_a_stop(tiny, tmp_path, monkeypatch, settings):
    config = tiny(epochs=40, device="cuda", **settings)
    backward = Steps.backward

    def interrupted(self, batch, *, ends_epoch):
        if self._state.step == 20:
            raise KeyboardInterrupt
        return backward(self, batch, ends_epoch=ends_epoch)

    monkeypatch.setattr(Steps, "backward", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(config, tmp_path / "run")
    monkeypatch.setattr(Steps, "backward", backward)
    assert read_checkpoint(tmp_path / "run/last.pt").epoch == 10

    result = train(config, tmp_path / "run", resume=True)

    assert read_checkpoint(result.last_path).epoch == 40
    assert result.metrics["ap50"] > 0.5
    rows = (tmp_path / "run/results.csv").read_text().splitlines()
    assert len(rows) == 41
    assert all(math.isfinite(float(cell)) for cell in rows[-1].split(",")[:5])
    # What was trained there detects the same here.
    data = load_training_data(config, ALONE)
    on_cpu, on_gpu = (
        evaluate_detector(load_checkpoint(result.best_path), data.held_out, long_side=64, device=device)
        for device in ("cpu", "cuda")
    )
    assert on_gpu.ap == pytest.approx(on_cpu.ap, abs=0.02)


def test_out_of_memory_is_told_the_batch_that_fits(tiny, tmp_path):
    config = tiny(size="s", batch=12, image_size=640, device="cuda", augment={"mosaic": 0})
    torch.cuda.empty_cache()
    total = torch.cuda.get_device_properties(0).total_memory
    torch.cuda.set_per_process_memory_fraction(1.6e9 / total)
    try:
        with pytest.raises(TrainingError, match=r"memory ran out with batch=12 at 640 px; batch=[136] fits"):
            train(config, tmp_path / "run")
    finally:
        torch.cuda.set_per_process_memory_fraction(1.0)
        torch.cuda.empty_cache()


def test_two_processes_have_the_gradients_of_one_with_batch_norms_over_both(tiny, tmp_path):
    # The batch norms are not frozen here: on GPUs their statistics are those of the whole batch.
    config = tiny(batch=12, nominal_batch=12, device="cuda")
    save_config(config, tmp_path / "config.yaml")

    subprocess.run(
        [
            *(sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"),
            *(__file__, tmp_path / "config.yaml", tmp_path / "gradients.pt"),
        ],
        timeout=180,
        check=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )

    found, losses = torch.load(tmp_path / "gradients.pt", weights_only=True)
    expected, expected_losses = gradients(config, torch.device("cuda"))
    torch.testing.assert_close(losses, expected_losses, rtol=1e-4, atol=1e-4)
    assert_same_gradients(found, expected, 1e-3)


def test_nccl_takes_what_a_run_says_to_the_others(tmp_path):
    # One process is enough to show that NCCL takes these types; several need as many GPUs.
    torch.cuda.set_device(0)
    dist.init_process_group("nccl", init_method=f"file://{tmp_path / 'meet'}", rank=0, world_size=1)
    try:
        total = torch.tensor([3.0, 4.0], dtype=torch.float64, device="cuda")
        dist.all_reduce(total)
        assert total.tolist() == [3.0, 4.0]
        held = [None]
        dist.all_gather_object(held, {"seen": [1, 2]})
        assert held == [{"seen": [1, 2]}]
        values = ["told"]
        dist.broadcast_object_list(values, src=0)
        assert values == ["told"]
        network = torch.nn.SyncBatchNorm.convert_sync_batchnorm(torch.nn.BatchNorm2d(3)).cuda()
        for tensor in network.state_dict().values():
            dist.broadcast(tensor, src=0)
        shared = torch.nn.parallel.DistributedDataParallel(network, device_ids=[0])
        shared(torch.rand(2, 3, 4, 4, device="cuda")).sum().backward()
        assert network.weight.grad is not None
    finally:
        dist.destroy_process_group()


def _main(config_path: str, gradients_path: str) -> None:
    """One of two processes; on a machine with a single GPU they share it, which NCCL does not do, but gloo does."""
    if torch.cuda.device_count() == 1:
        os.environ["LOCAL_RANK"] = "0"
        join = dist.init_process_group
        dist.init_process_group = lambda backend, timeout=timedelta(minutes=5): join("gloo", timeout=timeout)
    torch.backends.cudnn.allow_tf32 = False
    config = load_config(Path(config_path), TrainConfig)
    with join_processes(config.device) as (processes, device):
        assert told_by_main("main" if processes.is_main else "other", processes) == "main"
        found = gradients(config, device, processes)
        if processes.is_main:
            torch.save(found, gradients_path)
        processes.sum(torch.zeros(1, device=device))


if __name__ == "__main__":
    _main(*sys.argv[1:])
