"""An ONNX Runtime session that was checked against the description of its model."""

import io
from collections.abc import Sequence
from contextlib import redirect_stdout, suppress
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import onnxruntime

from autolights.core import FloatArray, ModelInfo
from autolights.core.errors import DataError, UsageError
from autolights.core.model_guard import read_model
from autolights.infer.ports import Port, check_ports

CPU = "CPUExecutionProvider"
CUDA = "CUDAExecutionProvider"
# Where the memory of a provider's own tensors is; all others work on the host's.
_DEVICES = {CUDA: "cuda", "TensorrtExecutionProvider": "cuda"}
# Convolutions are chosen by cuDNN's advice: to try them all makes the first run of each shape slow.
_CUDA_OPTIONS = {"cudnn_conv_algo_search": "HEURISTIC"}
_PACKAGES = {
    CUDA: "onnxruntime-gpu, CUDA and cuDNN",
    "TensorrtExecutionProvider": "onnxruntime-gpu, CUDA and TensorRT",
    "OpenVINOExecutionProvider": "onnxruntime-openvino; or choose the backend 'openvino'",
}


class Session(Protocol):
    """A model that can be run, by whatever library."""

    @property
    def on_gpu(self) -> bool:
        """Whether it computes elsewhere, so that several images in one call pay."""
        ...

    def run(self, blob: FloatArray) -> tuple[FloatArray, ...]:
        """Run the network on (B, 3, H, W) RGB in [0, 1].

        Returns:
            Of a ``raw`` head one array, (B, N, 5 + C); of an ``end2end`` head boxes, scores and class_probs. They may
            be views of memory that the next call overwrites.
        """
        ...


def can_limit_spinning() -> bool:
    """Whether this ONNX Runtime lets threads look for work for a limited time."""
    return tuple(int(part) for part in onnxruntime.__version__.split(".")[:2]) >= (1, 26)


class OnnxSession:
    """Run a model in ONNX Runtime.

    Args:
        model_path: The ONNX file.
        info: What the model must look like.
        sha256: What the file must hash to; empty: anything.
        providers: ONNX Runtime's execution providers in order of preference; None: the CPU.
        threads: Within an operator; None leaves the choice to ONNX Runtime.
        spin_us: How long an idle thread looks for work before it sleeps, microseconds.
        io_binding: Keep inputs and outputs in memory of the provider's device from call to call; None: on a GPU.
        one_launch: With I/O binding let CUDA record the work of a model of fixed size, and launch it as one: to launch
            some hundred kernels one by one takes longer than a small network's arithmetic. ONNX Runtime records for
            each thread, and no other thread may use the GPU meanwhile.

    Raises:
        UsageError: If the file is missing or a provider cannot be had.
        BundleError: If the file hashes to something else.
        DataError: If the file is no model, or input or output differ from `info`.
    """

    def __init__(
        self,
        model_path: Path,
        info: ModelInfo,
        *,
        sha256: str = "",
        providers: Sequence[str] | None = None,
        threads: int | None = None,
        spin_us: int = 0,
        io_binding: bool | None = None,
        one_launch: bool = True,
    ) -> None:
        if not model_path.is_file():
            raise UsageError(f"{model_path}: no such model; make one with `autolights export`")
        wanted = list(providers or [CPU])
        available = onnxruntime.get_available_providers()
        for name in wanted:
            if name not in available:
                raise UsageError(
                    f"ONNX Runtime has no provider '{name}' here; there are: {', '.join(available)}{_advice(name)}"
                )
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3  # errors only: its warnings are about its own optimiser
        # By default threads look for work for milliseconds, and lose to any busy neighbour: nano at 960 x 608 on 2
        # cores took 62 ms instead of 25 beside one other process, and 18 instead of 20 alone.
        options.add_session_config_entry("session.intra_op.allow_spinning", "1" if spin_us else "0")
        if spin_us:
            if not can_limit_spinning():
                raise UsageError(f"spin_us needs ONNX Runtime 1.26 or newer, this is {onnxruntime.__version__}")
            options.add_session_config_entry("session.intra_op.spin_duration_us", str(spin_us))
        if threads is not None:
            options.intra_op_num_threads = threads
        if any(name in _DEVICES for name in wanted):
            _preload_cuda()
        data = read_model(model_path, sha256)
        self._device = _DEVICES.get(wanted[0], "cpu")
        bound = self.on_gpu if io_binding is None else io_binding
        fixed = not (info.dynamic_batch or info.dynamic_size)
        record = one_launch and bound and fixed and wanted[0] == CUDA
        start = partial(_start, data, options, wanted, info)
        self._unrecorded = partial(start, record=False) if record else None
        try:
            self._session = start(record=record)
        except Exception as error:  # ONNX Runtime has a class of its own for each kind of damage
            raise DataError(f"{model_path}: ONNX Runtime cannot read it ({_first_line(error)})") from error
        # One that cannot be started (a library or driver is missing) is silently left out.
        absent = [name for name in wanted if name not in self._session.get_providers()]
        if absent:
            raise UsageError(f"ONNX Runtime's provider '{absent[0]}' does not start here{_advice(absent[0])}")
        self._input_name, self._output_names = check_ports(
            [_port(node) for node in self._session.get_inputs()],
            [_port(node) for node in self._session.get_outputs()],
            model_path,
            info,
        )
        self._binding = self._bound() if bound else None

    @property
    def on_gpu(self) -> bool:
        """Whether the preferred provider computes on a GPU."""
        return self._device != "cpu"

    def run(self, blob: FloatArray) -> tuple[FloatArray, ...]:
        """See `Session`; with I/O binding the next call overwrites what is returned."""
        if self._binding is None:
            return tuple(self._session.run(self._output_names, {self._input_name: blob}))
        try:
            return self._binding.run(blob)
        except Exception:
            if self._unrecorded is None:
                raise
        # The first run records, and something in it cannot be recorded.
        self._session, self._unrecorded = self._unrecorded(), None
        self._binding = self._bound()
        return self._binding.run(blob)

    def _bound(self) -> "_Binding":
        return _Binding(self._session, self._input_name, self._output_names, self._device)


class _Binding:
    """Tensors on the device that stay from call to call, as long as the input keeps its shape."""

    def __init__(
        self, session: onnxruntime.InferenceSession, input_name: str, output_names: Sequence[str], device: str
    ) -> None:
        self._session = session
        self._input_name = input_name
        self._output_names = output_names
        self._ports = {node.name: _port(node) for node in (*session.get_inputs(), *session.get_outputs())}
        self._device = device
        self._binding = session.io_binding()
        self._input: Any = None

    def run(self, blob: FloatArray) -> tuple[FloatArray, ...]:
        if self._input is None or tuple(self._input.shape()) != blob.shape:
            self._bind(blob)
        self._input.update_inplace(np.ascontiguousarray(blob))
        self._session.run_with_iobinding(self._binding)
        return tuple(value.numpy() for value in self._binding.get_outputs())

    def _bind(self, blob: FloatArray) -> None:
        wanted = self._ports[self._input_name].shape
        if None not in wanted and blob.shape != wanted:  # a recorded run would not look at it
            raise ValueError(f"the model takes {list(wanted)}, got {list(blob.shape)}")
        self._input = onnxruntime.OrtValue.ortvalue_from_shape_and_type(list(blob.shape), blob.dtype, self._device, 0)
        self._binding.clear_binding_inputs()
        self._binding.bind_ortvalue_input(self._input_name, self._input)
        self._binding.clear_binding_outputs()
        for name in self._output_names:
            port = self._ports[name]
            if None in port.shape:
                # The first run makes it on the device; the binding holds it, and later runs write into it.
                self._binding.bind_output(name, self._device)
            else:  # a recorded run writes where it wrote when it was recorded
                value = onnxruntime.OrtValue.ortvalue_from_shape_and_type(
                    list(port.shape), np.dtype(port.dtype), self._device, 0
                )
                self._binding.bind_ortvalue_output(name, value)


def _start(
    model: bytes, options: onnxruntime.SessionOptions, providers: Sequence[str], info: ModelInfo, *, record: bool
) -> onnxruntime.InferenceSession:
    """Load a model; `record` lets CUDA record its first run, if it has a kernel for each node."""
    cuda = dict(_CUDA_OPTIONS)
    if info.precision != "fp16":
        # Else CUDA rounds what convolutions multiply to ten bits (TF32). The option forbids all tensor cores, so a
        # model in halves, which is meant for them, does not get it.
        cuda["use_tf32"] = "0"
    if record:
        recorded = {**cuda, "enable_cuda_graph": "1"}
        with suppress(Exception):  # what is wrong with the model itself is told below
            return onnxruntime.InferenceSession(
                model,
                options,
                providers=[(name, recorded if name == CUDA else {}) for name in providers],
                enable_fallback=0,
            )
    return onnxruntime.InferenceSession(
        model, options, providers=[(name, cuda if name == CUDA else {}) for name in providers]
    )


def _preload_cuda() -> None:
    """Load CUDA and cuDNN from where pip has put them; the system's loader does not look there."""
    if hasattr(onnxruntime, "preload_dlls"):  # from 1.21 on
        with redirect_stdout(io.StringIO()):  # it prints what it does not find, which may be in the system's folders
            onnxruntime.preload_dlls()


def _port(node: Any) -> Port:
    shape = tuple(length if isinstance(length, int) else None for length in node.shape)
    return Port(node.name, shape, {"tensor(float)": "float32", "tensor(float16)": "float16"}.get(node.type, node.type))


def _advice(provider: str) -> str:
    return f"; it needs {_PACKAGES[provider]}" if provider in _PACKAGES else ""


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]
