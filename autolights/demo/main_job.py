"""The main job: every verb in its order, from nothing to a report."""

from pathlib import Path
from typing import Any

from autolights.core import Bundle, ConfusionMatrix, load_config, load_hmm, load_signals, save_hmm
from autolights.core.atomic import refuse_existing, sha256
from autolights.core.json_files import read_json_object, write_json
from autolights.core.model_info import load_model_info
from autolights.data import Drive, load_image_dataset
from autolights.demo.config import DemoConfig
from autolights.demo.stages import Stages
from autolights.evaluate import Evaluation, evaluate, summary, write_report
from autolights.infer import Execution
from autolights.pipeline import PipelineConfig
from autolights.run_drive import run_drive
from autolights.sim import DrivesConfig, ImagesConfig, simulate_drives, simulate_images
from autolights.train import TrainConfig, evaluate_detector, export_onnx, fit_hmm, load_checkpoint, train
from autolights.train.network.weights import weights_path

_PARITY_IMAGES = 4  # real images on which the export is compared with the network, beside random ones


def run_demo(config: DemoConfig, out_dir: Path) -> dict[str, Any]:
    """Run the main job into `out_dir`; what is there and unchanged is kept.

    Args:
        config: What the stages take.
        out_dir: Gets images/, drives/, train/, val/, export/, bundle/, estimates/, summary.json and report.html.

    Returns:
        The summary, as in ``summary.json``.

    Raises:
        UsageError: If `out_dir` holds something that is no demo.
        AutolightsError: As the stages do; a later call goes on with the stage that failed.
    """
    stages = Stages(out_dir)
    if not stages.known:
        refuse_existing(out_dir, force=False)
    return _MainJob(config, out_dir).run(stages)


class _MainJob:
    """Where everything lies, and a method for each stage."""

    def __init__(self, config: DemoConfig, out_dir: Path) -> None:
        self.config = config
        self.signals = load_signals(config.signals)
        self.images, self.drives, self.training = out_dir / "images", out_dir / "drives", out_dir / "train"
        self.metrics, self.confusion = out_dir / "val" / "metrics.json", out_dir / "val" / "confusion.json"
        self.model, self.hmm = out_dir / "export" / "model.onnx", out_dir / "export" / "hmm.json"
        self.bundle, self.estimates = out_dir / "bundle", out_dir / "estimates"
        self.evaluation = out_dir / "evaluation.json"
        self.report, self.summary = out_dir / "report.html", out_dir / "summary.json"
        self.images_config = load_config(config.images.config, ImagesConfig, config.images.overrides)
        self.drives_config = load_config(config.drives.config, DrivesConfig, config.drives.overrides)
        train_overrides = [*config.train.overrides, f"data={self.images}"]
        self.train_config = load_config(config.train.config, TrainConfig, train_overrides)
        self.runtime_config = load_config(config.runtime.config, PipelineConfig, config.runtime.overrides)

    def run(self, stages: Stages) -> dict[str, Any]:
        """All stages; each depends on its settings and on all stages before it."""
        config, weights = self.config, self.train_config.weights
        initial = sha256(weights_path(weights)) if weights else ""
        input_settings = [config.input_size_wh, config.score_threshold]
        hmm_settings = [config.pseudocount, config.frame_rate_hz, self.signals.model_dump(mode="json")]
        run_settings = [config.threads, self.runtime_config.model_dump(mode="json")]
        stages.run("images", [self.images], self.images_config.model_dump(mode="json"), self._simulate_images)
        stages.run("drives", [self.drives], self.drives_config.model_dump(mode="json"), self._simulate_drives)
        stages.run("train", [self.training], [initial, self.train_config.model_dump(mode="json")], self._train)
        stages.run("val", [self.metrics, self.confusion], input_settings, self._validate)
        stages.run("export", [self.model, self.model.with_suffix(".json")], input_settings, self._export)
        stages.run("fit-hmm", [self.hmm], hmm_settings, self._fit_hmm)
        stages.run("bundle", [self.bundle], None, self._bundle)
        stages.run("run", [self.estimates], run_settings, self._run_drives)
        stages.run(
            "evaluate", [self.evaluation], None, lambda: evaluate(self._runs(), self.signals).save(self.evaluation)
        )
        stages.run("report", [self.report], None, lambda: self._report(stages.minutes))
        stages.run("summary", [self.summary], None, lambda: self._summarise(stages.minutes))
        return read_json_object(self.summary)

    def _simulate_images(self) -> None:
        simulate_images(self.images_config, self.images, force=True)

    def _simulate_drives(self) -> None:
        simulate_drives(self.drives_config, self.drives, force=True)

    def _train(self) -> None:
        train(self.train_config, self.training, force=True)

    def _validate(self) -> None:
        metrics = evaluate_detector(
            load_checkpoint(self.training / "best.pt"),
            load_image_dataset(self.images, "val"),
            long_side=max(self.config.input_size_wh),
            score_threshold=self.config.score_threshold,
        )
        metrics.save(self.metrics)
        metrics.confusion.save(self.confusion)

    def _export(self) -> None:
        dataset = load_image_dataset(self.images, "val")
        export_onnx(
            load_checkpoint(self.training / "best.pt"),
            self.model,
            size_wh=self.config.input_size_wh,
            score_threshold=self.config.score_threshold,
            images=[dataset.read(i) for i in range(min(_PARITY_IMAGES, len(dataset)))],
            training=read_json_object(self.metrics),
        )

    def _fit_hmm(self) -> None:
        hmm = fit_hmm(
            ConfusionMatrix.load(self.confusion),
            self.signals,
            nominal_dt_s=1 / self.config.frame_rate_hz,
            pseudocount=self.config.pseudocount,
        )
        save_hmm(self.hmm, hmm)

    def _bundle(self) -> None:
        bundle = Bundle(
            model=load_model_info(self.model),
            model_path=self.model,
            signals=self.signals,
            hmm=load_hmm(self.hmm),
            confusion=ConfusionMatrix.load(self.confusion),
        )
        bundle.save(self.bundle, force=True)

    def _runs(self) -> list[tuple[Path, Path]]:
        """(results, drive) of each drive."""
        drives = sorted(path.parent for path in self.drives.glob("*/drive.yaml"))
        return [(self.estimates / drive.name, drive) for drive in drives]

    def _run_drives(self) -> None:
        bundle = Bundle.load(self.bundle)
        for run_dir, drive_dir in self._runs():
            drive = Drive.load(drive_dir, bundle.signals)
            threads = self.config.threads or None
            execution = Execution.for_images(len(drive.cameras), threads=threads) if threads else None
            run_drive(bundle, drive, self.runtime_config, run_dir, execution=execution, force=True)

    def _report(self, minutes: dict[str, float]) -> None:
        write_report(
            self.report,
            train_dir=self.training,
            metrics_path=self.metrics,
            bundle=Bundle.load(self.bundle),
            runs=self._runs(),
            evaluation=Evaluation.load(self.evaluation),
            minutes=minutes,
            title="autolights demo",
        )

    def _summarise(self, minutes: dict[str, float]) -> None:
        write_json(self.summary, summary(Evaluation.load(self.evaluation), self.metrics, minutes))
