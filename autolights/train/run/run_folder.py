"""The folder that a run leaves behind, in an order that survives being stopped between any two files."""

import contextlib
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

import autolights
from autolights.core.arrays import ImageArray
from autolights.core.atomic import new_file
from autolights.core.config import save_config
from autolights.core.json_files import write_json
from autolights.train.config import TrainConfig
from autolights.train.measure.curves import draw_curves
from autolights.train.measure.metrics import DetectionMetrics
from autolights.train.measure.prediction_sheet import prediction_sheet
from autolights.train.measure.validate import DatasetDetections
from autolights.train.network.checkpoint import Checkpoint
from autolights.train.run.run_log import Curves, EpochRow, write_results
from autolights.train.run.run_state import RunState

BEST, LAST, STATE = "best.pt", "last.pt", "state.pt"
CONFIG, ENVIRONMENT, METRICS, RESULTS = "config.yaml", "environment.json", "metrics.json", "results.csv"
BATCH, PREDICTIONS, CURVES, TENSORBOARD = "batch.jpg", "predictions.jpg", "pr_curves.png", "tensorboard"
_OUTPUTS = (BEST, LAST, STATE, CONFIG, ENVIRONMENT, METRICS, RESULTS, BATCH, PREDICTIONS, CURVES, TENSORBOARD)
_DRAW_EVERY_S = 60.0  # a short epoch takes less time than its pictures


@dataclass(frozen=True, eq=False)
class _Undrawn:
    """A validation that waits to be drawn."""

    epoch: int
    metrics: DetectionMetrics
    detections: DatasetDetections


class RunFolder:
    """Writes a run's files, epoch by epoch.

    Before its first whole epoch a run touches nothing, so that an earlier run in the folder survives until there is
    something to replace it. ``state.pt`` comes last: a run that is stopped before it repeats the epoch, with the same
    result.

    Attributes:
        path: Of the folder.
        epochs_kept: From which one a run would go on.
    """

    def __init__(
        self,
        path: Path,
        config: TrainConfig,
        environment: dict[str, Any],
        *,
        fingerprint: str,
        epochs_kept: int,
    ) -> None:
        """Make the folder if there is none.

        Args:
            path: Of the folder.
            config: Of the run.
            environment: Programs and machine.
            fingerprint: Of the data.
            epochs_kept: Of the run that this one goes on with; 0 to replace whatever is there.
        """
        self.path = path
        self.epochs_kept = epochs_kept
        self._config = config
        self._environment = {**environment, "data": fingerprint}
        self._fingerprint = fingerprint
        self._batch_picture: ImageArray | None = None
        self._curves: Curves | None = None
        self._undrawn: _Undrawn | None = None
        self._drawn_s = time.monotonic()
        path.mkdir(parents=True, exist_ok=True)
        for half_written in path.glob(".*.tmp"):  # by a process that was killed
            half_written.unlink()

    def picture_batch(self, image_rgb: ImageArray) -> None:
        """Show this with the first epoch."""
        self._batch_picture = image_rgb

    def keep(self, state: RunState, row: EpochRow, detections: DatasetDetections | None) -> None:
        """Write what an epoch has brought.

        Args:
            state: After the epoch.
            row: Its figures.
            detections: What they were counted from; None if the epoch was not validated.

        Raises:
            TrainingError: If the disk is full; the checkpoints of the epoch before are still there.
        """
        checkpoint = _checkpoint(state, row, self._config)
        checkpoint.save(self.path / LAST)
        if self._curves is None:
            self._begin()
            self._curves = Curves(self.path / TENSORBOARD, epochs_done=self.epochs_kept)
        if self._batch_picture is not None:
            self._show(BATCH, self._batch_picture, state.epoch)
            self._batch_picture = None
        if detections and row.metrics and state.best and state.best.epoch == state.epoch:
            checkpoint.save(self.path / BEST)
            write_json(self.path / METRICS, state.best.metrics)
            self._undrawn = _Undrawn(state.epoch, row.metrics, detections)
            if time.monotonic() - self._drawn_s >= _DRAW_EVERY_S:
                self._draw_best()
        write_results(self.path / RESULTS, state.rows)
        self._curves.epoch(row)
        state.save(self.path / STATE, self._config, self._fingerprint)
        self.epochs_kept = state.epoch

    def close(self) -> None:
        """Finish pictures and curves."""
        if self._curves:
            # No picture is worth an error in place of the one that ends the run.
            with contextlib.suppress(OSError):
                self._draw_best()
            self._curves.close()

    def _draw_best(self) -> None:
        """Draw the best epoch's validation, if that has not been done."""
        if self._undrawn:
            self._show(PREDICTIONS, prediction_sheet(self._undrawn.detections), self._undrawn.epoch)
            self._show(CURVES, draw_curves(self._undrawn.metrics), self._undrawn.epoch)
            self._undrawn, self._drawn_s = None, time.monotonic()

    def _show(self, name: str, image_rgb: ImageArray, epoch: int) -> None:
        """Write a picture, and put it among the curves."""
        assert self._curves is not None
        _write_picture(self.path / name, image_rgb)
        self._curves.picture(Path(name).stem, image_rgb, epoch)

    def _begin(self) -> None:
        """Remove what an earlier run left, unless this one goes on from it; nothing else is touched."""
        if not self.epochs_kept:
            for name in set(_OUTPUTS) - {LAST}:
                with contextlib.suppress(FileNotFoundError):
                    old = self.path / name
                    shutil.rmtree(old) if old.is_dir() else old.unlink()
        save_config(self._config, self.path / CONFIG, comment=f"autolights {autolights.__version__}")
        write_json(self.path / ENVIRONMENT, self._environment)


def _checkpoint(state: RunState, row: EpochRow, config: TrainConfig) -> Checkpoint:
    model = state.average.model
    return Checkpoint(
        size=model.size,
        classes=model.classes,
        state=dict(model.state_dict()),
        initial_weights=model.initial_weights,
        epoch=state.epoch,
        metrics=row.metrics.to_json() if row.metrics else {},
        config=config.model_dump(mode="json"),
        strides=model.strides,
    )


def _write_picture(path: Path, image_rgb: ImageArray) -> None:
    encoded, data = cv2.imencode(path.suffix, cv2.cvtColor(image_rgb, cv2.COLOR_RGB2BGR))
    assert encoded
    with new_file(path) as temporary:
        temporary.write_bytes(data.tobytes())
