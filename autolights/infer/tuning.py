"""How a model runs best on this machine: measured once by `autolights tune`, remembered for the user."""

import os
import platform
from functools import lru_cache
from pathlib import Path

import onnxruntime
from pydantic import Field, ValidationError

from autolights.core import Config
from autolights.core.json_files import write_json
from autolights.infer.execution import Execution, openvino_is_installed, usable_cpus


class Machine(Config):
    """What a measurement holds for.

    Attributes:
        name: Of the host.
        processor: Model of the CPU.
        cpus: Logical CPUs that the process may use.
    """

    name: str
    processor: str
    cpus: int = Field(ge=1)


class Measurement(Config):
    """What one execution took, and how far it is from the default's numbers.

    Attributes:
        execution: The execution.
        set_ms: Median time of one set of images: letterbox, network, decoding.
        prob_difference: Largest difference of a probability from ONNX Runtime's on the CPU, on the images of the
            measurement.
        in_turns: It was among the best, which took turns; the time of the others is that of a brief look, at another
            moment.
    """

    execution: Execution
    set_ms: float = Field(ge=0)
    in_turns: bool
    prob_difference: float = Field(ge=0)


class Tuning(Config):
    """The record of one measurement.

    Attributes:
        machine: Where it was made.
        model_sha256: Of the model file.
        onnxruntime: Version.
        images: In a set.
        image_wh: Of each.
        best: What `Detector.from_bundle` takes from now on.
        measurements: Those that took turns, then the others, the fastest first.
    """

    machine: Machine
    model_sha256: str
    onnxruntime: str
    images: int = Field(ge=1)
    image_wh: tuple[int, int]
    best: Execution
    measurements: tuple[Measurement, ...]

    def save(self) -> Path:
        """Write the record where `tuned_execution` looks for it, and return the path."""
        path = _path(self.machine, self.model_sha256)
        write_json(path, self.model_dump(mode="json"))
        return path


@lru_cache(maxsize=1)
def this_machine() -> Machine:
    """The machine that the process runs on."""
    return Machine(name=platform.node() or "unknown", processor=_processor(), cpus=usable_cpus())


def tuned_execution(model_sha256: str) -> Execution | None:
    """What was measured to be best for this model on this machine; None if nothing was, or it is not here any more."""
    machine = this_machine()
    path = _path(machine, model_sha256)
    try:
        tuning = Tuning.model_validate_json(path.read_bytes())
    except (OSError, ValidationError):  # not measured, or by another version: it can be measured again
        return None
    best = tuning.best
    there = set(best.providers) <= set(onnxruntime.get_available_providers())
    if tuning.machine != machine or not there or (best.backend == "openvino" and not openvino_is_installed()):
        return None
    return best


def _folder() -> Path:
    cache = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(cache) if cache else Path.home() / ".cache") / "autolights" / "tuning"


def _path(machine: Machine, model_sha256: str) -> Path:
    """The machine's name is in it: homes are shared between machines."""
    name = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in machine.name)
    return _folder() / f"{name}-{model_sha256[:16]}.json"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
