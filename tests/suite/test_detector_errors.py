import numpy as np
import pytest

from autolights.suite import SuiteConfig
from autolights.suite.detector_errors import detector_errors
from autolights.suite.drives import build_drive


def test_the_model_errs_as_it_is_told(suite: SuiteConfig) -> None:
    told = {
        "error_scale": 2.0, "persistence_s": 0.6, "miss_persistence_s": 0.3, "camera_correlation": 0.7,
        "miss_rate": 0.1, "small_height_px": 0.0, "edge_sigma_px": 2.0, "edge_sigma_share": 0.0,
    }  # fmt: skip
    scenario = suite.scenarios["plain"].model_copy(
        update={
            "detector": told,
            "duration_s": 240.0,
            "start_m": -10.0,
            "cruise_mps": 0.0,
            "occlusions_per_minute": 0.0,
        }
    )
    drive = build_drive(suite.model_copy(update={"scenarios": {"plain": scenario}}), "plain", 0)
    of = detector_errors([drive], min_score=0.0)
    assert of.seen > 10_000
    assert of.missed["64 px and more"] == pytest.approx(0.1, abs=0.02)
    # Sampled at 10 Hz a run is the longer by half a frame, and a change of the light may end or begin one.
    assert of.error_s == pytest.approx(0.65, abs=0.12)
    assert of.miss_s == pytest.approx(0.35, abs=0.06)
    assert of.error_correlation == pytest.approx(0.7, abs=0.1)
    assert of.miss_correlation == pytest.approx(0.7, abs=0.1)
    assert of.edge_px == pytest.approx(2.0, abs=0.1)
    assert of.wrong_scores < of.right_scores


def test_nothing_seen_says_nothing() -> None:
    of = detector_errors([])
    assert of.seen == 0
    assert np.isnan(of.class_error)
    assert np.isnan(of.error_correlation)
    assert of.right_scores == ()
