"""A run that is stopped and goes on is the same run."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
import torch

from autolights.cli.training import train as train_verb
from autolights.core.config import save_config
from autolights.core.errors import CheckpointError, ConfigError, DataError, UsageError
from autolights.train.network.tensor_file import save_tensors
from autolights.train.run import engine
from autolights.train.run.engine import train
from autolights.train.run.steps import Steps

pytestmark = pytest.mark.usefixtures("undrawn")

_SLOW_PROGRAM = """
import time
from autolights.cli import main
from autolights.train.run.steps import Steps
advance = Steps.advance
Steps.advance = lambda self: (time.sleep(0.2), advance(self))
main()
"""


def states_of(folder):
    return [torch.load(folder / name, weights_only=True) for name in ("last.pt", "best.pt", "state.pt")]


def assert_equal(one, other, where="state"):
    """Bit for bit, through dictionaries and lists; but for what the clock says."""
    if isinstance(one, torch.Tensor):
        assert torch.equal(one, other), where
    elif isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for key in one.keys() - {"seconds"}:
            assert_equal(one[key], other[key], f"{where}.{key}")
    elif isinstance(one, list):
        assert len(one) == len(other), where
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_equal(a, b, f"{where}[{i}]")
    else:
        assert one == other, where


def results_without_seconds(folder):
    return [line.rpartition(",")[0] for line in (folder / "results.csv").read_text().splitlines()]


@pytest.fixture
def interrupt_at(monkeypatch):
    """Stop a run in the middle of an epoch, as Ctrl-C does."""

    def set_up(step):
        real = Steps.backward

        def backward(self, batch, *, ends_epoch):
            if self._state.step == step:
                raise KeyboardInterrupt
            return real(self, batch, ends_epoch=ends_epoch)

        monkeypatch.setattr(Steps, "backward", backward)
        return monkeypatch

    return set_up


def test_a_killed_run_goes_on_to_the_same_weights_bit_for_bit(tiny, tmp_path):
    config = tiny(epochs=4, batch=3, workers=1, nominal_batch=9)
    train(config, tmp_path / "whole")

    save_config(config, tmp_path / "config.yaml")
    command = [sys.executable, "-c", _SLOW_PROGRAM, "train", tmp_path / "config.yaml", "--out", tmp_path / "killed"]
    process = subprocess.Popen(list(map(str, command)), start_new_session=True)
    try:
        _wait_for(tmp_path / "killed/state.pt")
        time.sleep(0.3)  # four batches take 0.8 s: in the middle of an epoch
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    stopped_after = torch.load(tmp_path / "killed/state.pt", weights_only=True)["epoch"]
    assert 1 <= stopped_after < 4

    train_verb(str(tmp_path / "config.yaml"), out=tmp_path / "killed", resume=True)

    for one, other in zip(states_of(tmp_path / "whole"), states_of(tmp_path / "killed"), strict=True):
        assert_equal(one, other)
    assert results_without_seconds(tmp_path / "whole") == results_without_seconds(tmp_path / "killed")
    assert (
        json.loads((tmp_path / "killed/metrics.json").read_text())
        == states_of(tmp_path / "whole")[2]["best"]["metrics"]
    )
    assert not list((tmp_path / "killed").glob(".*"))


def _wait_for(path, limit_s=60.0):
    end = time.monotonic() + limit_s
    while not path.exists():
        assert time.monotonic() < end, f"{path} did not appear"
        time.sleep(0.02)


@pytest.mark.parametrize("settings", [
    pytest.param({"nominal_batch": 15}, id="gradients-wait-between-epochs"),
    pytest.param({"optimizer": {"kind": "sgd"}, "val_every": 3}, id="sgd-best-unknown-at-the-stop"),
])  # fmt: skip
def test_an_interrupted_run_goes_on_as_if_never_stopped(settings, tiny, tmp_path, interrupt_at):
    config = tiny(epochs=3, batch=3, **settings)
    train(config, tmp_path / "whole")

    patch = interrupt_at(step=6)
    with pytest.raises(KeyboardInterrupt):
        train(config, tmp_path / "stopped", resume=True)  # nothing there yet: begins
    patch.undo()
    resumed = train(config, tmp_path / "stopped", resume=True)

    for one, other in zip(states_of(tmp_path / "whole"), states_of(tmp_path / "stopped"), strict=True):
        assert_equal(one, other)
    assert resumed.best_epoch == states_of(tmp_path / "whole")[2]["best"]["epoch"]


def test_a_finished_run_is_left_alone(tiny, tmp_path, monkeypatch, capsys):
    first = train(tiny(), tmp_path)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    monkeypatch.setattr(engine, "load_training_data", None)

    again = train(tiny(), tmp_path, resume=True)

    assert (again.best_epoch, again.metrics) == (first.best_epoch, first.metrics)
    assert before == {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert "this run is finished, after epoch 2 of 2; nothing to do" in capsys.readouterr().err


def test_a_run_does_not_go_on_with_other_settings_or_data(tiny, tmp_path, lights, interrupt_at):
    patch = interrupt_at(step=2)
    with pytest.raises(KeyboardInterrupt):
        train(tiny(), tmp_path)
    patch.undo()

    with pytest.raises(ConfigError, match=r"epochs was 2, now 3, optimizer\.kind was 'adamw', now 'sgd'; rates follow"):
        train(tiny(epochs=3, optimizer={"kind": "sgd"}), tmp_path, resume=True)
    label = lights / "labels/train/0.txt"
    kept = label.read_text()
    label.write_text("0 0.5 0.5 0.25 0.5\n")
    try:
        with pytest.raises(DataError, match=r"state\.pt: cannot go on, images or labels have changed"):
            train(tiny(), tmp_path, resume=True)
    finally:
        label.write_text(kept)
    train(tiny(workers=1, cache_mb=0), tmp_path, resume=True)


def test_resume_refuses_what_is_no_state(tiny, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="exists already"):
        train(tiny(), tmp_path, resume=True)

    save_tensors({"format": "cake"}, tmp_path / "state.pt")
    with pytest.raises(CheckpointError, match=r"state\.pt: not the state of a training run"):
        train(tiny(), tmp_path, resume=True)

    (tmp_path / "state.pt").write_bytes(b"half of it")
    with pytest.raises(CheckpointError, match=r"state\.pt: cannot be read .* damaged"):
        train(tiny(), tmp_path, resume=True)
