"""The whole way in miniature through the command line: every verb, seconds of simulation, tens of training steps."""

import json
import math
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

Program = Callable[..., subprocess.CompletedProcess[str]]

TRAINING_STACK = ("torch", "torchvision", "albumentations", "onnx", "tensorboard", "matplotlib", "faster_coco_eval")
_DRIVES = """
seed: 5
frame_rate_hz: 5
workers: 1
drives:
  - {name: short, lighting: overcast, duration_s: 2.0}
"""
_DEMO = """
images: {{config: sim/images_demo, overrides: [train_images=6, val_images=3, workers=1, seed=5]}}
drives: {{config: {folder}/drives.yaml}}
train:
  config: train/demo
  overrides: ["weights=''", epochs=2, batch=8, nominal_batch=8, crops.size=96, crops.per_image=16, schedule.cycles=1]
runtime: {{config: runtime/default}}
input_size_wh: [320, 224]
score_threshold: 0.05
"""


@pytest.fixture(scope="module")
def demo(program: Program, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished miniature demo."""
    folder = tmp_path_factory.mktemp("mini")
    (folder / "drives.yaml").write_text(_DRIVES)
    (folder / "demo.yaml").write_text(_DEMO.format(folder=folder))
    result = program("demo", "--config", folder / "demo.yaml", "--out", folder / "demo")
    assert result.returncode == 0, result.stderr
    return folder / "demo"


def test_demo_leaves_summary_and_report(demo: Path) -> None:
    summary = json.loads((demo / "summary.json").read_text())
    assert set(summary["minutes"]) >= {
        "images",
        "drives",
        "train",
        "val",
        "export",
        "fit-hmm",
        "bundle",
        "run",
        "evaluate",
        "report",
    }
    assert set(summary["detector"]) >= {"ap", "ap50", "ap75", "ap_s", "ap_m", "fps"}
    for variant in ("od", "od_fusion", "proposed"):
        assert set(summary[variant]) >= {"fps", "ape_m", "ape_count", "class_accuracy", "misses", "labelled"}
        assert summary[variant]["labelled"] > 10
        assert 0 <= summary[variant]["class_accuracy"] <= 100
    page = (demo / "report.html").read_text()
    assert page.lower().startswith("<!doctype html>")
    assert not re.search(r"""(src|href)=["']?https?:""", page)


def test_second_demo_does_nothing_twice(program: Program, demo: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in demo.rglob("*") if path.is_file()}
    result = program("demo", "--config", demo.parent / "demo.yaml", "--out", demo)
    assert result.returncode == 0
    assert result.stderr.count("up to date") == 11
    assert {path: path.stat().st_mtime_ns for path in demo.rglob("*") if path.is_file()} == before


def test_each_verb_by_itself(program: Program, demo: Path, tmp_path: Path) -> None:
    def run(*arguments: str | Path) -> str:
        result = program(*arguments)
        assert result.returncode == 0, result.stderr
        assert "Traceback" not in result.stderr
        return result.stdout

    run(
        "simulate",
        "images",
        "sim/images_demo",
        "train_images=2",
        "val_images=1",
        "workers=1",
        "--out",
        tmp_path / "images",
    )
    assert len(list((tmp_path / "images").rglob("*.jpg"))) == 3
    run("simulate", "drives", demo.parent / "drives.yaml", "--out", tmp_path / "drives")
    drive = tmp_path / "drives" / "short"
    assert (drive / "truth.jsonl").read_bytes() == (demo / "drives" / "short" / "truth.jsonl").read_bytes()
    quick = ["weights=''", "epochs=1", "batch=2", "crops.size=64", "schedule.cycles=1"]
    run("train", "train/demo", f"data={tmp_path / 'images'}", *quick, "--out", tmp_path / "train")
    best = tmp_path / "train" / "best.pt"
    val = tmp_path / "val"
    metrics = run(
        "val", best, tmp_path / "images", "--long-side", "320", "--score-threshold", "0.05", "--out", val, "--json"
    )
    assert json.loads(metrics)["images"] == 1
    model = tmp_path / "model.onnx"
    run("export", best, "--size", "320x224", "--score-threshold", "0.05", "--out", model)
    run("fit-hmm", val / "confusion.json", "--out", tmp_path / "hmm.json")
    parts = ["--model", model, "--hmm", tmp_path / "hmm.json", "--confusion", val / "confusion.json"]
    run("bundle", *parts, "--out", tmp_path / "bundle")
    variants = ["--variant", "od", "--variant", "fusion", "--variant", "full"]
    estimates = tmp_path / "estimates"
    run("run", demo / "bundle", drive, *variants, "--out", estimates)
    assert len((estimates / "estimates.jsonl").read_text().splitlines()) == 3 * 10
    found = json.loads(run("detect", tmp_path / "bundle", tmp_path / "images", "--out", tmp_path / "detect", "--json"))
    assert found["images"] == 3
    scores = json.loads(run("evaluate", estimates, "--out", tmp_path / "evaluation.json", "--json"))
    assert not any(math.isnan(value) for value in _numbers(scores))
    proof = ["--train", tmp_path / "train", "--val", val, "--bundle", demo / "bundle"]
    run("report", estimates, *proof, "--out", tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size > 10_000


def test_the_runtime_runs_a_bundle_where_the_training_stack_is_absent(demo: Path, tmp_path: Path) -> None:
    arguments = ["autolights", "run", str(demo / "bundle"), str(demo / "drives" / "short"), "--out", str(tmp_path)]
    code = f"""
import sys
sys.modules.update(dict.fromkeys({TRAINING_STACK!r}))
sys.argv = {arguments!r}
from autolights.cli import main
main()
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "estimates.jsonl").is_file()


def test_the_readme_example_prints_lights(demo: Path) -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    code = re.search(r"```python\n(.*?)```", readme, re.DOTALL)
    assert code
    script = code.group(1).replace("runs/demo", str(demo)).replace("runtime/default", str(demo.parent / "eager.yaml"))
    (demo.parent / "eager.yaml").write_text("fusion_score_threshold: 0.0\nnew_light_score_threshold: 0.0\n")
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr


def _numbers(value: object) -> list[float]:
    if isinstance(value, dict):
        return [number for entry in value.values() for number in _numbers(entry)]
    if isinstance(value, list):
        return [number for entry in value for number in _numbers(entry)]
    return [value] if isinstance(value, float) else []
