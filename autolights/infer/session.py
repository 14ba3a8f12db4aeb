"""An ONNX Runtime session that was checked against the description of its model."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnxruntime

from autolights.core import FloatArray, ModelInfo
from autolights.core.errors import DataError, UsageError


class OnnxSession:
    """Run a model of fixed input size.

    Args:
        model_path: The ONNX file.
        info: What the model must look like.
        providers: ONNX Runtime's execution providers in order of preference; None: the CPU.
        threads: Within an operator; None leaves the choice to ONNX Runtime.

    Raises:
        UsageError: If the file is missing or a provider is not there.
        DataError: If the file is no model, or input or output differ from `info`.
    """

    def __init__(
        self,
        model_path: Path,
        info: ModelInfo,
        *,
        providers: Sequence[str] | None = None,
        threads: int | None = None,
    ) -> None:
        if not model_path.is_file():
            raise UsageError(f"{model_path}: no such model; make one with `autolights export`")
        wanted = list(providers or ["CPUExecutionProvider"])
        available = onnxruntime.get_available_providers()
        absent = [name for name in wanted if name not in available]
        if absent:
            raise UsageError(f"ONNX Runtime has no provider '{absent[0]}' here; there are: {', '.join(available)}")
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3  # errors only: its warnings are about its own optimiser
        # Threads that wait actively lose to any busy neighbour: nano at 960 x 608 on 2 cores took 62 ms instead of 25
        # beside one other process, and 18 instead of 20 alone.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        if threads is not None:
            options.intra_op_num_threads = threads
        try:
            self._session = onnxruntime.InferenceSession(str(model_path), options, providers=wanted)
        except Exception as error:  # ONNX Runtime has a class of its own for each kind of damage
            raise DataError(f"{model_path}: ONNX Runtime cannot read it ({_first_line(error)})") from error
        self._input_name = _check_ports(self._session, model_path, info)

    def run(self, blob: FloatArray) -> FloatArray:
        """Run the network.

        Args:
            blob: (1, 3, H, W) float32, RGB in [0, 1].

        Returns:
            (1, N, 5 + C) float32 raw output.
        """
        return np.asarray(self._session.run(None, {self._input_name: blob})[0])


def _check_ports(session: onnxruntime.InferenceSession, model_path: Path, info: ModelInfo) -> str:
    inputs, outputs = session.get_inputs(), session.get_outputs()
    width, height = info.size_wh
    if len(inputs) != 1 or inputs[0].shape != [1, 3, height, width]:
        raise DataError(
            f"{model_path}: input must be [1, 3, {height}, {width}] as described, "
            f"got {[port.shape for port in inputs]}; export again"
        )
    columns = 5 + len(info.classes)
    if len(outputs) != 1 or len(outputs[0].shape) != 3 or outputs[0].shape[2] != columns:
        raise DataError(
            f"{model_path}: output must be [1, N, {columns}] for {len(info.classes)} classes, "
            f"got {[port.shape for port in outputs]}; export again"
        )
    return str(inputs[0].name)


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]
