"""The benchmark suite of fusion and tracking: scenarios with known truth, a modelled detector, figures and targets."""

from autolights.suite.config import ScenarioConfig, SuiteConfig
from autolights.suite.figures import Figures
from autolights.suite.recorded import RecordedDrive, record
from autolights.suite.result import SuiteResult, default_pipelines, run_recorded, run_suite
from autolights.suite.tables import comparison, markdown

__all__ = [
    "Figures",
    "RecordedDrive",
    "ScenarioConfig",
    "SuiteConfig",
    "SuiteResult",
    "comparison",
    "default_pipelines",
    "markdown",
    "record",
    "run_recorded",
    "run_suite",
]
