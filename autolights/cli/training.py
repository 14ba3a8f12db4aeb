"""The verbs that make and measure a detector: train, val."""

import dataclasses
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from autolights.cli.options import Force, Json, Out, Overrides
from autolights.core.errors import UsageError

if TYPE_CHECKING:
    from autolights.data import ImageDataset
    from autolights.train import DatasetDetections


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
    model: Annotated[
        Path,
        typer.Argument(
            exists=True,
            help="best.pt of a training run, a public YOLOv5 checkpoint, model.onnx of `export`, or a bundle's folder.",
        ),
    ],
    data: Annotated[Path, typer.Argument(exists=True, help="YOLO-format folder.")],
    split: Annotated[str, typer.Option(help="Part of the data: train or val.")] = "val",
    long_side: Annotated[
        int | None,
        typer.Option(
            min=32,
            help="Long side of a checkpoint's input, pixels; an exported model has its own.  [default: 960]",
        ),
    ] = None,
    score_threshold: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            max=0.999,
            help="Of precision, recall and the confusion matrix.  [default: 0.25, or the exported model's]",
        ),
    ] = None,
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

    An exported model is run as in the car, by ONNX Runtime. The confusion matrix says which file it was counted with: a
    bundle with an int8 model wants that of this very file.

    Writes metrics.json, confusion.json, images.txt (what was measured on), pr_curves.png and predictions.jpg into
    --out. Splits by --val-fraction and --group-pattern are the same as in training with the same values.

    \b
    Examples:
      autolights val runs/train/best.pt runs/images --out runs/val
      autolights val runs/export/model.onnx runs/images --out runs/val-int8
    """
    from autolights.core.atomic import new_folder
    from autolights.data import load_image_dataset
    from autolights.train import metrics_as_text, save_curves, save_sheet
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
        detections = _detections(model, dataset, long_side, score_threshold)
        metrics = detections.metrics()
        metrics.save(folder / "metrics.json")
        metrics.confusion.save(folder / "confusion.json")
        (folder / "images.txt").write_text("".join(f"{path}\n" for path in detections.image_paths))
        save_curves(metrics, folder / "pr_curves.png")
        save_sheet(detections, folder / "predictions.jpg")
        if save_predictions:
            save(folder / "predictions.json", detections.image_paths, detections.predictions)
    typer.echo(json.dumps(metrics.to_json()) if as_json else metrics_as_text(metrics))


def _detections(
    model: Path, dataset: "ImageDataset", long_side: int | None, score_threshold: float | None
) -> "DatasetDetections":
    from autolights.core import CountedWith
    from autolights.core.atomic import sha256
    from autolights.train import ExportedModel, detect_dataset, load_checkpoint

    if model.is_dir() or model.suffix == ".onnx":
        if long_side is not None:
            raise UsageError(f"{model}: an exported model has an input of its own; leave --long-side out")
        exported = ExportedModel.open(model)
        return detect_dataset(exported, dataset, score_threshold=score_threshold or exported.info.score_threshold)
    detections = detect_dataset(
        load_checkpoint(model, classes=dataset.classes),
        dataset,
        long_side=long_side or 960,
        score_threshold=score_threshold or 0.25,
    )
    return dataclasses.replace(detections, counted_with=CountedWith(sha256(model), "fp32"))
