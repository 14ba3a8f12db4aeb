"""What a TensorRT engine was built from, and for which machine: ``model.engine.json`` beside ``model.engine``."""

from pathlib import Path

from autolights.core import Config
from autolights.core.json_files import read_json_object, validated


class EngineInfo(Config):
    """Description of an engine.

    Attributes:
        model_sha256: Of the ONNX file that it was built from.
        engine_sha256: Of the engine's own file.
        tensorrt: Version of the library that built it; no other reads it.
        gpu: Name of the GPU; on another one an engine may be slow, wrong or not load at all.
        compute_capability: Of the GPU, like ``8.7``.
        driver: At the time of building; for the record.
        dla_core: The core of the deep learning accelerator; None: the GPU alone.
        layer_types: How many of the engine's layers yield fp32, fp16, int8, ..., as TensorRT's inspector tells.
        shapes: Smallest, usual and largest (B, 3, H, W) input.
    """

    model_sha256: str
    engine_sha256: str
    tensorrt: str
    gpu: str
    compute_capability: str
    driver: str
    dla_core: int | None = None
    layer_types: dict[str, int]
    shapes: tuple[tuple[int, int, int, int], ...]


def engine_info_path(engine_path: Path) -> Path:
    """``model.engine`` → ``model.engine.json``."""
    return engine_path.with_name(f"{engine_path.name}.json")


def load_engine_info(engine_path: Path) -> EngineInfo:
    """Read the description beside an engine.

    Raises:
        DataError: If it is missing or breaks the format.
    """
    path = engine_info_path(engine_path)
    values = read_json_object(path, hint="`autolights export --tensorrt` writes it")
    return validated(EngineInfo, values, path)
