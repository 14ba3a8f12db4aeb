"""Options that several verbs share, so that they read and behave alike."""

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

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
Threads: TypeAlias = Annotated[int, typer.Option("--threads", min=0, help="Of ONNX Runtime; 0: its own choice.")]
