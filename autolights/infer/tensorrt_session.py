"""A TensorRT engine on the GPU that it was built for."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from autolights.core import FloatArray, ModelInfo
from autolights.core.errors import DataError, UsageError
from autolights.core.model_guard import read_model
from autolights.infer.engine_info import EngineInfo, load_engine_info
from autolights.infer.gpu import Gpu
from autolights.infer.ports import Port, check_ports


class TensorRtSession:
    """Run an engine; the same interface as `OnnxSession`.

    Only engines are loaded that `autolights export --tensorrt` built of this very model, on this kind of GPU, with this
    version of TensorRT; all others are refused with the command that builds one. Load no engine whose origin you do
    not know: TensorRT trusts what it reads.

    Args:
        model_path: The ONNX file; the engine, ``model.engine``, and its description lie beside it.
        info: What the model must look like.
        sha256: What the ONNX file must hash to; empty: anything.

    Raises:
        UsageError: If library, GPU or engine is missing, or the engine is another model's, GPU's or version's.
        BundleError: If the ONNX file hashes to something else.
        DataError: If the engine or its description is damaged, or inputs and outputs differ from `info`.
    """

    on_gpu = True

    def __init__(self, model_path: Path, info: ModelInfo, *, sha256: str = "") -> None:
        trt = import_tensorrt()
        self._gpu = Gpu()
        engine_path = model_path.with_suffix(".engine")
        rebuild = f"build one with: autolights export {model_path} --tensorrt --force"
        if not engine_path.is_file():
            raise UsageError(f"{engine_path}: no engine; {rebuild}")
        described = load_engine_info(engine_path)
        _check_machine(engine_path, described, trt.__version__, self._gpu, rebuild)
        if described.model_sha256 != _sha256(read_model(model_path, sha256)):
            raise UsageError(f"{engine_path}: built of another model than {model_path}; {rebuild}")
        engine = engine_path.read_bytes()
        if described.engine_sha256 != _sha256(engine):
            raise DataError(f"{engine_path}: its SHA-256 differs from its description: altered or damaged; {rebuild}")
        runtime = trt.Runtime(trt.Logger(trt.Logger.ERROR))
        trt.init_libnvinfer_plugins(None, "")
        if described.dla_core is not None:
            runtime.DLA_core = described.dla_core
        self._engine = runtime.deserialize_cuda_engine(engine)
        if self._engine is None:
            raise DataError(f"{engine_path}: TensorRT {trt.__version__} cannot read it; {rebuild}")
        self._context = self._engine.create_execution_context()
        names = [self._engine.get_tensor_name(i) for i in range(self._engine.num_io_tensors)]
        inputs = [name for name in names if self._engine.get_tensor_mode(name) == trt.TensorIOMode.INPUT]
        self._dtypes = {name: np.dtype(trt.nptype(self._engine.get_tensor_dtype(name))) for name in names}
        outputs = [name for name in names if name not in inputs]
        self._input_name, self._output_names = check_ports(
            [self._port(name) for name in inputs], [self._port(name) for name in outputs], engine_path, info
        )
        self._all_outputs = outputs
        self._largest = described.shapes[-1]
        self._shape: tuple[int, ...] = ()
        self._host: dict[str, np.ndarray] = {}
        self._device: dict[str, int] = {}

    def run(self, blob: FloatArray) -> tuple[FloatArray, ...]:
        """See `Session`; the next call overwrites what is returned."""
        if blob.shape != self._shape:
            self._bind(blob.shape)
        self._gpu.upload(self._device[self._input_name], np.ascontiguousarray(blob, self._dtypes[self._input_name]))
        if not self._context.execute_async_v3(self._gpu.stream):
            raise DataError("TensorRT could not run the engine")
        for name in self._output_names:
            self._gpu.download(self._host[name], self._device[name])
        self._gpu.wait()
        return tuple(self._host[name] for name in self._output_names)

    def _bind(self, shape: tuple[int, ...]) -> None:
        """Memory of host and device for inputs of one shape."""
        if not self._context.set_input_shape(self._input_name, shape):
            raise UsageError(f"the engine takes inputs of at most {list(self._largest)}, got {list(shape)}")
        self.close()
        for name in (self._input_name, *self._all_outputs):
            sizes = tuple(self._context.get_tensor_shape(name))
            array = np.empty(sizes, self._dtypes[name])
            self._device[name] = self._gpu.allocate(array.nbytes)
            self._context.set_tensor_address(name, self._device[name])
            if name != self._input_name:
                self._host[name] = array
        self._shape = shape

    def close(self) -> None:
        """Give the device's memory back; a later `run` takes new."""
        for address in self._device.values():
            self._gpu.free(address)
        self._device, self._host, self._shape = {}, {}, ()

    def _port(self, name: str) -> Port:
        shape = tuple(None if length == -1 else int(length) for length in self._engine.get_tensor_shape(name))
        return Port(name, shape, self._dtypes[name].name)


def import_tensorrt() -> Any:
    """The library, 10 or newer.

    Raises:
        UsageError: If it is missing or older.
    """
    try:
        import tensorrt
    except ImportError as error:
        raise UsageError(
            "TensorRT's Python package 'tensorrt' is not installed; it comes with JetPack, or: pip install tensorrt"
        ) from error
    if int(tensorrt.__version__.partition(".")[0]) < 10:
        raise UsageError(f"TensorRT 10 or newer is needed, this is {tensorrt.__version__}")
    return tensorrt


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _check_machine(engine_path: Path, described: EngineInfo, version: str, gpu: Gpu, rebuild: str) -> None:
    here = gpu.info
    if described.tensorrt != version:
        raise UsageError(f"{engine_path}: built by TensorRT {described.tensorrt}, this is {version}; {rebuild}")
    if (described.gpu, described.compute_capability) != (here.name, here.compute_capability):
        raise UsageError(
            f"{engine_path}: built for {described.gpu} ({described.compute_capability}), this is {here.name} "
            f"({here.compute_capability}); {rebuild}"
        )
