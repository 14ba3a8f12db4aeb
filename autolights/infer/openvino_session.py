"""A model run by OpenVINO, often the fastest on Intel's CPUs; an optional package (``autolights[openvino]``)."""

from pathlib import Path
from typing import Any

import numpy as np

from autolights.core import FloatArray, ModelInfo
from autolights.core.errors import DataError, UsageError
from autolights.core.model_guard import read_model
from autolights.infer.ports import Port, check_ports


class OpenVinoSession:
    """Run a model on the CPU by OpenVINO; the same interface as `OnnxSession`.

    Args:
        model_path: The ONNX file.
        info: What the model must look like.
        sha256: What the file must hash to; empty: anything.
        threads: Of the inference; None leaves the choice to OpenVINO.
        bfloat16: Let it compute in bfloat16 where the CPU can (AMX, AVX512-BF16): faster, but class probabilities move
            in the third decimal. Else it computes as the model says, even where OpenVINO by itself would not.

    Raises:
        UsageError: If the file or the package is missing.
        BundleError: If the file hashes to something else.
        DataError: If the file is no model, or input or output differ from `info`.
    """

    on_gpu = False

    def __init__(
        self,
        model_path: Path,
        info: ModelInfo,
        *,
        sha256: str = "",
        threads: int | None = None,
        bfloat16: bool = False,
    ) -> None:
        if not model_path.is_file():
            raise UsageError(f"{model_path}: no such model; make one with `autolights export`")
        try:
            import openvino
        except ImportError as error:
            raise UsageError("the backend 'openvino' needs a package: pip install 'autolights[openvino]'") from error

        settings: dict[str, Any] = {
            "PERFORMANCE_HINT": "LATENCY",
            # What the hint "latency" would choose by itself is bfloat16 where the CPU has it.
            "INFERENCE_PRECISION_HINT": "bf16" if bfloat16 else "f32",
            "ENABLE_CPU_PINNING": False,  # threads that are bound to cores lose to any busy neighbour
        }
        if threads is not None:
            settings["INFERENCE_NUM_THREADS"] = threads
        data = read_model(model_path, sha256)
        core = openvino.Core()
        try:
            model = core.read_model(data, b"")
        except RuntimeError as error:
            raise DataError(f"{model_path}: OpenVINO cannot read it ({_reason(error)})") from error
        names = check_ports([_port(p) for p in model.inputs], [_port(p) for p in model.outputs], model_path, info)
        try:
            self._request = core.compile_model(model, "CPU", settings).create_infer_request()
        except RuntimeError as error:
            raise DataError(f"{model_path}: OpenVINO cannot compile it ({_reason(error)})") from error
        self._input_name, self._output_names = names

    def run(self, blob: FloatArray) -> tuple[FloatArray, ...]:
        """See `Session`; the next call overwrites what is returned."""
        outputs = self._request.infer({self._input_name: blob}, share_inputs=True, share_outputs=True)
        return tuple(np.asarray(outputs[name]) for name in self._output_names)


def _port(port: Any) -> Port:
    shape = tuple(None if length.is_dynamic else length.get_length() for length in port.get_partial_shape())
    return Port(port.get_any_name(), shape, np.dtype(port.get_element_type().to_dtype()).name)


def _reason(error: Exception) -> str:
    """The last line of OpenVINO's many that says something."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__
