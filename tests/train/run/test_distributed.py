"""Two processes on a CPU against one: the same gradients, and a run from the command line.

Under torchrun this file is the program: see `_main`.
"""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from autolights.core import load_config
from autolights.core.config import save_config
from autolights.core.errors import UsageError
from autolights.train.config import TrainConfig
from autolights.train.network.weights import read_checkpoint
from autolights.train.processes import ALONE, Processes
from autolights.train.run.distributed import join_processes
from autolights.train.run.preparation import build_model, check_feasible, load_training_data, schedule_of, start
from autolights.train.run.steps import Steps


def gradients(config, processes):
    """Of an epoch of two batches, the first of which waits for the second; and the losses of both."""
    torch.manual_seed(0)
    data = load_training_data(config, processes)
    state = start(build_model(config, data.images.classes), config)
    steps = Steps(state, schedule_of(config, 2), config, class_weights=None, processes=processes)
    steps.start_epoch()
    losses = [
        torch.tensor(steps.backward(batch, ends_epoch=number == len(data.loader)))
        for number, batch in enumerate(data.loader.epoch(1), start=1)
    ]
    return {name: parameter.grad for name, parameter in state.model.named_parameters()}, torch.stack(losses)


def torchrun(*arguments, check=True):
    return subprocess.run(
        [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=180,
        check=check,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


def test_gradients_of_two_processes_are_those_of_one_and_a_failure_ends_both(tiny, tmp_path):
    # 12 images in batches of 8: the second is smaller, and shares are uneven in labels.
    config = tiny(batch=8, nominal_batch=32, freeze_batch_norm=True, crops={"size": 64, "scale": (0.8, 1.0)})
    save_config(config, tmp_path / "config.yaml")
    expected, expected_losses = gradients(config, ALONE)

    result = torchrun(__file__, tmp_path / "config.yaml", tmp_path / "gradients.pt", check=False)

    assert result.returncode == 1
    assert "the second process fails" in result.stderr
    found, losses = torch.load(tmp_path / "gradients.pt", weights_only=True)
    torch.testing.assert_close(losses, expected_losses)
    largest = max(gradient.abs().max() for gradient in expected.values())
    assert found.keys() == expected.keys()
    for name, gradient in expected.items():
        assert (found[name] - gradient).abs().max() < 1e-5 * largest, name


def test_a_run_of_two_processes_from_the_command_line(tiny, tmp_path):
    save_config(tiny(epochs=2, batch=4), tmp_path / "config.yaml")

    result = torchrun("-m", "autolights", "train", tmp_path / "config.yaml", "--out", tmp_path / "run")

    assert result.stdout.split() == [str(tmp_path / "run/best.pt")]
    assert result.stderr.count("12 images with 12 labels to train on, 4 held out") == 1
    with (tmp_path / "run/results.csv").open() as file:
        assert [row["epoch"] for row in csv.DictReader(file)] == ["1", "2"]
    assert read_checkpoint(tmp_path / "run/last.pt").metrics["images"] == 4


def test_a_batch_must_divide_among_the_processes(tiny):
    check_feasible(tiny(batch=6), Processes(0, 3), torch.device("cpu"))
    with pytest.raises(UsageError, match="must be a multiple of their number 4, got 6; try batch=8"):
        check_feasible(tiny(batch=6), Processes(0, 4), torch.device("cpu"))


def _main(config_path: str, gradients_path: str) -> None:
    with join_processes("cpu") as (processes, _):
        found = gradients(load_config(Path(config_path), TrainConfig), processes)
        if processes.is_main:
            torch.save(found, gradients_path)
        if processes.rank == 1:
            raise RuntimeError("the second process fails")
        processes.sum(torch.zeros(1))  # would wait for the second for ever


if __name__ == "__main__":
    _main(*sys.argv[1:])
