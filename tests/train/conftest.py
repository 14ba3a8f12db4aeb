"""Runs of seconds: a handful of 64-pixel images with one bright light each."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from autolights.train.config import TrainConfig
from autolights.train.run.run_folder import RunFolder


@pytest.fixture(scope="session")
def lights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Lights of 16 × 32 px, red or green, on noise; 12 images to train on, 4 held out."""
    root = tmp_path_factory.mktemp("lights")
    rng = np.random.default_rng(5)
    for split, count in (("train", 12), ("val", 4)):
        for part in ("images", "labels"):
            (root / part / split).mkdir(parents=True)
        for i in range(count):
            image = rng.integers(0, 80, (64, 64, 3), dtype=np.uint8)
            left, top = rng.integers(4, 40), rng.integers(4, 28)
            image[top : top + 32, left : left + 16] = (0, 255, 0) if i % 2 else (0, 0, 255)
            cv2.imwrite(str(root / f"images/{split}/{i}.png"), image)
            label = f"{i % 2} {(left + 8) / 64} {(top + 16) / 64} {16 / 64} {32 / 64}\n"
            (root / f"labels/{split}/{i}.txt").write_text(label)
    (root / "data.yaml").write_text("names: [red, green]\ntrain: images/train\nval: images/val\n")
    return root


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the pictures of a validation: they take longer than such a run."""
    monkeypatch.setattr(RunFolder, "_draw_best", lambda self: None)


@pytest.fixture
def tiny(lights: Path) -> Callable[..., TrainConfig]:
    """The configuration of a run of about a second on `lights`."""

    def make(**settings: Any) -> TrainConfig:
        values = {
            "data": str(lights),
            "weights": "",
            "image_size": 64,
            "epochs": 2,
            "batch": 6,
            "nominal_batch": 6,
            "workers": 0,
            "optimizer": {"kind": "adamw"},
            "schedule": {"kind": "cosine", "max_rate": 0.004, "warmup_epochs": 0},
            **settings,
        }
        return TrainConfig(**values)

    return make
