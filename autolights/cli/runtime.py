"""The verbs of the runtime: run, detect, tune. Nothing here needs the training stack."""

import json
import os
from pathlib import Path
from typing import Annotated

import typer

from autolights.cli.options import BackendName, Force, Json, Out, Overrides, Providers, Threads, chosen_execution


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
    backend: BackendName = None,
    provider: Providers = None,
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
    recorded = Drive.load(drive, loaded.signals)
    summary = run_drive(
        loaded,
        recorded,
        settings,
        out,
        variants=tuple(variant or (settings.variant,)),
        explain=explain,
        force=force,
        execution=chosen_execution(backend, provider, threads, len(recorded.cameras)),
    )
    if as_json:
        typer.echo(json.dumps(summary.to_json()))
        return
    typer.echo(out)


def detect(
    bundle: Annotated[Path, typer.Argument(exists=True, help="Folder made by `bundle`.")],
    inputs: Annotated[list[str], typer.Argument(help="Images, folders, globs, videos, or a camera as camera:0.")],
    out: Out = Path("runs/detect"),
    formats: Annotated[
        list[str] | None,
        typer.Option("--format", help="jsonl (default), yolo (a text per image) or coco (one JSON); repeatable."),
    ] = None,
    score_threshold: Annotated[
        float | None, typer.Option(min=0.001, max=0.999, help="Instead of the bundle's own.")
    ] = None,
    scores: Annotated[bool, typer.Option(help="Scores as a sixth column of YOLO texts.")] = True,
    pictures: Annotated[bool, typer.Option(help="Write pictures with boxes.")] = True,
    max_images: Annotated[int, typer.Option(min=0, help="Stop after so many images; 0: never.")] = 0,
    backend: BackendName = None,
    provider: Providers = None,
    threads: Threads = 0,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Detect lights in images, videos or what a camera sees.

    Writes detections.jsonl, labels/ (YOLO) or coco.json, and pictures with boxes, into --out. What does not decode is
    named, counted and passed over. A camera runs until Ctrl-C, and what was seen until then is kept; exit code 1 if it
    falls silent before.

    \b
    Example: autolights detect bundle photos/*.jpg --out runs/detect
             autolights detect bundle drive.mp4 --format coco --no-pictures --out runs/drive
             autolights detect bundle camera:0 --out runs/live
    """
    from typing import get_args

    from autolights.core.errors import UsageError
    from autolights.data.detection_files import DetectionFormat
    from autolights.detect import detect_files

    known = get_args(DetectionFormat)
    for name in formats or ():
        if name not in known:
            raise UsageError(f"--format must be one of {', '.join(known)}, got {name!r}")
    # A damaged video makes FFmpeg print a line for each block, hundreds a frame; what failed is counted and named here.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    summary = detect_files(
        bundle,
        inputs,
        out,
        formats=[known[known.index(name)] for name in formats or ("jsonl",)],
        score_threshold=score_threshold,
        scores=scores,
        pictures=pictures,
        max_images=max_images or None,
        execution=chosen_execution(backend, provider, threads, 1),
        force=force,
    )
    if as_json:
        typer.echo(json.dumps(summary.to_json()))
    else:
        typer.echo(
            f"{out}: {summary.detections} lights in {summary.images} images, {summary.images_per_s:.1f} images/s; "
            f"skipped {summary.skipped} files and {summary.bad_frames + summary.missing_frames} frames"
        )
    if summary.lost_camera:  # whoever waits for this program did not end it
        raise typer.Exit(1)


def tune(
    bundle: Annotated[Path, typer.Argument(exists=True, help="Folder made by `bundle`.")],
    images: Annotated[int, typer.Option(min=1, help="Cameras that expose together.")] = 2,
    image_size: Annotated[str, typer.Option(help="Of the cameras, in pixels.")] = "1920x1200",
    seconds: Annotated[float, typer.Option(min=0, help="About how long to measure.")] = 6.0,
    bfloat16: Annotated[
        bool, typer.Option("--bfloat16", help="Let OpenVINO round to bfloat16; class probabilities move a little.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Measure how a bundle's detector runs fastest on this machine.

    Tries the numbers of threads, cameras side by side, OpenVINO and GPU providers where they are installed. From then
    on `run`, `detect` and Detector.from_bundle use the best for this bundle's model on this machine, unless told
    otherwise. The result is kept in your cache folder; the bundle is not changed.

    \b
    Example: autolights tune bundle --images 2 --image-size 1280x800
    """
    from autolights.core import Bundle
    from autolights.core.errors import UsageError
    from autolights.tune import tune_bundle

    width, _, height = image_size.partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
        raise UsageError(f"--image-size must be like 1920x1200, got '{image_size}'")
    result = tune_bundle(
        Bundle.load(bundle), images=images, image_wh=(int(width), int(height)), seconds=seconds, bfloat16=bfloat16
    )
    if as_json:
        typer.echo(json.dumps({"path": str(result.path), **result.tuning.model_dump(mode="json")}))
        return
    best_ms = next(each.set_ms for each in result.tuning.measurements if each.execution == result.tuning.best)
    typer.echo(f"{'execution':40} {'ms per set':>10} {'ratio':>6} {'difference':>11}")
    for each in result.tuning.measurements:
        name = f"{each.execution}{'  <- best' if each.execution == result.tuning.best else ''}"
        ratio = f"{each.set_ms / best_ms:6.2f}" if each.in_turns else "     -"
        typer.echo(f"{name:40} {each.set_ms:10.1f} {ratio} {each.prob_difference:11.1e}")
    for execution, reason in result.refused.items():
        typer.echo(f"{execution}: {reason}", err=True)
    typer.echo(f"kept in {result.path}")
