"""Read the public YOLOv5 checkpoints without running a byte of their pickle.

Such a file is a pickled module object of classes that we neither have nor want. All foreign names of an allow-list are
mapped to one inert stub that stores what it is given; a name outside the list ends the reading.
"""

from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor

from autolights.core.atomic import sha256
from autolights.core.errors import CheckpointError
from autolights.core.model_info import InitialWeights
from autolights.train.network.checkpoint import Checkpoint
from autolights.train.network.model import SIZES, Size, YoloV5

LICENCE = "AGPL-3.0"

# What checkpoints of the public trainer name, fresh or stripped. Each becomes a stub, so none is ever imported.
_FOREIGN_PREFIXES = (
    "argparse.Namespace",
    "models.common.",
    "models.yolo.",
    "numpy.",
    "pathlib.",
    "torch.nn.modules.",
    "utils.",
    "yolov5.models.",  # as its PyPI package calls them
    "yolov5.utils.",
)


class _Stub:
    """Stands for any foreign object: takes all arguments, keeps the state that the pickle sets, does nothing."""

    def __new__(cls, *_args: object, **_kwargs: object) -> "_Stub":
        return super().__new__(cls)


def read_public_checkpoint(path: Path, foreign_names: list[str]) -> Checkpoint:
    """Read a public YOLOv5 v6 or v7 checkpoint.

    Args:
        path: The `.pt` file.
        foreign_names: Dotted names that its pickle refers to beyond plain values and tensors.

    Raises:
        CheckpointError: If a name is not on the allow-list (the file could run code), or the file holds no network of
            one of the five sizes.
    """
    strange = sorted(name for name in foreign_names if not name.startswith(_FOREIGN_PREFIXES))
    if strange:
        raise CheckpointError(
            f"{path}: refers to {', '.join(strange)}, which no YOLOv5 checkpoint needs; refused, as it could run code"
        )
    # torch takes (object, name) pairs; its annotation forgets them.
    stubs = cast(Any, [(_Stub, name) for name in foreign_names])
    with torch.serialization.safe_globals(stubs):
        values = torch.load(path, map_location="cpu", weights_only=True)
    # The moving average is what the public figures are measured with; stripped files keep it as `model`.
    network = (values.get("ema") or values.get("model")) if isinstance(values, dict) else None
    if not isinstance(network, _Stub):
        raise CheckpointError(f"{path}: holds no module under 'ema' or 'model'; not a YOLOv5 checkpoint")
    state: dict[str, Tensor] = {}
    _collect(network, "", state)
    size = _size_of(state, path)
    checkpoint = Checkpoint(
        size=size,
        classes=_class_names(network),
        state={name: tensor.float() if tensor.is_floating_point() else tensor for name, tensor in state.items()},
        initial_weights=InitialWeights(name=path.name, sha256=sha256(path), licence=LICENCE),
    )
    _check_layers(checkpoint, path)
    return checkpoint


def _collect(module: _Stub, prefix: str, state: dict[str, Tensor]) -> None:
    """Walk a stubbed ``nn.Module`` as ``state_dict`` would."""
    fields = vars(module)
    for group in ("_parameters", "_buffers"):
        for name, tensor in fields.get(group, {}).items():
            if isinstance(tensor, Tensor):
                state[prefix + name] = tensor.detach()
    for name, child in fields.get("_modules", {}).items():
        if isinstance(child, _Stub):
            _collect(child, f"{prefix}{name}.", state)
    # Versions before 6.1 kept decoded anchors beside the anchors; the decoder computes them.
    state.pop("model.24.anchor_grid", None)


def _size_of(state: dict[str, Tensor], path: Path) -> Size:
    first = state.get("model.0.conv.weight")
    channels = None if first is None else len(first)
    for size, (_, width) in SIZES.items():
        if channels == 64 * width:
            return size
    raise CheckpointError(f"{path}: its first layer has {channels} channels; YOLOv5 n, s, m, l, x have 16 to 80")


def _class_names(network: _Stub) -> tuple[str, ...]:
    names = vars(network).get("names", ())
    if isinstance(names, dict):
        names = [names[i] for i in sorted(names)]
    return tuple(str(name) for name in names)


def _check_layers(checkpoint: Checkpoint, path: Path) -> None:
    wanted = set(YoloV5(checkpoint.size, 1).state_dict())
    missing = sorted(wanted - set(checkpoint.state))
    beyond = sorted(set(checkpoint.state) - wanted)
    if missing or beyond:
        raise CheckpointError(
            f"{path}: not the layers of a YOLOv5{checkpoint.size} v6 with three levels: "
            f"{len(missing)} missing ({', '.join(missing[:2])}), {len(beyond)} too many ({', '.join(beyond[:2])})"
        )
