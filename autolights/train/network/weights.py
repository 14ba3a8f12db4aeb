"""Weights from files into networks: our own checkpoints and the public ones, whole or as far as they fit."""

import pickle
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from autolights.core.atomic import sha256
from autolights.core.errors import CheckpointError, UsageError
from autolights.core.model_info import InitialWeights
from autolights.train.network.checkpoint import Checkpoint
from autolights.train.network.model import YoloV5
from autolights.train.network.public_checkpoint import read_public_checkpoint

OWN_LICENCE = "Apache-2.0"
BASE = "base"
_ANCHORS = "model.24.anchors"
_HEAD = "model.24.m."
_COMMON_ROWS = 5  # of each anchor of the head: box and objectness, which every set of classes has
BASE_PATH = Path(__file__).parents[1] / "base" / "yolov5n_autolights13.pt"


@dataclass(frozen=True)
class TransferReport:
    """What became of a checkpoint's tensors.

    Attributes:
        loaded: How many tensors were taken over.
        total: How many the network has.
        partly: Tensors of the head of which the rows of box, objectness and the classes of like name were taken over.
        reinitialised: Tensors of the network that keep their start, and why; those of the fine level together.
        unused: Tensors of the file that the network does not have.
    """

    loaded: int
    total: int
    partly: tuple[str, ...]
    reinitialised: tuple[str, ...]
    unused: tuple[str, ...]

    def __str__(self) -> str:
        text = f"{self.loaded} of {self.total} tensors loaded"
        if self.partly:
            text += f"; box, objectness and classes of like name alone: {', '.join(self.partly)}"
        if self.reinitialised:
            text += f"; re-initialised: {', '.join(self.reinitialised)}"
        if self.unused:
            text += f"; not used: {', '.join(self.unused)}"
        return text


def read_checkpoint(path: Path) -> Checkpoint:
    """Read our own checkpoint or a public YOLOv5 one; no code from the file is run.

    Raises:
        UsageError: If there is no such file.
        CheckpointError: If it is neither, damaged, or refers to code.
    """
    if not path.is_file():
        raise UsageError(f"{path}: no such checkpoint")
    try:
        foreign_names = torch.serialization.get_unsafe_globals_in_checkpoint(path)
        if foreign_names:
            return read_public_checkpoint(path, foreign_names)
        values = torch.load(path, map_location="cpu", weights_only=True)
    except (RuntimeError, ValueError, EOFError, zipfile.BadZipFile, pickle.UnpicklingError) as error:
        reason = str(error).split("\n", 1)[0]
        raise CheckpointError(f"{path}: cannot be read as a checkpoint ({reason})") from error
    if not isinstance(values, dict):
        raise CheckpointError(
            f"{path}: not a checkpoint of autolights or of YOLOv5; it holds a {type(values).__name__}"
        )
    return Checkpoint.from_values(values, path)


def load_checkpoint(path: Path, *, classes: Sequence[str] | None = None) -> YoloV5:
    """Build the network that a checkpoint holds, ready to be used.

    Args:
        path: ``best.pt`` or ``last.pt`` of a run, or a public YOLOv5 checkpoint.
        classes: Names that it must know, in this order; None takes what the file says.

    Returns:
        The network in eval mode; `initial_weights` is what its training started from.

    Raises:
        UsageError: If there is no such file.
        CheckpointError: If the file cannot be read or knows other classes.
    """
    checkpoint = read_checkpoint(path)
    known = checkpoint.classes or tuple(classes or ())
    if classes is not None and tuple(classes) != known:
        raise CheckpointError(f"{path}: knows {len(known)} classes {_short(known)}, not {_short(classes)}")
    if known and len(known) != checkpoint.class_count:
        raise CheckpointError(
            f"{path}: its head is for {checkpoint.class_count} classes, there are {len(known)} names {_short(known)}"
        )
    model = YoloV5(checkpoint.size, checkpoint.class_count, known, strides=checkpoint.strides)
    try:
        model.load_state_dict(checkpoint.state)
    except RuntimeError as error:
        raise CheckpointError(f"{path}: its tensors do not fit a YOLOv5{checkpoint.size} ({error})") from error
    model.initial_weights = checkpoint.initial_weights
    return model.eval()


def weights_path(weights: str) -> Path:
    """The file behind the setting `weights`: ``base`` is the shipped base checkpoint."""
    return BASE_PATH if weights == BASE else Path(weights)


def start_from(model: YoloV5, weights: str) -> TransferReport:
    """Give a network its initial weights and note them on it.

    Args:
        model: Changed in place.
        weights: ``base`` for the shipped base checkpoint, or a file.

    Raises:
        UsageError: If there is no such file.
        CheckpointError: If it cannot be read or is of another size.
    """
    path = weights_path(weights)
    checkpoint = read_checkpoint(path)
    if checkpoint.size != model.size:
        raise CheckpointError(
            f"{path}: holds a YOLOv5{checkpoint.size}; set size to '{checkpoint.size}' or choose other weights"
        )
    report = transfer(model, checkpoint.state, checkpoint.classes)
    # Whatever descends from copyleft weights stays under their licence, however often it is trained further.
    inherited = checkpoint.initial_weights
    licence = inherited.licence if inherited and inherited.licence != OWN_LICENCE else OWN_LICENCE
    model.initial_weights = InitialWeights(name=path.name, sha256=sha256(path), licence=licence)
    return report


def transfer(model: YoloV5, state: dict[str, Tensor], classes: Sequence[str]) -> TransferReport:
    """Copy what fits, leave the rest as it is.

    That is every tensor whose name and shape fit, the anchors of the common levels, and of a head for other classes
    the rows of box and objectness and those of the classes that both know.

    Args:
        model: Changed in place.
        state: Tensors of a checkpoint.
        classes: That it knows; none if it does not name them.
    """
    own = model.state_dict()
    fitting = {name: tensor for name, tensor in state.items() if name in own and own[name].shape == tensor.shape}
    if classes and tuple(classes) != model.classes:  # as many, but others: rows go by name
        fitting = {name: tensor for name, tensor in fitting.items() if not name.startswith(_HEAD)}
    if _ANCHORS in state and _ANCHORS not in fitting:
        # Levels have one order, so those of the shorter list are the common ones.
        common = state[_ANCHORS][: len(own[_ANCHORS])]
        fitting[_ANCHORS] = torch.cat([common.to(own[_ANCHORS]), own[_ANCHORS][len(common) :]])
    partly = []
    for name, tensor in own.items():
        theirs = state.get(name)
        if (
            name.startswith(_HEAD)
            and name not in fitting
            and theirs is not None
            and theirs.shape[1:] == tensor.shape[1:]
        ):
            fitting[name] = _with_known_rows(tensor, theirs, model.classes, classes)
            partly.append(f"{name} ({len(theirs)} → {len(tensor)} channels)")
    model.load_state_dict(fitting, strict=False)
    changed = (
        f"{name} ({len(state[name])} → {len(tensor)} channels)" if name in state else f"{_part(name)} (not in the file)"
        for name, tensor in own.items()
        if name not in fitting
    )
    unused = (_part(name) for name in state if name not in own)
    return TransferReport(
        len(fitting) - len(partly), len(own), tuple(partly), tuple(dict.fromkeys(changed)), tuple(dict.fromkeys(unused))
    )


def _with_known_rows(own: Tensor, theirs: Tensor, classes: Sequence[str], their_classes: Sequence[str]) -> Tensor:
    """A head's tensor with the rows that another set of classes has as well."""
    both = [name for name in classes if name in their_classes]
    rows = [*range(_COMMON_ROWS), *(_COMMON_ROWS + classes.index(name) for name in both)]
    their_rows = [*range(_COMMON_ROWS), *(_COMMON_ROWS + their_classes.index(name) for name in both)]
    merged = own.clone()
    per_anchor = merged.view(3, -1, *own.shape[1:])
    per_anchor[:, rows] = theirs.to(own).reshape(3, -1, *own.shape[1:])[:, their_rows]
    return merged


def _part(name: str) -> str:
    """A tensor's name, or the fine level's for all of it."""
    return name if name.startswith("model.") else name.split(".")[0]


def _short(names: Sequence[str]) -> str:
    shown = ", ".join(names[:4])
    return f"[{shown}, ...]" if len(names) > 4 else f"[{shown}]"
