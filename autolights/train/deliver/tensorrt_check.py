"""Would TensorRT read this file? Its sibling for RTX cards parses and builds it here, without a GPU.

The sibling shares parser and compiler with TensorRT, and, like TensorRT 11, keeps to the types of the graph. What it
builds is strong evidence that TensorRT 10 and 11 build it, no proof; and nothing is run.
"""

import importlib.util
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import onnx

from autolights.core import ModelInfo
from autolights.core.errors import DataError, UsageError
from autolights.train.deliver.onnx_file import without_plugin
from autolights.train.deliver.tensorrt_shapes import input_shapes, is_dynamic

# Turing (RTX 20, T4), Ampere (A100; RTX 30, A40), Ada (RTX 40, L4). The sibling lacks Hopper (9.0): no RTX card has it.
COMPUTE_CAPABILITIES = ("7.5", "8.0", "8.6", "8.9")
_TIMEOUT_S = 600


@dataclass(frozen=True)
class TensorRtBuild:
    """One try.

    Attributes:
        compute_capability: Like ``7.5``.
        error: What the parser or builder said, with the node's name; empty if the engine was built.
        engine_bytes: Its size.
        seconds: For parsing and building.
    """

    compute_capability: str
    error: str = ""
    engine_bytes: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class TensorRtCheck:
    """All tries with one file."""

    path: Path
    builds: tuple[TensorRtBuild, ...]
    without_plugin: bool = False

    @property
    def is_ok(self) -> bool:
        """Whether every engine was built."""
        return not any(build.error for build in self.builds)

    def raise_if_refused(self) -> None:
        """Raise `DataError` if an engine could not be built."""
        refused = [build.compute_capability for build in self.builds if build.error]
        if refused:
            raise DataError(f"{self.path}: TensorRT for RTX does not build it for {', '.join(refused)}; see above")

    def to_text(self) -> str:
        """A line for each compute capability."""
        lines = [f"{self.path}: TensorRT for RTX" + (", all up to the plug-in" if self.without_plugin else "")]
        for build in self.builds:
            result = build.error or f"OK ({build.engine_bytes / 2**20:.1f} MiB, {build.seconds:.1f} s)"
            lines.append(f"  compute capability {build.compute_capability}: {result}")
        return "\n".join(lines)


def check_tensorrt(
    path: Path, info: ModelInfo, compute_capabilities: Sequence[str] = COMPUTE_CAPABILITIES
) -> TensorRtCheck:
    """Parse and build an exported model for each compute capability; no GPU is needed.

    Args:
        path: The ONNX file. Of one that ends in TensorRT's plug-in, which the sibling lacks, all up to it is built.
        info: Its description; says which shapes are free.
        compute_capabilities: Of the GPUs, like ``8.6``.

    Raises:
        UsageError: If the package is missing or a compute capability does not read like one.
    """
    if importlib.util.find_spec("tensorrt_rtx") is None:
        raise UsageError(
            "checking needs TensorRT for RTX; install it with: pip install 'autolights[check-tensorrt]' "
            "(its licence is NVIDIA's own, and it is for Linux and Windows on x86-64)"
        )
    for name in compute_capabilities:
        if not re.fullmatch(r"\d{1,2}\.\d", name):
            raise UsageError(f"a compute capability reads like 8.6, got {name!r}")
    shapes = [list(shape) for shape in input_shapes(info)] if is_dynamic(info) else None
    with tempfile.TemporaryDirectory() as folder:
        built = path
        if info.head == "efficient-nms":
            built = Path(folder) / "without_plugin.onnx"
            onnx.save(without_plugin(onnx.load(path)), built)
        builds = tuple(_build(built, name, shapes) for name in compute_capabilities)
    return TensorRtCheck(path, builds, without_plugin=info.head == "efficient-nms")


def _build(path: Path, compute_capability: str, shapes: list[list[int]] | None) -> TensorRtBuild:
    task = {
        "model": str(path),
        "compute_capability": f"SM{compute_capability.replace('.', '')}",
        "shapes": shapes,
    }
    command = [sys.executable, "-m", "autolights.train.deliver.tensorrt_rtx_build", json.dumps(task)]
    try:
        process = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S)  # noqa: S603
    except subprocess.TimeoutExpired:
        return TensorRtBuild(compute_capability, error=f"not built within {_TIMEOUT_S} s")
    if process.returncode:
        last = (process.stderr.strip() or "no message").rpartition("\n")[2]
        return TensorRtBuild(compute_capability, error=f"the builder ended with code {process.returncode} ({last})")
    result = json.loads(process.stdout.splitlines()[-1])
    if "error" in result:
        return TensorRtBuild(compute_capability, error=result["error"])
    return TensorRtBuild(compute_capability, engine_bytes=result["bytes"], seconds=result["seconds"])
