"""Against a stand-in for library and GPU, where there is none; what it offers, the real ones offer too (last test)."""

import base64
import ctypes
import importlib.util
import json
import subprocess
import sys
import types
from enum import IntEnum

import numpy as np
import onnx
import onnxruntime
import pytest

from autolights.cli.delivery import export
from autolights.core.errors import DataError, UsageError
from autolights.infer import Detector, Execution, OnnxSession
from autolights.infer.engine_info import EngineInfo, engine_info_path, load_engine_info
from autolights.infer.tensorrt_session import TensorRtSession
from autolights.train.deliver.export import export_onnx
from autolights.train.deliver.tensorrt_engine import build_engine

SIZE_WH = (128, 96)


class CudaError(IntEnum):
    cudaSuccess = 0  # noqa: N815
    cudaErrorNoDevice = 100  # noqa: N815


class CudaRuntime(types.ModuleType):
    """``cuda.bindings.runtime`` with memory of its own."""

    cudaError_t = CudaError  # noqa: N815
    cudaMemcpyKind = types.SimpleNamespace(cudaMemcpyHostToDevice=1, cudaMemcpyDeviceToHost=2)  # noqa: N815

    def __init__(self, name="NVIDIA Orin", compute_capability=(8, 7)):
        super().__init__("cuda.bindings.runtime")
        self.name, self.compute_capability = name, compute_capability
        self.memory = {}
        self.is_there = True

    def cudaGetDevice(self):  # noqa: N802
        return (CudaError.cudaSuccess, 0) if self.is_there else (CudaError.cudaErrorNoDevice, None)

    def cudaGetErrorString(self, status):  # noqa: N802
        return CudaError.cudaSuccess, b"no CUDA-capable device is detected"

    def cudaGetDeviceProperties(self, device):  # noqa: N802
        major, minor = self.compute_capability
        return CudaError.cudaSuccess, types.SimpleNamespace(name=self.name.encode(), major=major, minor=minor)

    def cudaDriverGetVersion(self):  # noqa: N802
        return CudaError.cudaSuccess, 12060

    def cudaStreamCreate(self):  # noqa: N802
        return CudaError.cudaSuccess, 7

    def cudaStreamSynchronize(self, stream):  # noqa: N802
        assert stream == 7
        return (CudaError.cudaSuccess,)

    def cudaMalloc(self, count):  # noqa: N802
        address = 4096 * (len(self.memory) + 1)
        self.memory[address] = bytearray(count)
        return CudaError.cudaSuccess, address

    def cudaFree(self, address):  # noqa: N802
        self.memory[address] = None  # a later use fails
        return (CudaError.cudaSuccess,)

    def cudaMemcpyAsync(self, to, source, count, kind, stream):  # noqa: N802
        if kind == 1:
            assert len(self.memory[to]) == count
            self.memory[to][:] = ctypes.string_at(source, count)
        else:
            ctypes.memmove(to, bytes(self.memory[source]), count)
        return (CudaError.cudaSuccess,)


class Plan(bytes):
    @property
    def nbytes(self):
        return len(self)


def make_tensorrt(version, cuda, dla_cores=2):
    """The module ``tensorrt`` as far as it is used; a plan holds the ONNX file, and ONNX Runtime computes."""
    trt = types.ModuleType("tensorrt")
    trt.__version__ = version
    major = int(version.partition(".")[0])

    class ILogger:
        ERROR, INTERNAL_ERROR = "error", "internal error"

    class Logger(ILogger):
        def __init__(self, severity):
            pass

    class Network:
        def __init__(self, flags):
            self.flags, self.model = flags, b""

        def get_input(self, index):
            return types.SimpleNamespace(name="images")

    class Config:
        def __init__(self):
            self.flags, self.profiles = set(), []
            self.default_device_type, self.DLA_core, self.profiling_verbosity = "GPU", -1, "LAYER_NAMES_ONLY"

        def add_optimization_profile(self, profile):
            self.profiles.append(profile)

        def set_flag(self, flag):
            self.flags.add(flag)

    class Profile:
        def set_shape(self, name, smallest, usual, largest):
            assert all(isinstance(shape, tuple) for shape in (smallest, usual, largest))
            self.shapes = [smallest, usual, largest]

    class Builder:
        num_DLA_cores = dla_cores  # noqa: N815

        def __init__(self, logger):
            self.logger = logger

        def create_network(self, flags):
            return Network(flags)

        def create_builder_config(self):
            return Config()

        def create_optimization_profile(self):
            return Profile()

        def build_serialized_network(self, network, config):
            dims = onnx.load_from_string(network.model).graph.input[0].type.tensor_type.shape.dim
            if any(dim.dim_param for dim in dims) and not config.profiles:
                self.logger.log("error", "Network has dynamic or shape inputs, but no optimization profile")
                return None
            facts = {
                "onnx": base64.b64encode(network.model).decode(),
                "strongly_typed": bool(network.flags) or major >= 11,
                "flags": sorted(config.flags),
                "dla": config.DLA_core if config.default_device_type == "DLA" else None,
                "shapes": config.profiles[0].shapes if config.profiles else None,
                "detailed": config.profiling_verbosity == "DETAILED",
            }
            return Plan(json.dumps(facts).encode())

    class OnnxParser:
        def __init__(self, network, logger):
            self.network = network

        def parse(self, model):
            self.odd = [node for node in onnx.load_from_string(model).graph.node if node.op_type == "Det"]
            self.network.model = model
            return not self.odd

        def get_error(self, index):
            node = self.odd[index]
            return types.SimpleNamespace(
                node_name=lambda: node.name, node_operator=lambda: node.op_type, desc=lambda: "no such importer"
            )

    class Runtime:
        DLA_core = -1

        def __init__(self, logger):
            pass

        def deserialize_cuda_engine(self, plan):
            try:
                return ICudaEngine(json.loads(bytes(plan)), self.DLA_core)
            except ValueError:
                return None

    class ICudaEngine:
        def __init__(self, facts, dla_core):
            assert facts["dla"] in (None, dla_core)
            self.facts = facts
            self.session = onnxruntime.InferenceSession(
                base64.b64decode(facts["onnx"]), providers=["CPUExecutionProvider"]
            )
            self.ports = [*self.session.get_inputs(), *self.session.get_outputs()]
            self.num_io_tensors = len(self.ports)

        def get_tensor_name(self, index):
            return self.ports[index].name

        def _port(self, name):
            return next(port for port in self.ports if port.name == name)

        def get_tensor_mode(self, name):
            return trt.TensorIOMode.INPUT if name == "images" else trt.TensorIOMode.OUTPUT

        def get_tensor_shape(self, name):
            return tuple(-1 if isinstance(length, str) else length for length in self._port(name).shape)

        def get_tensor_dtype(self, name):
            return self._port(name).type

        def create_execution_context(self):
            return IExecutionContext(self)

        def create_engine_inspector(self):
            return EngineInspector(self)

    class IExecutionContext:
        def __init__(self, engine):
            self.engine, self.addresses, self.input_shape = engine, {}, None

        def set_input_shape(self, name, shape):
            shapes = self.engine.facts["shapes"] or [self.engine.get_tensor_shape("images")] * 3
            low, _, high = shapes
            fits = all(a <= b <= c for a, b, c in zip(low, shape, high, strict=True))
            self.input_shape = tuple(shape) if fits else self.input_shape
            return fits

        def get_tensor_shape(self, name):
            if name == "images":
                return self.input_shape
            zeros = np.zeros(self.input_shape, trt.nptype(self.engine.get_tensor_dtype("images")))
            return self.engine.session.run([name], {"images": zeros})[0].shape

        def set_tensor_address(self, name, address):
            self.addresses[name] = address
            return True

        def execute_async_v3(self, stream):
            assert stream == 7
            dtype = trt.nptype(self.engine.get_tensor_dtype("images"))
            images = np.frombuffer(bytes(cuda.memory[self.addresses["images"]]), dtype).reshape(self.input_shape)
            names = [port.name for port in self.engine.session.get_outputs()]
            for name, value in zip(names, self.engine.session.run(names, {"images": images}), strict=True):
                cuda.memory[self.addresses[name]][:] = value.tobytes()
            return True

    class EngineInspector:
        execution_context = None

        def __init__(self, engine):
            self.engine = engine

        def get_engine_information(self, format_):
            assert format_ == "JSON"
            if not self.engine.facts["detailed"]:
                return json.dumps({"Layers": ["conv", "head"]})
            if major == 10:
                outputs = ["Channel major FP16 format where channel % 8 == 0", "Row major linear FP32", "Int8 format"]
                layers = [{"Name": text, "Outputs": [{"Name": "y", "Format/Datatype": text}]} for text in outputs]
            else:
                outputs = [("Half", "kHWC8"), ("Float", "kLINEAR"), ("Int8", "kCHW32")]
                layers = [{"Outputs": [{"Format": layout, "DataType": kind}]} for kind, layout in outputs]
            known = self.execution_context is not None and self.execution_context.input_shape is not None
            return json.dumps({"Layers": [*layers, {"Name": "signal"}] if known else []})

    flags = {"GPU_FALLBACK": "GPU_FALLBACK", **({"FP16": "FP16"} if major == 10 else {})}
    for kind in (ILogger, Logger, Builder, OnnxParser, Runtime, ICudaEngine, IExecutionContext, EngineInspector):
        setattr(trt, kind.__name__, kind)
    trt.IBuilderConfig, trt.INetworkDefinition, trt.IOptimizationProfile = Config, Network, Profile
    trt.BuilderFlag = types.SimpleNamespace(**flags)
    trt.DeviceType = types.SimpleNamespace(DLA="DLA", GPU="GPU")
    trt.NetworkDefinitionCreationFlag = types.SimpleNamespace(STRONGLY_TYPED=1)
    trt.ProfilingVerbosity = types.SimpleNamespace(DETAILED="DETAILED")
    trt.LayerInformationFormat = types.SimpleNamespace(JSON="JSON")
    trt.TensorIOMode = types.SimpleNamespace(INPUT="input", OUTPUT="output")
    trt.init_libnvinfer_plugins = lambda logger, namespace: True
    trt.nptype = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(int32)": np.int32}.__getitem__
    return trt


@pytest.fixture
def machine(monkeypatch):
    """Put library and GPU in place; gives the CUDA of the machine."""

    def make(version="10.3.0", gpu="NVIDIA Orin", compute_capability=(8, 7), dla_cores=2):
        cuda = CudaRuntime(gpu, compute_capability)
        bindings = types.ModuleType("cuda.bindings")
        bindings.runtime = cuda
        monkeypatch.setitem(sys.modules, "cuda", types.ModuleType("cuda"))
        monkeypatch.setitem(sys.modules, "cuda.bindings", bindings)
        monkeypatch.setitem(sys.modules, "cuda.bindings.runtime", cuda)
        monkeypatch.setitem(sys.modules, "tensorrt", make_tensorrt(version, cuda, dla_cores))
        return cuda

    return make


@pytest.fixture
def exported(model, tmp_path):
    def make(**options):
        return export_onnx(model, tmp_path / "model.onnx", size_wh=SIZE_WH, max_detections=20, **options)

    return make


def facts_of(report):
    return json.loads(report.path.with_suffix(".engine").read_bytes())


def blob(batch=1, size_wh=SIZE_WH):
    return np.random.default_rng(batch).random((batch, 3, size_wh[1], size_wh[0]), dtype=np.float32)


@pytest.mark.parametrize("version", ["10.3.0", "11.4.1.5"])
def test_engine_is_built_described_and_run(exported, machine, version):
    cuda = machine(version)
    report = exported(head="end2end", dynamic_batch=True, dynamic_size=True)

    described = build_engine(report.path, report.info)

    engine_path = report.path.with_suffix(".engine")
    assert load_engine_info(engine_path) == described
    assert (described.tensorrt, described.gpu, described.compute_capability) == (version, "NVIDIA Orin", "8.7")
    assert described.driver.startswith("CUDA 12.6")
    assert described.layer_types == {"fp16": 1, "fp32": 1, "int8": 1, "unknown": 1}
    assert described.shapes == ((1, 3, 96, 96), (1, 3, 96, 128), (8, 3, 192, 256))
    assert facts_of(report)["strongly_typed"]
    assert facts_of(report)["flags"] == []
    session, wanted = TensorRtSession(report.path, report.info), OnnxSession(report.path, report.info)
    for images in (blob(), blob(3), blob(3), blob(2, (96, 128))):
        for got, right in zip(session.run(images), wanted.run(images), strict=True):
            assert np.array_equal(got, right)
    session.close()
    assert all(memory is None for memory in cuda.memory.values())
    assert session.on_gpu


def test_the_verb_builds_an_engine_of_an_exported_model_and_the_detector_runs_it(exported, machine, photo, capsys):
    machine()
    report = exported()

    export(report.path, tensorrt=True)

    described = load_engine_info(report.path.with_suffix(".engine"))
    printed = capsys.readouterr().out
    assert json.loads(printed.partition("model.engine: ")[2]) == json.loads(described.model_dump_json())
    found = Detector(report.path, report.info, Execution(backend="tensorrt"))(photo)
    wanted = Detector(report.path, report.info)(photo)
    assert len(found) > 5
    assert np.array_equal(found.boxes_xyxy, wanted.boxes_xyxy)
    with pytest.raises(UsageError, match=r"model\.engine: exists already"):
        export(report.path, tensorrt=True)
    export(report.path, tensorrt=True, force=True)


def test_halves_go_in_and_come_out(exported, machine, base, tmp_path):
    machine()
    report = export_onnx(base, tmp_path / "half.onnx", size_wh=SIZE_WH, precision="fp16", half_io=True)
    build_engine(report.path, report.info)

    (got,) = TensorRtSession(report.path, report.info).run(blob().astype(np.float16))

    assert got.dtype == np.float16
    assert np.array_equal(got, OnnxSession(report.path, report.info).run(blob().astype(np.float16))[0])


def test_an_input_beyond_the_engine_is_refused(exported, machine):
    machine()
    report = exported(dynamic_batch=True)
    build_engine(report.path, report.info)

    with pytest.raises(UsageError, match=r"inputs of at most \[8, 3, 96, 128\], got \[9, 3, 96, 128\]"):
        TensorRtSession(report.path, report.info).run(blob(9))


@pytest.mark.parametrize(
    ("elsewhere", "text"),
    [
        pytest.param({"version": "10.4.0"}, r"built by TensorRT 10\.3\.0, this is 10\.4\.0", id="version"),
        pytest.param(
            {"gpu": "NVIDIA L4", "compute_capability": (8, 9)},
            r"built for NVIDIA Orin \(8\.7\), this is NVIDIA L4 \(8\.9\)",
            id="gpu",
        ),
    ],
)
def test_an_engine_of_another_machine_is_refused_with_the_command(exported, machine, elsewhere, text):
    machine()
    report = exported()
    build_engine(report.path, report.info)
    machine(**elsewhere)

    command = rf"; build one with: autolights export {report.path} --tensorrt --force"
    with pytest.raises(UsageError, match=text + command):
        TensorRtSession(report.path, report.info)


def test_engine_and_model_must_be_those_that_belong_together(exported, machine, tmp_path):
    machine()
    report = exported()
    with pytest.raises(UsageError, match=r"model\.engine: no engine; build one with: autolights export"):
        TensorRtSession(report.path, report.info)
    build_engine(report.path, report.info)
    engine_path = report.path.with_suffix(".engine")
    whole = engine_path.read_bytes()

    engine_path.write_bytes(whole + b" ")
    with pytest.raises(DataError, match="its SHA-256 differs from its description: altered or damaged"):
        TensorRtSession(report.path, report.info)
    engine_path.write_bytes(whole)
    with pytest.raises(DataError, match=r"output must be \[1, N, 9\] for 4 classes"):
        TensorRtSession(report.path, report.info.model_copy(update={"classes": ("a", "b", "c", "d")}))
    report.path.write_bytes(report.path.read_bytes() + b" ")
    with pytest.raises(UsageError, match="built of another model than"):
        TensorRtSession(report.path, report.info)
    engine_info_path(engine_path).unlink()
    with pytest.raises(DataError, match=r"model\.engine\.json: cannot be read .*`autolights export --tensorrt` writes"):
        TensorRtSession(report.path, report.info)


def test_a_refused_model_leaves_nothing_behind(machine, model, tmp_path, exported):
    machine()
    report = exported()
    proto = onnx.load(report.path)
    proto.graph.node.insert(0, onnx.helper.make_node("Det", ["images"], ["unused"], name="odd"))
    onnx.save(proto, report.path)

    with pytest.raises(DataError, match=r"TensorRT 10\.3\.0 refuses it: node 'odd' \(Det\): no such importer"):
        build_engine(report.path, report.info)

    assert not list(tmp_path.glob("*.engine*"))


@pytest.mark.parametrize("version", ["10.3.0", "11.4.1"])
def test_deep_learning_accelerator(base, tmp_path, machine, version):
    machine(version)
    report = export_onnx(base, tmp_path / "model.onnx", size_wh=SIZE_WH, precision="fp16")

    described = build_engine(report.path, report.info, dla_core=1)

    assert described.dla_core == 1
    facts = facts_of(report)
    assert facts["dla"] == 1
    # TensorRT 10 is told the accelerator's precision by a flag, 11 reads it in the graph.
    assert facts["flags"] == (["FP16", "GPU_FALLBACK"] if version == "10.3.0" else ["GPU_FALLBACK"])
    assert facts["strongly_typed"] == (version != "10.3.0")
    (got,) = TensorRtSession(report.path, report.info).run(blob())
    assert got.shape[0] == 1


@pytest.mark.parametrize(
    ("where", "precision", "core", "text"),
    [
        pytest.param({"version": "11.2.0"}, "fp16", 0, r"TensorRT 11\.2\.0 does not serve .*use TensorRT 10", id="11"),
        pytest.param({}, "fp32", 0, "needs a model in fp16, this one is fp32", id="fp32"),
        pytest.param({}, "int8", 0, "needs a model in fp16, this one is int8", id="int8"),
        pytest.param({"dla_cores": 0}, "fp16", 0, "no DLA core 0: this machine has none", id="no-core"),
        pytest.param({}, "fp16", 2, "no DLA core 2: this machine has 2", id="third-core"),
    ],
)
def test_where_there_is_no_accelerator_it_says_so(exported, machine, where, precision, core, text):
    machine(**where)
    report = exported()

    with pytest.raises(UsageError, match=text):
        build_engine(report.path, report.info.model_copy(update={"precision": precision}), dla_core=core)


def test_accelerator_takes_one_shape(exported, machine):
    machine()
    report = exported()

    info = report.info.model_copy(update={"precision": "fp16", "dynamic_batch": True})
    with pytest.raises(UsageError, match="takes one shape; export without --dynamic"):
        build_engine(report.path, info, dla_core=0)


def test_without_library_or_gpu_it_says_what_is_missing(exported, machine, monkeypatch):
    report = exported()
    monkeypatch.setitem(sys.modules, "tensorrt", None)
    with pytest.raises(UsageError, match="TensorRT's Python package 'tensorrt' is not installed"):
        build_engine(report.path, report.info)

    machine().is_there = False
    with pytest.raises(UsageError, match="cudaGetDevice: no CUDA-capable device is detected"):
        build_engine(report.path, report.info)

    machine(version="8.6.1")
    with pytest.raises(UsageError, match=r"TensorRT 10 or newer is needed, this is 8\.6\.1"):
        TensorRtSession(report.path, report.info)

    monkeypatch.setitem(sys.modules, "cuda.bindings", None)
    sys.modules["tensorrt"].__version__ = "10.3.0"
    with pytest.raises(UsageError, match="pip install cuda-bindings"):
        build_engine(report.path, report.info)


def test_building_needs_no_training_stack():
    code = """
import sys
sys.modules.update(dict.fromkeys(("torch", "torchvision", "onnx", "albumentations")))
import autolights.train.deliver.tensorrt_engine, autolights.infer.tensorrt_session, autolights.cli.delivery
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_description_goes_round(tmp_path):
    described = EngineInfo(
        model_sha256="0" * 64,
        engine_sha256="1" * 64,
        tensorrt="10.3.0",
        gpu="NVIDIA Orin",
        compute_capability="8.7",
        driver="CUDA 12.6",
        layer_types={"fp16": 3},
        shapes=((1, 3, 96, 128),) * 3,
    )
    path = engine_info_path(tmp_path / "model.engine")
    path.write_text(json.dumps(described.model_dump(mode="json")))

    assert path.name == "model.engine.json"
    assert load_engine_info(tmp_path / "model.engine") == described


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.skipif(not importlib.util.find_spec(name), reason=f"{name} is missing"))
        for name in ("tensorrt_rtx", "cuda")
    ],
)
def test_stand_in_offers_what_the_real_thing_offers(name):
    if name == "cuda":
        runtime = pytest.importorskip("cuda.bindings.runtime")
        offered = {key for key in vars(CudaRuntime) if key.startswith("cuda")}
        assert offered <= set(dir(runtime))
        assert {"cudaMemcpyHostToDevice", "cudaMemcpyDeviceToHost"} <= set(dir(runtime.cudaMemcpyKind))
        return
    real, stand_in = importlib.import_module("tensorrt_rtx"), make_tensorrt("11.4.1", None)
    for kind in (value for value in vars(stand_in).values() if isinstance(value, type)):
        name = next(key for key, value in vars(stand_in).items() if value is kind)
        methods = {key for key in vars(kind) if not key.startswith("_")}
        assert methods <= set(dir(getattr(real, name))), name
    for name, values in vars(stand_in).items():
        if isinstance(values, types.SimpleNamespace):
            assert set(vars(values)) <= set(dir(getattr(real, name))), name
    assert {"init_libnvinfer_plugins", "nptype"} <= set(dir(real))
    assert {"profiling_verbosity", "default_device_type", "DLA_core"} <= set(dir(real.IBuilderConfig))
    assert {"num_io_tensors"} <= set(dir(real.ICudaEngine))
