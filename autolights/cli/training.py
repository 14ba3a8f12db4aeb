"""The verbs that make a bundle: train, val, export, fit-hmm, bundle."""

import json
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from autolights.cli.options import Force, Json, Out, Overrides, Signals
from autolights.core.errors import ConfigError, UsageError


def train(
    config: Annotated[str, typer.Argument(help="YAML file or shipped name, e.g. train/demo, train/photos.")],
    overrides: Overrides = None,
    out: Out = Path("runs/train"),
    force: Force = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the run in --out; begin if it has no whole epoch yet.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Tell what the run would be made of, and stop; writes nothing.")
    ] = False,
) -> None:
    """Train a detector on a YOLO-format folder.

    Writes best.pt, last.pt, config.yaml, results.csv, metrics.json, pictures and TensorBoard curves into --out, and
    state.pt, from which --resume goes on as if the run had never been stopped.

    \b
    Examples:
      autolights train train/demo data=runs/images --dry-run
      autolights train train/demo data=runs/images --out runs/train
      autolights train train/photos data=photos weights=yolov5n.pt epochs=20 --out runs/photos
      autolights train runs/photos/config.yaml --out runs/photos --resume
      torchrun --nproc-per-node 2 -m autolights train train/photos data=photos device=cuda
      tensorboard --logdir runs/train/tensorboard
    """
    from autolights.core import load_config
    from autolights.train import TrainConfig, describe_run
    from autolights.train import train as train_detector

    settings = load_config(config, TrainConfig, overrides or ())
    if dry_run:
        typer.echo(describe_run(settings))
        return
    result = train_detector(settings, out, force=force, resume=resume)
    if os.environ.get("RANK", "0") == "0":  # of torchrun's processes one speaks
        typer.echo(result.best_path)


def val(
    checkpoint: Annotated[
        Path,
        typer.Argument(exists=True, dir_okay=False, help="best.pt of a training run, or a public YOLOv5 checkpoint."),
    ],
    data: Annotated[Path, typer.Argument(exists=True, help="YOLO-format folder.")],
    split: Annotated[str, typer.Option(help="Part of the data: train or val.")] = "val",
    long_side: Annotated[int, typer.Option(min=32, help="Long side of the network's input, pixels.")] = 960,
    score_threshold: Annotated[
        float, typer.Option(min=0.001, max=0.999, help="Of precision, recall and the confusion matrix.")
    ] = 0.25,
    classes: Annotated[str, typer.Option(help="Comma-separated class names, for a folder without data.yaml.")] = "",
    val_fraction: Annotated[float, typer.Option(min=0, max=1, help="Share held out of a folder with one part.")] = 0.0,
    group_pattern: Annotated[
        str, typer.Option(help="Regular expression; files with the same first group stay on one side of that split.")
    ] = "",
    save_predictions: Annotated[
        bool, typer.Option("--save-predictions", help="Also write predictions.json: COCO results, boxes in pixels.")
    ] = False,
    out: Out = Path("runs/val"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Measure a detector: COCO metrics, precision, recall, recall by height, and the confusion matrix.

    Writes metrics.json, confusion.json, images.txt (what was measured on), pr_curves.png and predictions.jpg into
    --out. Splits by --val-fraction and --group-pattern are the same as in training with the same values.

    \b
    Example: autolights val runs/train/best.pt runs/images --out runs/val
    """
    from autolights.core.atomic import new_folder
    from autolights.data import load_image_dataset
    from autolights.train import detect_dataset, load_checkpoint, metrics_as_text, save_curves, save_sheet
    from autolights.train import save_predictions as save

    if split not in ("train", "val"):
        raise UsageError(f"--split must be train or val, got {split!r}")
    dataset = load_image_dataset(
        data,
        "train" if split == "train" else "val",
        classes=classes.split(",") if classes else None,
        val_fraction=val_fraction,
        group_pattern=group_pattern or None,
    )
    with new_folder(out, force=force) as folder:
        detections = detect_dataset(
            load_checkpoint(checkpoint, classes=dataset.classes),
            dataset,
            long_side=long_side,
            score_threshold=score_threshold,
        )
        metrics = detections.metrics()
        metrics.save(folder / "metrics.json")
        metrics.confusion.save(folder / "confusion.json")
        (folder / "images.txt").write_text("".join(f"{path}\n" for path in detections.image_paths))
        save_curves(metrics, folder / "pr_curves.png")
        save_sheet(detections, folder / "predictions.jpg")
        if save_predictions:
            save(folder / "predictions.json", detections.image_paths, detections.predictions)
    typer.echo(json.dumps(metrics.to_json()) if as_json else metrics_as_text(metrics))


def export(
    checkpoint: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="best.pt of a training run.")],
    out: Out = Path("runs/export/model.onnx"),
    size: Annotated[str, typer.Option(help="Input WIDTHxHEIGHT in pixels, multiples of 32.")] = "960x608",
    score_threshold: Annotated[float, typer.Option(min=0.001, max=0.999, help="Of the runtime.")] = 0.25,
    metrics: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="metrics.json of `val`, kept in the manifest.")
    ] = None,
    image: Annotated[
        list[str] | None, typer.Option(help="Images to compare on, beside random ones; repeatable.")
    ] = None,
    force: Force = False,
) -> None:
    """Export a checkpoint to ONNX and check it number by number against the network it came from.

    Writes the model and a description (.json) beside it; if they disagree nothing is written.

    \b
    Example: autolights export runs/train/best.pt --size 960x608 --out runs/export/model.onnx
    """
    from autolights.core.atomic import refuse_existing
    from autolights.core.json_files import read_json_object
    from autolights.infer import ImageSources
    from autolights.train import export_onnx, load_checkpoint

    for path in (out, out.with_suffix(".json")):
        refuse_existing(path, force=force)
    width, cross, height = size.partition("x")
    if not (cross and width.isdigit() and height.isdigit()):
        raise UsageError(f"--size must read WIDTHxHEIGHT, e.g. 960x608, got {size!r}")
    report = export_onnx(
        load_checkpoint(checkpoint),
        out,
        size_wh=(int(width), int(height)),
        score_threshold=score_threshold,
        images=[source.image_bgr for source in ImageSources(image)] if image else (),
        training=read_json_object(metrics) if metrics else None,
    )
    typer.echo(f"{out}: {json.dumps(report.info.parity)}")


def fit_hmm(
    confusion: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="confusion.json of `val`.")],
    signals: Signals = "signals/autolights_13",
    out: Out = Path("runs/export/hmm.json"),
    pseudocount: Annotated[float, typer.Option(min=0, help="Added to each cell, in counts.")] = 1.0,
    prior: Annotated[
        str, typer.Option(help="Over states: uniform, or empirical (the data's class balance).")
    ] = "uniform",
    frame_rate: Annotated[float, typer.Option(min=0.1, help="Nominal sets of frames per second.")] = 10.0,
    overrides: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="YAML with hand-tuned matrices by type.")
    ] = None,
    force: Force = False,
) -> None:
    """Fit one HMM per type of light: rates from the signal description, observations from the confusion matrix.

    \b
    Example: autolights fit-hmm runs/val/confusion.json --out runs/export/hmm.json
    """
    from autolights.core import ConfusionMatrix, load_signals, save_hmm
    from autolights.core.atomic import refuse_existing
    from autolights.train import fit_hmm as fit

    refuse_existing(out, force=force)
    if prior not in ("uniform", "empirical"):
        raise UsageError(f"--prior must be uniform or empirical, got {prior!r}")
    hmm = fit(
        ConfusionMatrix.load(confusion),
        load_signals(signals),
        nominal_dt_s=1 / frame_rate,
        pseudocount=pseudocount,
        prior="uniform" if prior == "uniform" else "empirical",
        overrides=_read_overrides(overrides) if overrides else None,
    )
    save_hmm(out, hmm)
    typer.echo(out)


def bundle(
    model: Annotated[
        Path,
        typer.Option(
            exists=True, dir_okay=False, help="model.onnx of `export`; its description (.json) lies beside it."
        ),
    ],
    hmm: Annotated[Path, typer.Option(exists=True, dir_okay=False, help="hmm.json of `fit-hmm`.")],
    confusion: Annotated[Path, typer.Option(exists=True, dir_okay=False, help="confusion.json of `val`.")],
    signals: Signals = "signals/autolights_13",
    out: Out = Path("runs/bundle"),
    force: Force = False,
) -> None:
    """Assemble what the runtime needs into one folder with hashes, and verify it.

    \b
    Example: autolights bundle --model runs/export/model.onnx --hmm runs/export/hmm.json \\
               --confusion runs/val/confusion.json --out runs/bundle
    """
    from autolights.core import Bundle, ConfusionMatrix, load_hmm, load_signals
    from autolights.core.model_info import load_model_info
    from autolights.core.progress import say

    made = Bundle(
        model=load_model_info(model),
        model_path=model,
        signals=load_signals(signals),
        hmm=load_hmm(hmm),
        confusion=ConfusionMatrix.load(confusion),
    )
    initial = made.model.initial_weights
    if initial and "AGPL" in initial.licence:
        say(f"warning: the weights descend from {initial.name} ({initial.licence}); check that you may ship them")
    made.save(out, force=force)
    Bundle.load(out)
    typer.echo(out)


def _read_overrides(path: Path) -> dict[str, Any]:
    from autolights.core.config import read_yaml

    values = read_yaml(path)
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: must hold fields by type of light, got {type(values).__name__}")
    return values
