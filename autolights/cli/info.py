"""`autolights info`: what a network is and where it comes from."""

import json
from typing import Annotated

import typer

from autolights.cli.options import Json
from autolights.core.errors import UsageError


def info(
    source: Annotated[
        str, typer.Argument(help="Checkpoint file, base for the shipped one, or a size: n, s, m, l or x.")
    ],
    input_size: Annotated[
        str, typer.Option("--input", help="Input WIDTHxHEIGHT in pixels that the cost is counted for.")
    ] = "640x640",
    class_count: Annotated[int, typer.Option("--classes", min=1, help="Number of classes of a bare size.")] = 80,
    as_json: Json = False,
) -> None:
    """Tell a network's size, cost, anchors, licence and figures.

    \b
    Examples:
      autolights info runs/train/best.pt --input 960x608
      autolights info s --classes 13
    """
    from autolights.train import describe_network

    width, cross, height = input_size.partition("x")
    if not (cross and width.isdigit() and height.isdigit()) or int(width) % 32 or int(height) % 32:
        raise UsageError(f"--input must read WIDTHxHEIGHT in multiples of 32, e.g. 960x608, got {input_size!r}")
    described = describe_network(source, input_wh=(int(width), int(height)), class_count=class_count)
    typer.echo(json.dumps(described.to_json()) if as_json else described.to_text())
