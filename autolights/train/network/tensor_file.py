"""Files of tensors and plain values: written whole or not at all, read without running any code from them."""

import errno
import pickle
import shutil
import zipfile
from pathlib import Path
from typing import Any

import torch

from autolights.core.atomic import new_file
from autolights.core.errors import CheckpointError, TrainingError


def save_tensors(values: dict[str, Any], path: Path) -> None:
    """Write a file of tensors and plain values; an earlier one at `path` stays until the new one is whole.

    Raises:
        TrainingError: If the disk is full; what was at `path` is still there.
    """
    try:
        # Through a file of Python's: torch's own writer does not say what failed.
        with new_file(path) as temporary, temporary.open("wb") as file:
            torch.save(values, file)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        free_mb = shutil.disk_usage(path.parent).free / 1e6
        raise TrainingError(
            f"{path}: cannot be saved, the disk is full ({free_mb:.0f} MB free); "
            "what was saved before is untouched: free some space and go on with --resume"
        ) from error


def read_tensors(path: Path) -> dict[str, Any]:
    """Read what `save_tensors` has written, onto the CPU.

    Raises:
        CheckpointError: If the file is damaged, or holds more than tensors and plain values.
    """
    if not zipfile.is_zipfile(path):
        raise CheckpointError(f"{path}: cannot be read (not a zip archive); the file is damaged")
    try:
        values = torch.load(path, map_location="cpu", weights_only=True)
    except (RuntimeError, ValueError, pickle.UnpicklingError) as error:
        reason = str(error).split("\n", 1)[0]
        raise CheckpointError(f"{path}: cannot be read ({reason}); the file is damaged") from error
    if not isinstance(values, dict):
        raise CheckpointError(f"{path}: must hold named values, got a {type(values).__name__}")
    return values
