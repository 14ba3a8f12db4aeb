"""The benchmark suite of fusion and tracking: scenarios with known truth, a modelled detector, figures and targets."""

from autolights.suite.config import ScenarioConfig, SuiteConfig
from autolights.suite.figures import Figures
from autolights.suite.result import SuiteResult, default_pipelines, run_suite
from autolights.suite.tables import markdown

__all__ = [
    "Figures",
    "ScenarioConfig",
    "SuiteConfig",
    "SuiteResult",
    "default_pipelines",
    "markdown",
    "run_suite",
]
