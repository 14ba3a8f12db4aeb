"""The main job: every verb in its order, from nothing to a report."""

from pathlib import Path
from typing import Any

from autolights.core import Bundle, ConfusionMatrix, load_config, load_hmm, load_signals, save_hmm
from autolights.core.bundle import load_model_info
from autolights.core.json_files import read_json_object, write_json
from autolights.data import Drive, load_image_dataset
from autolights.demo.config import DemoConfig
from autolights.demo.stages import Stages
from autolights.evaluate import evaluate, summary, write_report
from autolights.pipeline import PipelineConfig
from autolights.run_drive import run_drive
from autolights.sim import DrivesConfig, ImagesConfig, simulate_drives, simulate_images
from autolights.train import TrainConfig, evaluate_detector, export_onnx, fit_hmm, load_checkpoint, train

_PARITY_IMAGES = 4  # real images on which the export is compared with the network, beside random ones


def run_demo(config: DemoConfig, out_dir: Path) -> dict[str, Any]:
    """Run the main job into `out_dir`; what is there and unchanged is kept.

    Args:
        config: What the stages take.
        out_dir: Gets images/, drives/, train/, val/, export/, bundle/, estimates/, summary.json and report.html.

    Returns:
        The summary, as in ``summary.json``.

    Raises:
        AutolightsError: As the stages do; a later call goes on with the stage that failed.
    """
    signals = load_signals(config.signals)
    images_config = load_config(config.images.config, ImagesConfig, config.images.overrides)
    drives_config = load_config(config.drives.config, DrivesConfig, config.drives.overrides)
    images, drives, training = out_dir / "images", out_dir / "drives", out_dir / "train"
    train_config = load_config(config.train.config, TrainConfig, [*config.train.overrides, f"data={images}"])
    runtime_config = load_config(config.runtime.config, PipelineConfig, config.runtime.overrides)
    validation, export, bundle_dir, estimates = (out_dir / name for name in ("val", "export", "bundle", "estimates"))
    model_path, hmm_path = export / "model.onnx", export / "hmm.json"
    stages = Stages(out_dir)

    stages.run(
        "images",
        [images],
        images_config.model_dump(mode="json"),
        lambda: simulate_images(images_config, images, force=True),
    )
    stages.run(
        "drives",
        [drives],
        drives_config.model_dump(mode="json"),
        lambda: simulate_drives(drives_config, drives, force=True),
    )
    stages.run(
        "train",
        [training],
        train_config.model_dump(mode="json"),
        lambda: train(train_config, training, force=True),
    )

    def validate() -> None:
        metrics = evaluate_detector(
            load_checkpoint(training / "best.pt"),
            load_image_dataset(images, "val"),
            long_side=max(config.input_size_wh),
            score_threshold=config.score_threshold,
        )
        metrics.save(validation / "metrics.json")
        metrics.confusion.save(validation / "confusion.json")

    input_settings = [config.input_size_wh, config.score_threshold]
    stages.run("val", [validation], input_settings, validate)

    def make_export() -> None:
        metrics = read_json_object(validation / "metrics.json")
        dataset = load_image_dataset(images, "val")
        export_onnx(
            load_checkpoint(training / "best.pt"),
            model_path,
            size_wh=config.input_size_wh,
            score_threshold=config.score_threshold,
            images=[dataset.read(i) for i in range(min(_PARITY_IMAGES, len(dataset)))],
            training={name: metrics[name] for name in ("ap", "ap50", "ap75", "ap_s", "ap_m", "images", "labels")},
        )

    stages.run("export", [model_path, model_path.with_suffix(".json")], input_settings, make_export)
    stages.run(
        "fit-hmm",
        [hmm_path],
        [config.pseudocount, config.frame_rate_hz, signals.model_dump(mode="json")],
        lambda: save_hmm(
            hmm_path,
            fit_hmm(
                ConfusionMatrix.load(validation / "confusion.json"),
                signals,
                nominal_dt_s=1 / config.frame_rate_hz,
                pseudocount=config.pseudocount,
            ),
        ),
    )
    stages.run(
        "bundle",
        [bundle_dir],
        None,
        lambda: Bundle(
            model=load_model_info(model_path),
            model_path=model_path,
            signals=signals,
            hmm=load_hmm(hmm_path),
            confusion=ConfusionMatrix.load(validation / "confusion.json"),
        ).save(bundle_dir, force=True),
    )

    drive_dirs = sorted(path.parent for path in drives.glob("*/drive.yaml"))
    runs = [(estimates / drive_dir.name, drive_dir) for drive_dir in drive_dirs]

    def run_all() -> None:
        bundle = Bundle.load(bundle_dir)
        for run_dir, drive_dir in runs:
            drive = Drive.load(drive_dir, bundle.signals)
            run_drive(bundle, drive, runtime_config, run_dir, threads=config.threads or None, force=True)

    stages.run("run", [run_dir for run_dir, _ in runs], runtime_config.model_dump(mode="json"), run_all)
    evaluation_path = out_dir / "evaluation.json"
    stages.run("evaluate", [evaluation_path], None, lambda: evaluate(runs, signals).save(evaluation_path))
    report_path, summary_path = out_dir / "report.html", out_dir / "summary.json"

    def report() -> None:
        evaluation = evaluate(runs, signals)
        write_json(summary_path, summary(evaluation, validation / "metrics.json", stages.minutes))
        write_report(
            report_path,
            train_dir=training,
            metrics_path=validation / "metrics.json",
            bundle=Bundle.load(bundle_dir),
            runs=runs,
            evaluation=evaluation,
            minutes=stages.minutes,
            title="autolights demo",
        )

    stages.run("report", [report_path, summary_path], None, report)
    return read_json_object(summary_path)
