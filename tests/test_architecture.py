"""What the import contracts cannot see: the runtime's modules load where the training stack is absent."""

import subprocess
import sys
from pathlib import Path

import pytest

import autolights

PACKAGE = Path(autolights.__file__).parent
TRAINING_STACK = ("torch", "torchvision", "albumentations", "onnx", "tensorboard", "matplotlib", "faster_coco_eval")
RUNTIME_MODULES = (
    "autolights.core",
    "autolights.data",
    "autolights.infer",
    "autolights.track",
    "autolights.pipeline",
    "autolights.run_drive",
    "autolights.detect",
    "autolights.tune",
    "autolights.cli",
)


def _run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("module", RUNTIME_MODULES)
def test_runtime_imports_without_the_training_stack(module: str) -> None:
    result = _run(f"import sys; sys.modules.update(dict.fromkeys({TRAINING_STACK!r})); import {module}")
    assert result.returncode == 0, result.stderr


def test_training_verb_without_training_stack_says_what_to_install() -> None:
    code = f"""
import sys
sys.modules.update(dict.fromkeys({TRAINING_STACK!r}))
sys.argv = ["autolights", "export", {str(PACKAGE / "__init__.py")!r}, "--out", "never.onnx"]
from autolights.cli import main
main()
"""
    result = _run(code)
    assert result.returncode == 2
    assert "pip install 'autolights[train]'" in result.stderr


def test_import_of_the_package_does_nothing() -> None:
    result = _run("import autolights, sys; print([name for name in sys.modules if name.startswith('autolights.')])")
    assert result.stdout.strip() == "[]"


def test_files_have_one_job() -> None:
    names = {path.stem for path in PACKAGE.rglob("*.py")}
    assert not names & {"utils", "helpers", "misc", "common"}


def test_shipped_configurations_are_found_from_an_installed_package() -> None:
    from autolights.core import find_config

    assert find_config("signals/autolights_13").is_file()
    assert find_config("configs/signals/autolights_13.yaml").is_file()
