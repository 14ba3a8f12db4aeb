"""The verbs that make a bundle of a checkpoint: export, fit-hmm, bundle."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast, get_args

import typer

from autolights.cli.options import Force, Out, Signals
from autolights.core.errors import ConfigError, UsageError
from autolights.core.model_info import Head, ModelInfo, Precision

if TYPE_CHECKING:
    from autolights.train.deliver.int8 import Int8Settings


def export(
    checkpoint: Annotated[
        Path,
        typer.Argument(
            exists=True,
            dir_okay=False,
            help="best.pt of a training run, or a public YOLOv5 checkpoint; or a model.onnx that was exported before, "
            "for --tensorrt and --check-tensorrt alone.",
        ),
    ],
    out: Out = Path("runs/export/model.onnx"),
    size: Annotated[str, typer.Option(help="Input WIDTHxHEIGHT in pixels, multiples of 32.")] = "960x608",
    head: Annotated[
        str,
        typer.Option(
            help="What comes out. raw: rows of the network; end2end: lights, suppressed in the graph; efficient-nms: "
            "the same by a plug-in of full TensorRT, without class vectors, so not for bundles.",
        ),
    ] = "raw",
    precision: Annotated[str, typer.Option(help="Of weights and arithmetic: fp32, fp16 or int8.")] = "fp32",
    half_io: Annotated[bool, typer.Option("--half-io", help="Input and outputs in float16; needs fp16.")] = False,
    dynamic: Annotated[
        list[str] | None,
        typer.Option(help="What is left free: batch (the number of images) or size (multiples of 32); repeatable."),
    ] = None,
    opset: Annotated[int, typer.Option(help="ONNX operator set, 17 to 20.")] = 17,
    score_threshold: Annotated[float, typer.Option(min=0.001, max=0.999, help="Of the runtime.")] = 0.25,
    nms_iou_threshold: Annotated[
        float, typer.Option(min=0.01, max=0.99, help="Of two boxes that overlap more the worse one goes.")
    ] = 0.5,
    max_detections: Annotated[int, typer.Option(min=1, max=512, help="The most lights of an image.")] = 100,
    tensorrt: Annotated[
        bool,
        typer.Option(
            "--tensorrt",
            help="Also build model.engine for this machine's GPU; needs TensorRT 10 or newer and cuda-bindings.",
        ),
    ] = False,
    dla: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="With --tensorrt: run what can be on this core of the deep learning accelerator (Jetson Orin), the "
            "rest on the GPU; needs fp16 and one fixed shape. TensorRT 11.0 to 11.4.0 do not serve it.",
        ),
    ] = None,
    check_tensorrt: Annotated[
        bool,
        typer.Option(
            "--check-tensorrt",
            help="Also parse and build the file with TensorRT's sibling for RTX cards; needs no GPU, but the extra "
            "check-tensorrt.",
        ),
    ] = False,
    compute_capability: Annotated[
        list[str] | None,
        typer.Option(help="Of --check-tensorrt, e.g. 8.6; repeatable.  [default: 7.5, 8.0, 8.6, 8.9]"),
    ] = None,
    calibrate: Annotated[
        Path | None,
        typer.Option(
            exists=True, help="Of int8: YOLO-format folder; its train part calibrates, its val part measures the loss."
        ),
    ] = None,
    calibration: Annotated[
        str,
        typer.Option(help="Of int8: range of a tensor, from mse (least squared error), minmax or entropy."),
    ] = "mse",
    calibration_images: Annotated[int, typer.Option(min=1, help="Of int8: how many of the train part.")] = 200,
    max_ap50_drop: Annotated[
        float, typer.Option(min=0, max=1, help="Of int8: refuse a model that loses more AP50; 0.01 is one point.")
    ] = 0.01,
    int8_for: Annotated[
        str,
        typer.Option(
            help="Who runs int8: tensorrt (fastest in OpenVINO too) or onnxruntime (on a CPU; TensorRT refuses it)."
        ),
    ] = "tensorrt",
    metrics: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="metrics.json of `val`, kept in the manifest.")
    ] = None,
    image: Annotated[
        list[str] | None,
        typer.Option(help="Images to compare on, beside random ones: files, folders or globs; repeatable."),
    ] = None,
    force: Force = False,
) -> None:
    """Export a checkpoint to ONNX and check it number by number against the network it came from.

    Writes the model and a description (.json) beside it. ONNX Runtime runs it on random images and on those of
    --image, at several batches and sizes where these are free; unless it says what the network says, nothing is
    written. The figures go into the description, and from there into the bundle's manifest.

    int8 is accepted by its accuracy on labelled images: layers that lose too much stay in float, and where that does
    not keep --max-ap50-drop nothing is written. Measure the file itself with `val`, for its own HMMs.

    \b
    Examples:
      autolights export runs/train/best.pt --size 960x608 --out runs/export/model.onnx
      autolights export runs/train/best.pt --head end2end --dynamic batch --image 'runs/images/images/val/*.jpg'
      autolights export runs/train/best.pt --precision fp16 --check-tensorrt --out runs/export/model.onnx
      autolights export runs/train/best.pt --precision int8 --calibrate runs/images
      autolights export runs/bundle/model.onnx --tensorrt
    """
    from autolights.core.atomic import refuse_existing
    from autolights.core.json_files import read_json_object

    if dla is not None and not tensorrt:
        raise UsageError("--dla is a choice of --tensorrt")
    width, cross, height = size.partition("x")
    if not (cross and width.isdigit() and height.isdigit()):
        raise UsageError(f"--size must read WIDTHxHEIGHT, e.g. 960x608, got {size!r}")
    _check_choice("--head", head, get_args(Head))
    _check_choice("--precision", precision, get_args(Precision))
    for free in dynamic or ():
        _check_choice("--dynamic", free, ("batch", "size"))
    tensorrt_work = _TensorRtWork(tensorrt, dla, check_tensorrt, compute_capability, force)
    if checkpoint.suffix == ".onnx":
        if not (tensorrt or check_tensorrt):
            raise UsageError(f"{checkpoint}: is exported already; give --tensorrt or --check-tensorrt, or a checkpoint")
        tensorrt_work.run(checkpoint, _describe(checkpoint))
        return

    from autolights.infer import ImageSources
    from autolights.train import export_onnx, load_checkpoint

    for path in (out, out.with_suffix(".json")):
        refuse_existing(path, force=force)
    tensorrt_work.refuse_existing_engine(out)
    report = export_onnx(
        load_checkpoint(checkpoint),
        out,
        size_wh=(int(width), int(height)),
        head=cast(Head, head),
        precision=cast(Precision, precision),
        int8=_int8_settings(calibrate, calibration, calibration_images, max_ap50_drop, int8_for)
        if precision == "int8"
        else None,
        half_io=half_io,
        dynamic_batch="batch" in (dynamic or ()),
        dynamic_size="size" in (dynamic or ()),
        opset=opset,
        score_threshold=score_threshold,
        nms_iou_threshold=nms_iou_threshold,
        max_detections=max_detections,
        images=[source.image_bgr for source in ImageSources(image)] if image else (),
        training=read_json_object(metrics) if metrics else None,
    )
    typer.echo(f"{out}: {json.dumps(report.info.parity)}")
    if report.info.accuracy:
        from autolights.train.deliver.int8 import accuracy_as_text

        typer.echo(accuracy_as_text(report.info.accuracy))
    tensorrt_work.run(out, report.info)


@dataclass(frozen=True)
class _TensorRtWork:
    """What `export` does beyond the ONNX file."""

    build: bool
    dla_core: int | None
    check: bool
    compute_capabilities: Sequence[str] | None
    force: bool

    def refuse_existing_engine(self, model_path: Path) -> None:
        from autolights.core.atomic import refuse_existing

        if self.build:
            refuse_existing(model_path.with_suffix(".engine"), force=self.force)

    def run(self, model_path: Path, info: ModelInfo) -> None:
        from autolights.core.progress import say
        from autolights.train.deliver.tensorrt_shapes import trtexec_command

        self.refuse_existing_engine(model_path)
        say(f"for TensorRT on the target: {trtexec_command(model_path, info)}")
        if self.check:
            from autolights.train.deliver.tensorrt_check import COMPUTE_CAPABILITIES, check_tensorrt

            checked = check_tensorrt(model_path, info, self.compute_capabilities or COMPUTE_CAPABILITIES)
            typer.echo(checked.to_text())
            checked.raise_if_refused()
        if self.build:
            from autolights.train.deliver.tensorrt_engine import build_engine

            built = build_engine(model_path, info, dla_core=self.dla_core)
            typer.echo(f"{model_path.with_suffix('.engine')}: {json.dumps(built.model_dump(mode='json'))}")


def _describe(model_path: Path) -> ModelInfo:
    """Of a model in a bundle, or of one with its description beside it."""
    from autolights.core import Bundle
    from autolights.core.bundle import MANIFEST
    from autolights.core.model_info import load_model_info

    if (model_path.parent / MANIFEST).is_file():
        return Bundle.load(model_path.parent).model
    return load_model_info(model_path)


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
    from autolights.core.progress import say
    from autolights.core.signal_lint import lint_signals
    from autolights.train import fit_hmm as fit

    refuse_existing(out, force=force)
    if prior not in ("uniform", "empirical"):
        raise UsageError(f"--prior must be uniform or empirical, got {prior!r}")
    description = load_signals(signals)
    for oddity in lint_signals(description):
        say(f"warning: {signals}: {oddity}")
    hmm = fit(
        ConfusionMatrix.load(confusion),
        description,
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


def _int8_settings(
    data: Path | None, calibration: str, images: int, max_ap50_drop: float, target: str
) -> "Int8Settings":
    from autolights.data import load_image_dataset
    from autolights.train.deliver.calibration import Calibration
    from autolights.train.deliver.int8 import Int8Settings
    from autolights.train.deliver.quantization import Int8Target

    if data is None:
        raise UsageError("--precision int8 needs --calibrate FOLDER with images to calibrate and to measure on")
    _check_choice("--calibration", calibration, get_args(Calibration))
    _check_choice("--int8-for", target, get_args(Int8Target))
    return Int8Settings(
        calibrate=load_image_dataset(data, "train"),
        validate=load_image_dataset(data, "val"),
        images=images,
        method=cast(Calibration, calibration),
        target=cast(Int8Target, target),
        max_ap50_drop=max_ap50_drop,
    )


def _read_overrides(path: Path) -> dict[str, Any]:
    from autolights.core.config import read_yaml

    values = read_yaml(path)
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: must hold fields by type of light, got {type(values).__name__}")
    return values


def _check_choice(option: str, value: str, choices: Sequence[str]) -> None:
    if value not in choices:
        raise UsageError(f"{option} must be {', '.join(choices[:-1])} or {choices[-1]}, got {value!r}")
