"""Runs of seconds: a handful of 64-pixel images with one bright light each."""

import csv

import cv2
import numpy as np
import pytest
import torch

from autolights.core import load_config, parse_config
from autolights.core.errors import ConfigError, TrainingError, UsageError
from autolights.train import engine
from autolights.train.checkpoint import Checkpoint
from autolights.train.config import TrainConfig
from autolights.train.engine import train
from autolights.train.loader import Batch
from autolights.train.model import YoloV5
from autolights.train.run_log import draw_batch
from autolights.train.weights import load_checkpoint, read_checkpoint


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Lights of 16 × 32 px, red or green, on noise; 12 images to train on, 4 held out."""
    root = tmp_path_factory.mktemp("lights")
    rng = np.random.default_rng(5)
    for split, count in (("train", 12), ("val", 4)):
        for part in ("images", "labels"):
            (root / part / split).mkdir(parents=True)
        for i in range(count):
            image = rng.integers(0, 80, (64, 64, 3), dtype=np.uint8)
            left, top = rng.integers(4, 40), rng.integers(4, 28)
            image[top : top + 32, left : left + 16] = (0, 255, 0) if i % 2 else (0, 0, 255)
            cv2.imwrite(str(root / f"images/{split}/{i}.png"), image)
            label = f"{i % 2} {(left + 8) / 64} {(top + 16) / 64} {16 / 64} {32 / 64}\n"
            (root / f"labels/{split}/{i}.txt").write_text(label)
    (root / "data.yaml").write_text("names: [red, green]\ntrain: images/train\nval: images/val\n")
    return root


def tiny(folder, **settings):
    values = {
        "weights": "",
        "image_size": 64,
        "epochs": 2,
        "batch": 6,
        "nominal_batch": 6,
        "workers": 0,
        "optimizer": {"kind": "adamw"},
        "schedule": {"kind": "cosine", "max_rate": 0.004, "warmup_epochs": 0},
        **settings,
    }
    return TrainConfig(data=str(folder), **values)


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_run_learns_and_leaves_what_it_promises(folder, tmp_path, capsys):
    config = tiny(folder, epochs=12, val_every=5, crops={"size": 64, "per_image": 2, "scale": (0.8, 1.0)})

    result = train(config, tmp_path / "run")

    rows = rows_of(tmp_path / "run/results.csv")
    assert list(rows[0]) == ["epoch", "lr", "box", "obj", "cls", "ap", "ap50", "ap75", "ap_s", "ap_m", "seconds"]
    assert [row["epoch"] for row in rows if row["ap"]] == ["5", "10", "12"]
    assert float(rows[-1]["box"]) < 0.7 * float(rows[0]["box"])
    assert float(rows[-1]["lr"]) == pytest.approx(0.00008)
    files = {path.name for path in (tmp_path / "run").iterdir()}
    assert files == {"best.pt", "last.pt", "config.yaml", "results.csv", "metrics.json", "tensorboard"}
    assert load_config(tmp_path / "run/config.yaml", TrainConfig) == config
    assert (tmp_path / "run/config.yaml").read_text().startswith("# autolights ")
    best = read_checkpoint(result.best_path)
    assert (best.epoch, best.classes, best.initial_weights) == (result.best_epoch, ("red", "green"), None)
    assert best.metrics["ap50"] == pytest.approx(result.metrics.ap50, abs=1e-4)
    assert load_checkpoint(result.last_path)(torch.zeros(1, 3, 64, 64)).shape == (1, 252, 7)
    assert "12 images with 12 labels to train on, 4 held out" in capsys.readouterr().err


def test_same_seed_same_run(folder, tmp_path):
    first, second = (train(tiny(folder), tmp_path / name) for name in ("a", "b"))

    states = [read_checkpoint(result.last_path).state for result in (first, second)]
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])


def test_an_earlier_run_is_replaced_only_by_force(folder, tmp_path):
    (tmp_path / "best.pt").write_text("old")
    (tmp_path / "notes.txt").write_text("mine")

    with pytest.raises(UsageError, match="exists already; choose another output or pass --force"):
        train(tiny(folder), tmp_path)
    with pytest.raises(UsageError, match="nowhere: no such folder"):
        train(tiny(tmp_path / "nowhere"), tmp_path, force=True)
    assert (tmp_path / "best.pt").read_text() == "old"

    train(tiny(folder, epochs=1), tmp_path, force=True)
    assert load_checkpoint(tmp_path / "best.pt").classes == ("red", "green")
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_loss_that_is_not_finite_names_the_files(folder, tmp_path):
    wild = {"kind": "cosine", "max_rate": 1e12, "warmup_epochs": 0}
    config = tiny(folder, epochs=5, schedule=wild, optimizer={"kind": "sgd", "clip_norm": 1e12})

    with pytest.raises(TrainingError, match=r"the loss became nan in epoch \d, on the batch of \d+\.png, .*max_rate"):
        train(config, tmp_path / "run")

    assert not (tmp_path / "run/best.pt").exists()


def test_an_interrupted_run_keeps_its_last_whole_epoch(folder, tmp_path, monkeypatch, capsys):
    original, calls = engine._train_epoch, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return original(*arguments)

    monkeypatch.setattr(engine, "_train_epoch", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(tiny(folder, epochs=3), tmp_path)

    assert read_checkpoint(tmp_path / "last.pt").epoch == 1
    assert "stopped in epoch 2 of 3" in capsys.readouterr().err
    assert len(rows_of(tmp_path / "results.csv")) == 1


def test_gradients_are_summed_to_the_nominal_batch(folder, tmp_path, monkeypatch):
    steps = []
    real_step = engine._step

    def counted(state, config):
        steps.append(state.step)
        real_step(state, config)

    monkeypatch.setattr(engine, "_step", counted)
    train(tiny(folder, batch=3, nominal_batch=6, epochs=2), tmp_path)

    assert steps == [1, 3, 5, 7]


def test_a_run_starts_from_a_checkpoint_and_says_what_fitted(folder, tmp_path, capsys):
    model = YoloV5("n", 3)
    Checkpoint("n", model.classes, dict(model.state_dict())).save(tmp_path / "start.pt")

    result = train(tiny(folder, epochs=1, weights=str(tmp_path / "start.pt")), tmp_path / "run")

    assert (
        "343 of 349 tensors loaded; re-initialised: model.24.m.0.weight (24 → 21 channels)" in capsys.readouterr().err
    )
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
    ],
)
def test_wrong_settings_are_explained(values, message, folder, tmp_path):
    with pytest.raises(UsageError, match=message):
        train(parse_config({"data": str(folder), "weights": "", **values}, TrainConfig, source="x"), tmp_path)


def test_the_picture_of_a_batch_shows_each_sample_with_its_labels():
    images = torch.zeros(5, 32, 32, 3, dtype=torch.uint8)
    batch = Batch(images, torch.tensor([[1, 0, 0.5, 0.5, 0.5, 0.5]]), (0, 1, 2, 3, 4))

    picture = draw_batch(batch, ["red"])

    assert picture.shape == (64, 128, 3)
    assert picture[8:25, 32 + 8 : 32 + 25].any()
    assert not picture[:, :32].any()
    assert not picture[32:].any()
