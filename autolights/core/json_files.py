"""JSON files that hold one object: read with errors that name the file, written atomically."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from autolights.core.atomic import write_text
from autolights.core.errors import DataError

ModelT = TypeVar("ModelT", bound=BaseModel)

MAX_JSON_BYTES = 32 * 2**20  # the largest that is written, metrics.json of a large validation, has a few


def read_json_object(path: Path, *, error: type[DataError] = DataError, hint: str = "") -> dict[str, Any]:
    """Read a file that holds one JSON object.

    Args:
        path: The file.
        error: What is raised.
        hint: What to do if the file is missing.

    Raises:
        DataError: Or the given kind, if the file cannot be read, is absurdly large, no JSON, no object, or names a key
            twice; the text names it.
    """
    try:
        size = path.stat().st_size
        if size > MAX_JSON_BYTES:
            raise error(f"{path}: has {size:,} bytes, more than the {MAX_JSON_BYTES:,} that are read")
        values = json.loads(path.read_bytes(), object_pairs_hook=_without_repetition)
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror})" + (f"; {hint}" if hint else "")) from problem
    except RecursionError as problem:
        raise error(f"{path}: nested too deeply") from problem
    except ValueError as problem:
        raise error(f"{path}: not JSON ({problem})") from problem
    if not isinstance(values, dict):
        raise error(f"{path}: must hold a JSON object, got {type(values).__name__}")
    return values


def _without_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        keys = [key for key, _ in pairs]
        repeated = next(key for i, key in enumerate(keys) if key in keys[:i])
        raise ValueError(f"key {repeated!r} is repeated")
    return values


def validated(
    model: type[ModelT], values: Mapping[str, Any], path: Path, *, error: type[DataError] = DataError
) -> ModelT:
    """Turn the values of a file into a model.

    Raises:
        DataError: Or the given kind, if a field is missing or wrong; the text names file and field.
    """
    try:
        return model.model_validate(values)
    except ValidationError as problem:
        first = problem.errors()[0]
        raise error(f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from problem


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write one object; the file appears whole or not at all."""
    write_text(path, json.dumps(values, indent=1) + "\n")
