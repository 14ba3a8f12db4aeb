"""All that a training run changes from step to step, and the file from which it goes on as if never stopped."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from torch.amp.grad_scaler import GradScaler
from torch.optim import Optimizer

import autolights
from autolights.core.errors import CheckpointError, ConfigError, DataError
from autolights.core.model_info import InitialWeights
from autolights.train.config import TrainConfig
from autolights.train.learning.ema import WeightAverage
from autolights.train.network.model import YoloV5
from autolights.train.network.tensor_file import read_tensors, save_tensors

FORMAT = "autolights-run-state"
FORMAT_VERSION = 1
# What may differ when a run goes on: where it computes, not what. The data are compared by their fingerprint.
MAY_DIFFER = frozenset({"data", "device", "workers", "threads", "cache_mb", "cache_dir", "compile"})


@dataclass(frozen=True)
class Best:
    """The best epoch so far.

    Attributes:
        epoch: From 1; of equally good ones the last.
        reached: The first epoch that was as good.
        fitness: By which epochs are compared.
        metrics: Its figures, as in ``metrics.json``.
    """

    epoch: int
    reached: int
    fitness: float
    metrics: dict[str, Any]


@dataclass(eq=False)
class RunState:
    """A training run between two steps.

    Attributes:
        model: The network that is trained.
        average: Its moving average, which is validated and saved.
        optimizer: With momenta.
        scaler: Of fp16 losses; does nothing in other precisions.
        epoch: Whole epochs so far.
        step: Batches so far.
        summed_batches: Those whose gradients wait for the optimiser's next step; an epoch may end in between.
        best: None before the first validation.
        rows: Lines of ``results.csv`` so far, by column.
    """

    model: YoloV5
    average: WeightAverage
    optimizer: Optimizer
    scaler: GradScaler
    epoch: int = 0
    step: int = 0
    summed_batches: int = 0
    best: Best | None = None
    rows: list[dict[str, str]] = field(default_factory=list)

    def save(self, path: Path, config: TrainConfig, fingerprint: str) -> None:
        """Write everything in full precision.

        Args:
            path: Of the file.
            config: Of the run.
            fingerprint: Of its data.

        Raises:
            TrainingError: If the disk is full; the state of the epoch before is still there.
        """
        initial = self.model.initial_weights
        values = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "program_version": autolights.__version__,
            "config": config.model_dump(mode="json"),
            "fingerprint": fingerprint,
            "initial_weights": None if initial is None else initial.model_dump(),
            "model": self.model.state_dict(),
            "average": self.average.model.state_dict(),
            "updates": self.average.updates,
            "optimizer": self.optimizer.state_dict(),
            "scaler": self.scaler.state_dict(),
            "gradients": [parameter.grad for parameter in self.model.parameters()] if self.summed_batches else [],
            "epoch": self.epoch,
            "step": self.step,
            "summed_batches": self.summed_batches,
            "best": asdict(self.best) if self.best else None,
            "rows": self.rows,
        }
        save_tensors(values, path)


@dataclass(frozen=True, eq=False)
class SavedState:
    """What `RunState.save` wrote, checked against what is to go on.

    Attributes:
        path: Of the file.
        values: What it holds.
    """

    path: Path
    values: dict[str, Any]

    @classmethod
    def read(cls, path: Path) -> "SavedState":
        """Read a file.

        Raises:
            CheckpointError: If it is damaged, something else, or of a newer format.
        """
        values = read_tensors(path)
        if values.get("format") != FORMAT:
            raise CheckpointError(f"{path}: not the state of a training run")
        if values["format_version"] > FORMAT_VERSION:
            raise CheckpointError(
                f"{path}: format {values['format_version']} is newer than {FORMAT_VERSION}; upgrade autolights"
            )
        return cls(path, values)

    @property
    def epoch(self) -> int:
        """Whole epochs so far."""
        return int(self.values["epoch"])

    @property
    def best(self) -> Best | None:
        """See `RunState`."""
        best = self.values["best"]
        return Best(**best) if best else None

    def check_config(self, config: TrainConfig) -> None:
        """Refuse to go on with other settings: the result would be neither run's.

        Raises:
            ConfigError: If a setting differs that decides what comes out; the text names it.
        """
        saved, wanted = _flat(self.values["config"]), _flat(config.model_dump(mode="json"))
        differing = sorted(
            key
            for key in saved.keys() | wanted.keys()
            if key.partition(".")[0] not in MAY_DIFFER and saved.get(key) != wanted.get(key)
        )
        if not differing:
            return
        shown = ", ".join(f"{key} was {saved.get(key)!r}, now {wanted.get(key)!r}" for key in differing)
        raise ConfigError(
            f"{self.path}: cannot go on with other settings: {shown}; rates follow the whole run, so to train "
            f"further or otherwise start a new run with weights={self.path.with_name('last.pt')}"
        )

    def check_data(self, fingerprint: str) -> None:
        """Refuse to go on with other data.

        Raises:
            DataError: If the fingerprint differs.
        """
        if fingerprint != self.values["fingerprint"]:
            raise DataError(
                f"{self.path}: cannot go on, images or labels have changed since the run began; restore them or start "
                "a new run"
            )

    def restore(self, state: RunState) -> None:
        """Bring a newly started run to where the saved one was.

        Raises:
            CheckpointError: If the tensors do not fit.
        """
        values = self.values
        try:
            state.model.load_state_dict(values["model"])
            state.average.model.load_state_dict(values["average"])
            state.optimizer.load_state_dict(values["optimizer"])
            state.scaler.load_state_dict(values["scaler"])
            if values["gradients"]:
                for parameter, gradient in zip(state.model.parameters(), values["gradients"], strict=True):
                    parameter.grad = gradient.to(parameter.device)
        except (RuntimeError, ValueError) as error:
            raise CheckpointError(f"{self.path}: does not fit the network ({error}); the file is damaged") from error
        initial = values["initial_weights"]
        weights = None if initial is None else InitialWeights.model_validate(initial)
        state.model.initial_weights = state.average.model.initial_weights = weights
        state.average.updates = values["updates"]
        state.epoch, state.step = values["epoch"], values["step"]
        state.summed_batches = values["summed_batches"]
        state.best, state.rows = self.best, values["rows"]


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """``{"loss": {"box_gain": 1}}`` → ``{"loss.box_gain": 1}``."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat
