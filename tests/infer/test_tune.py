import json
import os

import numpy as np
import pytest
from typer.testing import CliRunner

from autolights.cli.app import app
from autolights.core import Bundle, ConfusionMatrix, load_signals
from autolights.core.atomic import sha256
from autolights.infer import Detector, Execution
from autolights.infer.execution import usable_cpus
from autolights.infer.tuning import Machine, Tuning, this_machine, tuned_execution
from autolights.train.deliver.hmm_fitting import fit_hmm
from autolights.tune import WORTH_A_CHANGE, _best, tune_bundle

pytestmark = pytest.mark.alone

SIGNALS = load_signals()
ONE, TWO, STREAMS = Execution(threads=1), Execution(threads=2), Execution(threads=2, streams=2)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def bundle_dir(constant_model, tmp_path):
    path, info = constant_model([[32, 16, 10, 20, 0.5, *[0.8] * len(SIGNALS.classes)]], classes=SIGNALS.classes)
    confusion = ConfusionMatrix(SIGNALS.classes, np.zeros((14, 14), dtype=np.int64), 0.25, 0.5)
    Bundle(info, path, SIGNALS, fit_hmm(confusion, SIGNALS), confusion).save(tmp_path / "bundle")
    return tmp_path / "bundle"


def saved(model_path, execution, **changes):
    values = {
        "machine": this_machine(),
        "model_sha256": sha256(model_path),
        "onnxruntime": "1",
        "images": 2,
        "image_wh": (64, 32),
        "best": execution,
        "measurements": (),
    }
    return Tuning(**values | changes).save()


def test_what_is_found_best_is_used_from_then_on(bundle_dir, cache):
    bundle = Bundle.load(bundle_dir)
    assert Detector.from_bundle(bundle).execution == Execution()

    result = tune_bundle(bundle, images=3, image_wh=(96, 48), seconds=0.05)

    best = result.tuning.best
    assert result.path.parent == cache / "autolights" / "tuning"
    assert this_machine().name in result.path.name
    assert Detector.from_bundle(bundle).execution == best
    assert Detector.from_bundle(bundle, threads=1).execution == ONE  # asked for explicitly
    assert Detector.from_bundle(bundle, TWO).execution == TWO
    assert not result.refused
    measured = [each.execution for each in result.tuning.measurements]
    assert best in measured
    assert ONE in measured
    assert any(each.backend == "openvino" for each in measured)
    assert not any(each.bfloat16 for each in measured)
    assert all(each.threads is None or each.threads <= usable_cpus() for each in measured)
    assert all(each.prob_difference == 0 for each in result.tuning.measurements)
    order = [(not each.in_turns, each.set_ms) for each in result.tuning.measurements]
    assert order == sorted(order)
    assert min(set_ms for _, set_ms in order) > 0
    assert best in [each.execution for each in result.tuning.measurements if each.in_turns]
    Bundle.load(bundle_dir)  # nothing in it was touched


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"machine": Machine(name=this_machine().name, processor="another", cpus=1)}, "another machine of that name"),
        ({"best": Execution(providers=("CUDAExecutionProvider",))}, "the GPU's package was removed"),
    ],
)
def test_a_record_that_does_not_hold_here_is_left_alone(bundle_dir, changes, why):
    model_path = bundle_dir / "model.onnx"
    saved(model_path, TWO, **changes)

    assert tuned_execution(sha256(model_path)) is None, why


def test_another_model_and_a_damaged_record(bundle_dir, tmp_path):
    model_path = bundle_dir / "model.onnx"
    path = saved(model_path, TWO)
    assert tuned_execution(sha256(model_path)) == TWO

    other = tmp_path / "other.onnx"
    other.write_bytes(b"other")
    assert tuned_execution(sha256(other)) is None
    path.write_text("{")
    assert tuned_execution(sha256(model_path)) is None


@pytest.mark.parametrize(
    ("measured", "best"),
    [
        pytest.param([(ONE, 10), (TWO, 8), (STREAMS, 9)], TWO, id="the-fastest"),
        pytest.param([(ONE, 10), (TWO, 10 * WORTH_A_CHANGE + 0.01)], ONE, id="noise-is-no-reason"),
        pytest.param([(ONE, 10)], ONE, id="alone"),
    ],
)
def test_which_is_best(measured, best):
    assert _best(measured) == best


@pytest.mark.parametrize(
    ("choices", "execution"),
    [
        ({"threads": 2, "images_at_once": 2}, STREAMS),
        ({"threads": 2, "images_at_once": 5}, STREAMS),
        ({"threads": 1, "images_at_once": 2}, ONE),
        ({"threads": 4}, Execution(threads=4)),
        ({"providers": ["CPUExecutionProvider"]}, Execution(providers=("CPUExecutionProvider",))),
        ({"execution": TWO, "images_at_once": 2}, TWO),
    ],
)
def test_without_tuning_cameras_share_the_threads(bundle_dir, choices, execution):
    assert Detector.from_bundle(Bundle.load(bundle_dir), **choices).execution == execution


def test_verb(bundle_dir):
    arguments = ["tune", str(bundle_dir), "--images", "1", "--image-size", "64x32", "--seconds", "0"]

    table = CliRunner().invoke(app, arguments)
    as_json = CliRunner().invoke(app, [*arguments, "--json"])

    assert table.exit_code == as_json.exit_code == 0
    assert "onnxruntime, 1 thread" in table.stdout
    assert table.stdout.count("<- best") == 1
    values = json.loads(as_json.stdout)
    assert os.path.isfile(values["path"])
    assert values["machine"]["cpus"] == usable_cpus()


def test_verb_misused(bundle_dir):
    result = CliRunner().invoke(app, ["tune", str(bundle_dir), "--image-size", "big"])

    assert "--image-size must be like 1920x1200, got 'big'" in str(result.exception)
