"""The verbs of the runtime: run, detect. Nothing here needs the training stack."""

import json
from pathlib import Path
from typing import Annotated

import typer

from autolights.cli.options import Force, Json, Out, Overrides, Threads


def run(
    bundle: Annotated[Path, typer.Argument(exists=True, help="Folder made by `bundle`.")],
    drive: Annotated[
        Path, typer.Argument(exists=True, help="Folder with drive.yaml, frames.csv, poses.csv, map.geojson, ...")
    ],
    overrides: Overrides = None,
    config: Annotated[str, typer.Option(help="Runtime settings: YAML file or shipped name.")] = "runtime/default",
    variant: Annotated[
        list[str] | None,
        typer.Option(
            help="od, fusion or full, instead of the configuration's; repeatable: detections are computed once."
        ),
    ] = None,
    out: Out = Path("runs/estimates"),
    threads: Threads = 0,
    explain: Annotated[bool, typer.Option("--explain", help="Also write detections, costs and beliefs.")] = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Detect, fuse and track the lights of a recorded drive.

    Writes estimates.jsonl (a line for each set of frames and variant), detections.jsonl and run.json into --out.

    \b
    Example: autolights run bundle drives/day --variant full --out runs/day
    """
    from autolights.core import Bundle, load_config
    from autolights.data import Drive
    from autolights.pipeline import PipelineConfig
    from autolights.run_drive import run_drive

    loaded = Bundle.load(bundle)
    settings = load_config(config, PipelineConfig, overrides or ())
    summary = run_drive(
        loaded,
        Drive.load(drive, loaded.signals),
        settings,
        out,
        variants=tuple(variant or (settings.variant,)),
        explain=explain,
        force=force,
        threads=threads or None,
    )
    if as_json:
        typer.echo(json.dumps(summary.to_json()))
        return
    typer.echo(out)


def detect(
    bundle: Annotated[Path, typer.Argument(exists=True, help="Folder made by `bundle`.")],
    inputs: Annotated[list[str], typer.Argument(help="Images, folders, globs or videos.")],
    out: Out = Path("runs/detect"),
    score_threshold: Annotated[
        float | None, typer.Option(min=0.001, max=0.999, help="Instead of the bundle's own.")
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Write pictures with boxes.")] = True,
    threads: Threads = 0,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Detect lights in images or videos.

    Writes detections.jsonl and pictures with boxes into --out; an image that does not decode is named and counted.

    \b
    Example: autolights detect bundle photos/*.jpg --out runs/detect
    """
    from autolights.detect import detect_files

    summary = detect_files(
        bundle,
        inputs,
        out,
        score_threshold=score_threshold,
        pictures=pictures,
        threads=threads or None,
        force=force,
    )
    if as_json:
        typer.echo(json.dumps(summary.to_json()))
        return
    typer.echo(f"{out}: {summary.detections} lights in {summary.images} images, {summary.skipped} skipped")
