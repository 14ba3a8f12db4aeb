"""Options that several verbs share, so that they read and behave alike."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias, cast, get_args

import typer

from autolights.core.errors import UsageError

if TYPE_CHECKING:
    from autolights.infer.execution import Backend, Execution

Out: TypeAlias = Annotated[Path, typer.Option("--out", "-o", help="Where the result goes.")]
Force: TypeAlias = Annotated[bool, typer.Option("--force", help="Replace what is already at --out.")]
Json: TypeAlias = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Overrides: TypeAlias = Annotated[
    list[str] | None,
    typer.Argument(metavar="[KEY=VALUE]...", help="Dotted overrides of the configuration, e.g. epochs=5."),
]
Signals: TypeAlias = Annotated[
    str, typer.Option("--signals", help="Signal description: a YAML file or the name of a shipped one.")
]
Threads: TypeAlias = Annotated[int, typer.Option("--threads", min=0, help="Of the CPU; 0: the backend's own choice.")]
BackendName: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--backend",
        help="onnxruntime, openvino (extra of that name) or tensorrt (engine made by `export --tensorrt`)."
        "  [default: as tuned, else onnxruntime]",
    ),
]
Providers: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--provider",
        help="Of ONNX Runtime, e.g. CUDAExecutionProvider; repeatable, the preferred first.  [default: the CPU's]",
    ),
]


def chosen_execution(
    backend: str | None, providers: list[str] | None, threads: int, images_at_once: int
) -> "Execution | None":
    """What the options ask for; None if they ask for nothing, so that what was tuned holds.

    Raises:
        UsageError: If the backend is unknown, or providers are asked of another one than ONNX Runtime.
    """
    from autolights.infer.execution import Backend, Execution

    if not (backend or providers or threads):
        return None
    known = get_args(Backend)
    if backend and backend not in known:
        raise UsageError(f"--backend must be one of {', '.join(known)}, got '{backend}'")
    chosen = cast("Backend", backend or "onnxruntime")
    if providers and chosen != "onnxruntime":
        raise UsageError(f"--provider is a choice of the backend onnxruntime, not of {chosen}")
    return Execution.for_images(images_at_once, backend=chosen, providers=providers or (), threads=threads or None)
