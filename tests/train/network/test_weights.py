"""Checkpoints: ours go round, the public ones load, hostile ones do nothing."""

import os
import sys
import types
from pathlib import Path

import pytest
import torch
from torch import nn

from autolights.core.errors import CheckpointError, UsageError
from autolights.core.model_info import InitialWeights
from autolights.train.network import weights
from autolights.train.network.checkpoint import Checkpoint
from autolights.train.network.model import ANCHORS_PX, FINE_STRIDES, STRIDES, YoloV5
from autolights.train.network.weights import load_checkpoint, read_checkpoint, start_from


def save_own(path: Path, model: YoloV5, initial_weights: InitialWeights | None = None) -> Path:
    Checkpoint(
        model.size, model.classes, dict(model.state_dict()), initial_weights, epoch=3, strides=model.strides
    ).save(path)
    return path


@pytest.fixture(params=["models", "yolov5.models"], ids=["repository", "package"])
def foreign_classes(request, monkeypatch):
    """Importable stand-ins for the public trainer's modules, so that its kind of pickle can be written."""
    root = request.param
    monkeypatch.setitem(sys.modules, root.partition(".")[0], types.ModuleType(root))
    monkeypatch.setitem(sys.modules, root, types.ModuleType(root))
    for module_name, class_names in {f"{root}.common": ["Conv"], f"{root}.yolo": ["Model", "Detect"]}.items():
        module = types.ModuleType(module_name)
        for name in class_names:
            setattr(module, name, type(name, (nn.Module,), {"__module__": module_name}))
        monkeypatch.setitem(sys.modules, module_name, module)
    return sys.modules[f"{root}.yolo"], sys.modules[f"{root}.common"]


def as_foreign(module: nn.Module, kind: type[nn.Module]) -> nn.Module:
    """The same tensors under the same names, in modules of another class."""
    foreign = kind()
    foreign._parameters, foreign._buffers = module._parameters, module._buffers
    foreign._modules = {name: as_foreign(child, kind) for name, child in module._modules.items()}
    return foreign


def save_public(path: Path, model: YoloV5, foreign_classes) -> Path:
    yolo, common = foreign_classes
    network = yolo.Model()
    network.model = as_foreign(model.model, common.Conv)
    network.names = {0: "red", 1: "green"}
    torch.save({"epoch": -1, "model": network.half(), "ema": None, "optimizer": None}, path)
    return path


class RunsCode:
    """Leaves a trace when it is unpickled by anything that trusts it."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self):
        return os.mkdir, (str(self.trace),)


def test_own_checkpoint_goes_round(tmp_path):
    model = YoloV5("n", 2, ["red", "green"])
    model.model[0].bn.running_var.fill_(1e6)  # beyond half precision
    initial = InitialWeights(name="x.pt", sha256="ab", licence="Apache-2.0")

    path = save_own(tmp_path / "best.pt", model, initial)
    loaded = load_checkpoint(path, classes=["red", "green"])

    assert path.stat().st_size < 4_000_000
    assert not loaded.training
    assert (loaded.size, loaded.classes, loaded.initial_weights) == ("n", ("red", "green"), initial)
    assert read_checkpoint(path).epoch == 3
    for name, tensor in model.state_dict().items():
        torch.testing.assert_close(loaded.state_dict()[name], tensor, rtol=1e-3, atol=1e-6)


def test_a_pickle_that_runs_code_is_refused_and_does_not_run(tmp_path):
    trace = tmp_path / "trace"
    torch.save({"model": RunsCode(trace)}, tmp_path / "evil.pt")

    with pytest.raises(CheckpointError, match=r"evil\.pt: refers to \w+\.mkdir, .*could run code"):
        load_checkpoint(tmp_path / "evil.pt")

    assert not trace.exists()
    torch.load(tmp_path / "evil.pt", weights_only=False)
    assert trace.exists()  # the trap was armed


def test_code_behind_an_allowed_name_does_not_run(tmp_path, monkeypatch):
    ran = []
    module = types.ModuleType("models.common")

    class Trap:
        def __setstate__(self, state):
            ran.append(state)

    Trap.__module__, Trap.__qualname__ = "models.common", "Trap"
    module.Trap = Trap
    monkeypatch.setitem(sys.modules, "models", types.ModuleType("models"))
    monkeypatch.setitem(sys.modules, "models.common", module)
    trap = Trap()
    trap.armed = True
    torch.save({"model": trap}, tmp_path / "trap.pt")

    with pytest.raises(CheckpointError, match="its first layer has None channels"):
        load_checkpoint(tmp_path / "trap.pt")

    assert not ran


def test_public_layout_is_read_without_its_classes(tmp_path, foreign_classes, monkeypatch):
    model = YoloV5("n", 2)
    expected = {name: tensor.half().float() for name, tensor in model.state_dict().items()}
    path = save_public(tmp_path / "public.pt", model, foreign_classes)
    for module in foreign_classes:
        monkeypatch.delitem(sys.modules, module.__name__)

    loaded = load_checkpoint(path)

    assert loaded.classes == ("red", "green")
    assert loaded.initial_weights.licence == "AGPL-3.0"
    for name, tensor in loaded.state_dict().items():
        torch.testing.assert_close(tensor.float(), expected[name])


def test_copyleft_is_inherited_down_the_line(tmp_path, foreign_classes):
    public = save_public(tmp_path / "public.pt", YoloV5("n", 2), foreign_classes)
    child = YoloV5("n", 3)
    start_from(child, str(public))
    child_path = save_own(tmp_path / "child.pt", child, child.initial_weights)

    grandchild = YoloV5("n", 3)
    start_from(grandchild, str(child_path))
    orphan_path = save_own(tmp_path / "orphan.pt", YoloV5("n", 3))
    heir = YoloV5("n", 3)
    start_from(heir, str(orphan_path))

    assert (grandchild.initial_weights.name, grandchild.initial_weights.licence) == ("child.pt", "AGPL-3.0")
    assert (heir.initial_weights.name, heir.initial_weights.licence) == ("orphan.pt", "Apache-2.0")


def test_transfer_reports_what_does_not_fit(tmp_path):
    source = YoloV5("n", 3, ["car", "ball", "bus"])
    target = YoloV5("n", 2, ["arrow", "ball"])
    fresh, theirs = (model.model[24].m[0].weight.detach().clone().unflatten(0, (3, -1)) for model in (target, source))

    report = start_from(target, str(save_own(tmp_path / "coco.pt", source)))

    assert str(report).startswith(
        "343 of 349 tensors loaded; box, objectness and classes of like name alone: "
        "model.24.m.0.weight (24 → 21 channels), model.24.m.0.bias"
    )
    rows = target.model[24].m[0].weight.unflatten(0, (3, -1))
    torch.testing.assert_close(rows[:, :5], theirs[:, :5].half().float())  # box and objectness
    assert torch.equal(rows[:, 5], fresh[:, 5])  # the arrow is new
    torch.testing.assert_close(rows[:, 6], theirs[:, 6].half().float())  # the ball is known
    torch.testing.assert_close(target.model[23].cv3.conv.weight, source.model[23].cv3.conv.weight.half().float())


def test_as_many_classes_by_other_names_are_other_classes(tmp_path):
    source, target = YoloV5("n", 3, ["car", "ball", "bus"]), YoloV5("n", 3, ["bus", "ball", "arrow"])

    report = start_from(target, str(save_own(tmp_path / "other.pt", source)))

    assert str(report).startswith("343 of 349 tensors loaded; box, objectness and classes of like name alone")
    theirs, ours = (model.model[24].m[0].bias.view(3, -1) for model in (source, target))
    torch.testing.assert_close(ours[:, :7], theirs[:, [0, 1, 2, 3, 4, 7, 6]].half().float())


def test_a_level_more_or_less_keeps_what_is_common(tmp_path):
    published, fine = YoloV5("n", 2), YoloV5("n", 2, strides=FINE_STRIDES)
    published.set_anchors(torch.full((3, 3, 2), 40.0))
    fine.set_anchors(torch.full((4, 3, 2), 20.0))
    paths = [save_own(tmp_path / f"{len(model.strides)}.pt", model) for model in (published, fine)]

    wider, narrower = YoloV5("n", 2, strides=FINE_STRIDES), YoloV5("n", 2)
    reports = [str(start_from(model, str(path))) for model, path in zip((wider, narrower), paths, strict=True)]

    assert reports == [
        "349 of 387 tensors loaded; re-initialised: model.24.m.3.weight (not in the file), "
        "model.24.m.3.bias (not in the file), fine (not in the file)",
        "349 of 349 tensors loaded; not used: model.24.m.3.weight, model.24.m.3.bias, fine",
    ]
    assert (wider.anchors_px[:3] == 40).all()
    assert wider.anchors_px[3].tolist() == [list(side) for side in ANCHORS_PX[4]]
    assert (narrower.anchors_px == 20).all()


def test_levels_and_anchors_go_round(tmp_path):
    model = YoloV5("n", 2, strides=FINE_STRIDES)
    model.set_anchors(torch.arange(8.0, 32.0).view(4, 3, 2))
    path = save_own(tmp_path / "fine.pt", model)

    loaded = load_checkpoint(path)

    assert loaded.strides == FINE_STRIDES
    torch.testing.assert_close(loaded.anchors_px, model.anchors_px)
    before_levels = {k: v for k, v in torch.load(save_own(path, YoloV5("n", 2))).items() if k != "strides"}
    torch.save({**before_levels, "format_version": 1}, path)
    assert load_checkpoint(path).strides == STRIDES
    torch.save({**before_levels, "strides": [8, 16]}, path)
    with pytest.raises(CheckpointError, match=r"fine\.pt: strides must be .* got \(8, 16\)"):
        load_checkpoint(path)


def test_unusable_files_say_why(tmp_path):
    with pytest.raises(UsageError, match=r"none\.pt: no such checkpoint"):
        load_checkpoint(tmp_path / "none.pt")
    (tmp_path / "text.pt").write_text("hello")
    with pytest.raises(CheckpointError, match=r"text\.pt: cannot be read as a checkpoint"):
        load_checkpoint(tmp_path / "text.pt")
    torch.save({"weights": torch.zeros(1)}, tmp_path / "other.pt")
    with pytest.raises(CheckpointError, match=r"other\.pt: not a checkpoint of autolights.*'weights'"):
        load_checkpoint(tmp_path / "other.pt")
    path = save_own(tmp_path / "own.pt", YoloV5("n", 2, ["red", "green"]))
    with pytest.raises(CheckpointError, match=r"knows 2 classes \[red, green\], not \[green, red\]"):
        load_checkpoint(path, classes=["green", "red"])
    with pytest.raises(CheckpointError, match="holds a YOLOv5n; set size to 'n'"):
        start_from(YoloV5("s", 2), str(path))
    Checkpoint("n", ("red",), dict(YoloV5("n", 2).state_dict())).save(tmp_path / "short.pt")
    with pytest.raises(CheckpointError, match=r"short\.pt: its head is for 2 classes, there are 1 names \[red\]"):
        load_checkpoint(tmp_path / "short.pt")
    whole = torch.load(path, weights_only=True)
    torch.save({**whole, "format_version": 99}, path)
    with pytest.raises(CheckpointError, match="format 99 is newer than 2; upgrade autolights"):
        load_checkpoint(path)
    torch.save({key: value for key, value in whole.items() if key != "state"}, path)
    with pytest.raises(CheckpointError, match="field 'state' is missing"):
        load_checkpoint(path)


def test_a_failed_save_leaves_the_old_file(tmp_path, monkeypatch):
    path = save_own(tmp_path / "last.pt", YoloV5("n", 2))
    before = path.read_bytes()

    write = torch.save

    def stop(_values, file):
        write({}, file)
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", stop)
    with pytest.raises(KeyboardInterrupt):
        save_own(path, YoloV5("n", 2))

    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["last.pt"]


def test_base_names_the_shipped_checkpoint(tmp_path, monkeypatch):
    path = save_own(tmp_path / "yolov5n_test.pt", YoloV5("n", 2))
    monkeypatch.setattr(weights, "BASE_PATH", path)
    model = YoloV5("n", 2)

    assert str(start_from(model, "base")) == "349 of 349 tensors loaded"
    assert model.initial_weights.name == "yolov5n_test.pt"
