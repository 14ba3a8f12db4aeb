"""Whole runs, and what ends them."""

import csv
import errno

import pytest
import torch

from autolights.core import load_config, parse_config
from autolights.core.errors import ConfigError, TrainingError, UsageError
from autolights.train.config import TrainConfig
from autolights.train.network import tensor_file
from autolights.train.network.checkpoint import Checkpoint
from autolights.train.network.model import YoloV5
from autolights.train.network.weights import load_checkpoint, read_checkpoint
from autolights.train.run import engine
from autolights.train.run.engine import train
from autolights.train.run.steps import Steps

pytestmark = pytest.mark.usefixtures("undrawn")


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_run_learns_and_leaves_what_it_promises(tiny, tmp_path, capsys):
    config = tiny(epochs=12, val_every=5, crops={"size": 64, "per_image": 2, "scale": (0.8, 1.0)})

    result = train(config, tmp_path / "run")

    rows = rows_of(tmp_path / "run/results.csv")
    assert list(rows[0]) == ["epoch", "lr", "box", "obj", "cls", "ap", "ap50", "ap75", "ap_s", "ap_m", "seconds"]
    assert [row["epoch"] for row in rows if row["ap"]] == ["5", "10", "12"]
    assert float(rows[-1]["box"]) < 0.7 * float(rows[0]["box"])
    assert float(rows[-1]["lr"]) == pytest.approx(0.00008)
    assert {path.name for path in (tmp_path / "run").iterdir()} == {
        "best.pt", "last.pt", "state.pt", "config.yaml", "environment.json", "results.csv", "metrics.json", "batch.jpg",
        "tensorboard",
    }  # fmt: skip
    assert load_config(tmp_path / "run/config.yaml", TrainConfig) == config
    assert (tmp_path / "run/config.yaml").read_text().startswith("# autolights ")
    best = read_checkpoint(result.best_path)
    assert (best.epoch, best.classes, best.initial_weights) == (result.best_epoch, ("red", "green"), None)
    assert best.metrics == result.metrics
    assert load_checkpoint(result.last_path)(torch.zeros(1, 3, 64, 64)).shape == (1, 252, 7)
    assert "12 images with 12 labels to train on, 4 held out" in capsys.readouterr().err


def test_same_seed_same_run(tiny, tmp_path):
    first, second = (train(tiny(), tmp_path / name) for name in ("a", "b"))

    states = [read_checkpoint(result.last_path).state for result in (first, second)]
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])


def test_an_earlier_run_is_replaced_only_by_force_and_by_a_whole_epoch(tiny, tmp_path, monkeypatch):
    for name in ("best.pt", "last.pt", "state.pt", "metrics.json"):
        (tmp_path / name).write_text("old")
    (tmp_path / "notes.txt").write_text("mine")

    with pytest.raises(UsageError, match="exists already; choose another output or pass --force"):
        train(tiny(), tmp_path)
    with pytest.raises(UsageError, match="nowhere: no such folder"):
        train(tiny(data=str(tmp_path / "nowhere")), tmp_path, force=True)
    monkeypatch.setattr(Steps, "advance", _interrupt)
    with pytest.raises(KeyboardInterrupt):
        train(tiny(), tmp_path, force=True)
    monkeypatch.undo()
    assert all((tmp_path / name).read_text() == "old" for name in ("best.pt", "last.pt", "state.pt", "metrics.json"))

    train(tiny(epochs=2, val_every=0), tmp_path, force=True)
    assert load_checkpoint(tmp_path / "best.pt").classes == ("red", "green")
    assert (tmp_path / "notes.txt").read_text() == "mine"


def _interrupt(*_):
    raise KeyboardInterrupt


def test_a_loss_that_is_not_finite_names_the_files(tiny, tmp_path):
    wild = {"kind": "cosine", "max_rate": 1e12, "warmup_epochs": 0}
    config = tiny(epochs=5, schedule=wild, optimizer={"kind": "sgd", "clip_norm": 1e12})

    with pytest.raises(TrainingError, match=r"the loss became nan in epoch \d, on the batch of \d+\.png, .*max_rate"):
        train(config, tmp_path / "run")

    assert not (tmp_path / "run/best.pt").exists()


def test_an_interrupted_run_keeps_its_last_whole_epoch(tiny, tmp_path, monkeypatch, capsys):
    original, epochs = engine._train_epoch, []

    def interrupted(run, epoch):
        epochs.append(epoch)
        return original(run, epoch) if epoch == 1 else _interrupt()

    monkeypatch.setattr(engine, "_train_epoch", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(tiny(epochs=3), tmp_path)

    assert read_checkpoint(tmp_path / "last.pt").epoch == 1
    assert f"stopped in epoch 2 of 3; {tmp_path} holds epoch 1, go on with --resume" in capsys.readouterr().err
    assert len(rows_of(tmp_path / "results.csv")) == 1


def test_a_full_disk_leaves_the_checkpoint_of_the_epoch_before(tiny, tmp_path, monkeypatch, capsys):
    save, files = torch.save, []

    def full(values, file):
        files.append(file.name)
        if len(files) > 3:  # last.pt, best.pt and state.pt of the first epoch
            file.write(b"half")
            raise OSError(errno.ENOSPC, "No space left on device")
        save(values, file)

    monkeypatch.setattr(tensor_file.torch, "save", full)
    with pytest.raises(TrainingError, match=r"last\.pt: cannot be saved, the disk is full .* go on with --resume"):
        train(tiny(), tmp_path)

    assert read_checkpoint(tmp_path / "last.pt").epoch == 1
    assert not list(tmp_path.glob(".*"))
    assert "holds epoch 1" in capsys.readouterr().err


def test_a_gpu_out_of_memory_is_told_the_batch_that_fits(tiny, tmp_path, monkeypatch):
    logits = YoloV5.logits

    def small_gpu(self, images):
        if len(images) > 2:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return logits(self, images)

    monkeypatch.setattr(YoloV5, "logits", small_gpu)
    with pytest.raises(TrainingError, match=r"memory ran out with batch=12 at 64 px; batch=1 fits"):
        train(tiny(batch=12), tmp_path)


def test_patience_ends_a_run_that_gets_no_better(tiny, tmp_path, monkeypatch, capsys):
    aps = iter([0.1, 0.3, 0.2, 0.3, 0.2, 0.2])
    monkeypatch.setattr(engine, "_fitness", lambda metrics: next(aps))

    result = train(tiny(epochs=6, patience=2), tmp_path)

    # The fourth epoch is as good as the second and becomes the best one, but is no improvement.
    assert (result.best_epoch, len(rows_of(tmp_path / "results.csv"))) == (4, 4)
    assert "no better figures for 2 epochs (patience): stopped early" in capsys.readouterr().err


def test_a_run_starts_from_a_checkpoint_and_says_what_fitted(tiny, tmp_path, capsys):
    model = YoloV5("n", 3)
    Checkpoint("n", model.classes, dict(model.state_dict())).save(tmp_path / "start.pt")

    result = train(tiny(epochs=1, weights=str(tmp_path / "start.pt")), tmp_path / "run")

    assert "343 of 349 tensors loaded" in capsys.readouterr().err
    initial = read_checkpoint(result.best_path).initial_weights
    assert (initial.name, initial.licence) == ("start.pt", "Apache-2.0")


@pytest.mark.parametrize("name", ["paper", "base", "demo", "photos"])
def test_shipped_recipes_want_nothing_but_data(name):
    with pytest.raises(ConfigError, match="'data': give the folder with the images"):
        load_config(f"train/{name}", TrainConfig)

    config = load_config(f"train/{name}", TrainConfig, ["data=somewhere", "epochs=3"])
    assert (config.size, config.epochs) == ("n", 3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"image_size": 300}, "image_size must be a multiple of 32, got 300; try 288"),
        ({"crops": {"size": 100}}, "size must be a multiple of 32, got 100; try 96"),
        ({"crops": {"scale": [1.2, 0.5]}}, "scale must be a range of positive factors"),
        ({"epoch": 3}, "unknown key 'epoch'; did you mean 'epochs'"),
        ({"device": "mars"}, "device 'mars' cannot be used here"),
        ({"precision": "fp16"}, "precision=fp16 needs a GPU; on a CPU take fp32 or bf16"),
    ],
)
def test_wrong_settings_are_explained(values, message, lights, tmp_path):
    with pytest.raises(UsageError, match=message):
        train(parse_config({"data": str(lights), "weights": "", **values}, TrainConfig, source="x"), tmp_path)
