"""The shipped base checkpoint: free of outside weights, small, and able to see."""

import numpy as np

from autolights.core import load_signals
from autolights.train.network.weights import BASE_PATH, read_checkpoint


def test_base_checkpoint_is_small_and_free() -> None:
    assert BASE_PATH.stat().st_size <= 8_000_000
    checkpoint = read_checkpoint(BASE_PATH)
    assert checkpoint.size == "n"
    assert checkpoint.classes == load_signals().classes
    assert checkpoint.initial_weights is None or checkpoint.initial_weights.licence == "Apache-2.0"
    assert all(np.isfinite(tensor.float().numpy()).all() for tensor in checkpoint.state.values())
