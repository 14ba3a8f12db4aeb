"""Build a TensorRT engine on the machine that will run it; neither torch nor onnx is needed for that.

The code follows the Python API of TensorRT 10 and 11. It has been run against the sibling for RTX cards as far as that
goes without a GPU, and against a stand-in beyond; on a GPU it has not.
"""

import json
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from autolights.core import ModelInfo
from autolights.core.atomic import new_file, sha256
from autolights.core.errors import DataError, UsageError
from autolights.infer.engine_info import EngineInfo, engine_info_path
from autolights.infer.gpu import Gpu
from autolights.infer.tensorrt_session import import_tensorrt
from autolights.train.deliver.tensorrt_plan import RefusedModelError, build_plan
from autolights.train.deliver.tensorrt_shapes import input_shapes, is_dynamic

_TYPE_NAMES = {
    "int8": r"int8",
    "fp8": r"fp8|float8",
    "fp16": r"fp16|half|float16",
    "bf16": r"bf16|bfloat16",
    "fp32": r"fp32|float32|float\b",
    "int64": r"int64",
    "int32": r"int32",
    "bool": r"bool",
}


def build_engine(model_path: Path, info: ModelInfo, *, dla_core: int | None = None) -> EngineInfo:
    """Write ``model.engine`` and ``model.engine.json`` beside an exported model.

    Args:
        model_path: The ONNX file.
        info: Its description.
        dla_core: Run what can be on this core of the deep learning accelerator (Jetson Orin), the rest on the GPU.

    Returns:
        The engine's description.

    Raises:
        UsageError: If library or GPU is missing, or the accelerator cannot be used.
        DataError: If TensorRT refuses the model; the text names the node.
    """
    trt = import_tensorrt()
    gpu = Gpu()
    weakly_typed = False
    if dla_core is not None:
        _check_dla(trt, info)
        weakly_typed = _major(trt) == 10  # where the accelerator wants to be told its precision by a flag

    def configure(builder: Any, config: Any) -> None:
        if dla_core is not None:
            cores = getattr(builder, "num_DLA_cores", 0)
            if dla_core >= cores:
                raise UsageError(
                    f"there is no DLA core {dla_core}: this machine has {cores or 'none'} for TensorRT "
                    f"{trt.__version__}; leave --dla away"
                )
            config.default_device_type = trt.DeviceType.DLA
            config.DLA_core = dla_core
            config.set_flag(trt.BuilderFlag.GPU_FALLBACK)
            if weakly_typed:
                config.set_flag(trt.BuilderFlag.FP16)

    shapes = input_shapes(info)
    try:
        plan = build_plan(
            trt,
            model_path.read_bytes(),
            shapes if is_dynamic(info) else None,
            configure,
            strongly_typed=not weakly_typed,
        )
    except RefusedModelError as error:
        raise DataError(f"{model_path}: TensorRT {trt.__version__} refuses it: {error}") from error
    runtime = trt.Runtime(trt.Logger(trt.Logger.ERROR))
    if dla_core is not None:
        runtime.DLA_core = dla_core
    engine = runtime.deserialize_cuda_engine(plan)
    if engine is None:
        raise DataError(f"{model_path}: TensorRT {trt.__version__} built an engine that it cannot read")
    engine_path = model_path.with_suffix(".engine")
    with new_file(engine_path) as file, new_file(engine_info_path(engine_path)) as info_file:
        file.write_bytes(plan)
        described = EngineInfo(
            model_sha256=sha256(model_path),
            engine_sha256=sha256(file),
            tensorrt=trt.__version__,
            gpu=gpu.info.name,
            compute_capability=gpu.info.compute_capability,
            driver=gpu.info.driver,
            dla_core=dla_core,
            layer_types=_layer_types(trt, engine, shapes.usual),
            shapes=tuple(shapes),
        )
        info_file.write_text(json.dumps(described.model_dump(mode="json"), indent=1) + "\n", encoding="utf-8")
    return described


def _major(trt: Any) -> int:
    return int(trt.__version__.partition(".")[0])


def _check_dla(trt: Any, info: ModelInfo) -> None:
    """The accelerator computes in halves or 8-bit integers, and not every TensorRT serves it."""
    version = tuple(int(number) for number in re.findall(r"\d+", trt.__version__)[:3])
    if (11,) <= version < (11, 4, 1):
        raise UsageError(
            f"--dla: TensorRT {trt.__version__} does not serve the deep learning accelerator (11.0 to 11.4.0 dropped "
            "it); use TensorRT 10, or leave --dla away"
        )
    if info.precision != "fp16":
        raise UsageError(
            f"--dla: the deep learning accelerator needs a model in fp16, this one is {info.precision} (it computes in "
            "fp16, or in int8 with calibration that TensorRT 11 no longer has); export with --precision fp16"
        )
    if info.dynamic_batch or info.dynamic_size:
        raise UsageError("--dla: the deep learning accelerator takes one shape; export without --dynamic")


def _layer_types(trt: Any, engine: Any, usual_shape: tuple[int, ...]) -> dict[str, int]:
    """How many layers yield which type: what TensorRT made of the types that the graph asks for."""
    context = engine.create_execution_context()
    context.set_input_shape("images", usual_shape)  # while shapes are open no formats are told
    inspector = engine.create_engine_inspector()
    inspector.execution_context = context
    layers = json.loads(inspector.get_engine_information(trt.LayerInformationFormat.JSON)).get("Layers", [])
    counts = Counter(_type_of(layer) for layer in layers)
    return dict(sorted(counts.items()))


def _type_of(layer: Any) -> str:
    """Type of the first output; TensorRT 10 tells it with the format, 11 apart from it."""
    outputs = layer.get("Outputs") if isinstance(layer, Mapping) else None
    if not outputs:
        return "unknown"
    text = " ".join(
        str(value) for key, value in outputs[0].items() if "format" in key.lower() or "datatype" in key.lower()
    ).lower()
    return next((name for name, pattern in _TYPE_NAMES.items() if re.search(pattern, text)), "unknown")
