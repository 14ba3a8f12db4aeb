"""Our own checkpoint: plain values and tensors, readable without running any code from the file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast, get_args

from pydantic import ValidationError
from torch import Tensor

import autolights
from autolights.core.errors import CheckpointError
from autolights.core.model_info import InitialWeights
from autolights.train.network.model import FINE_STRIDES, STRIDES, Size
from autolights.train.network.tensor_file import save_tensors

FORMAT = "autolights-checkpoint"
FORMAT_VERSION = 2  # 1 had no strides


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A network's weights and where they come from.

    Attributes:
        size: Of the network.
        classes: Their names; empty if the file does not tell.
        state: Names and tensors of `YoloV5.state_dict`.
        initial_weights: What the training started from; None if from nothing.
        epoch: How many epochs were trained.
        metrics: Figures of the validation after that epoch.
        config: The resolved configuration of the run.
        strides: Of the network's levels.
    """

    size: Size
    classes: tuple[str, ...]
    state: dict[str, Tensor]
    initial_weights: InitialWeights | None = None
    epoch: int = 0
    metrics: dict[str, Any] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    strides: tuple[int, ...] = STRIDES

    @property
    def class_count(self) -> int:
        """C, from the shape of the last layer."""
        return len(self.state["model.24.m.0.bias"]) // 3 - 5

    def save(self, path: Path) -> None:
        """Write the checkpoint atomically, weights in half precision.

        Running means and variances keep theirs: a variance may exceed what half precision can hold.

        Raises:
            TrainingError: If the disk is full; an earlier checkpoint at `path` is still there.
        """
        half = {
            name: tensor.half() if tensor.is_floating_point() and not _is_statistic(name) else tensor
            for name, tensor in self.state.items()
        }
        values = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "program_version": autolights.__version__,
            "size": self.size,
            "classes": list(self.classes),
            "state": half,
            "initial_weights": None if self.initial_weights is None else self.initial_weights.model_dump(),
            "epoch": self.epoch,
            "metrics": self.metrics,
            "config": self.config,
            "strides": list(self.strides),
        }
        save_tensors(values, path)

    @classmethod
    def from_values(cls, values: Mapping[str, Any], path: Path) -> "Checkpoint":
        """Check what was read from a file.

        Raises:
            CheckpointError: If the values are not those that `save` writes, or of a newer format.
        """
        if values.get("format") != FORMAT:
            raise CheckpointError(
                f"{path}: not a checkpoint of autolights or of YOLOv5; it holds {sorted(map(str, values))[:5]}"
            )
        if values["format_version"] > FORMAT_VERSION:
            raise CheckpointError(
                f"{path}: format {values['format_version']} is newer than {FORMAT_VERSION}; upgrade autolights"
            )
        try:
            initial = values["initial_weights"]
            size = values["size"]
            if size not in get_args(Size):
                raise CheckpointError(f"{path}: size must be one of {get_args(Size)}, got {size!r}")
            strides = STRIDES if values["format_version"] == 1 else tuple(values["strides"])
            if strides not in (STRIDES, FINE_STRIDES):
                raise CheckpointError(f"{path}: strides must be {STRIDES} or {FINE_STRIDES}, got {strides}")
            return cls(
                size=cast(Size, size),
                classes=tuple(values["classes"]),
                state={name: t.float() if t.is_floating_point() else t for name, t in values["state"].items()},
                initial_weights=None if initial is None else InitialWeights.model_validate(initial),
                epoch=values["epoch"],
                metrics=values["metrics"],
                config=values["config"],
                strides=strides,
            )
        except KeyError as error:
            raise CheckpointError(f"{path}: field {error} is missing; the file is damaged") from error
        except ValidationError as error:
            raise CheckpointError(f"{path}: initial_weights are incomplete; the file is damaged") from error


def _is_statistic(name: str) -> bool:
    return name.endswith(("running_mean", "running_var"))
