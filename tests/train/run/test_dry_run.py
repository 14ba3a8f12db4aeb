"""What a run would be, told without training."""

import pytest

from autolights.train.run.dry_run import describe_run
from autolights.train.run.engine import train
from autolights.train.run.steps import Steps

pytestmark = pytest.mark.usefixtures("undrawn")


def test_a_dry_run_tells_network_data_steps_and_rates(tiny, capsys):
    schedule = {"kind": "linear", "max_rate": 0.01, "min_rate": 0.001, "warmup_epochs": 2, "warmup_steps": 0}

    text = describe_run(tiny(epochs=6, batch=4, nominal_batch=8, schedule=schedule, loss={"class_balance": 1.0}))

    assert text.splitlines() == [
        "network  YOLOv5n, 2 classes, strides 8, 16, 32: 1,766,623 parameters, 0.04 GFLOPs at 64x64",
        "data     12 images to train on, 4 held out; labels:",
        "         class  to train on  held out  weight",
        "         red              6         2    1.00",
        "         green            6         2    1.00",
        "anchors  can reach 100.0% of the labels as the network sees them",
        "steps    6 epochs of 3 batches of 4; 10 of the optimiser (adamw), each over 8 images once warm",
        "rates    linear: warm-up of 6 batches to 0.00682, at the end 0.001",
    ]
    assert "anchors can reach 100.0% of 12 labels; kept" in capsys.readouterr().err


def test_its_steps_are_those_that_are_taken(tiny, tmp_path, monkeypatch):
    config = tiny(epochs=4, batch=3, nominal_batch=9, schedule={"warmup_epochs": 1, "warmup_steps": 0})
    taken = []
    step = Steps.advance

    def counted(self):
        step(self)
        taken.append(self._state.summed_batches == 0)

    monkeypatch.setattr(Steps, "advance", counted)
    train(config, tmp_path)

    assert f"; {sum(taken)} of the optimiser (adamw)" in describe_run(config)


def test_a_class_without_labels_is_named(tiny, lights, tmp_path, capsys):
    for part in ("images", "labels"):
        (tmp_path / part).symlink_to(lights / part)
    (tmp_path / "data.yaml").write_text("names: [red, green, blue]\n")

    describe_run(tiny(data=str(tmp_path)))

    assert "no label to train on for blue" in capsys.readouterr().err
