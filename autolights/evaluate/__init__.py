"""Scoring of runs against truth, tables, figures and the report.

`write_report` draws with matplotlib, which comes with ``autolights[train]``; it is loaded when it is first used.
"""

import importlib
from typing import TYPE_CHECKING, Any

from autolights.evaluate.outcomes import gather_outcomes
from autolights.evaluate.score import Evaluation, VariantScore, evaluate
from autolights.evaluate.summary_json import summary
from autolights.evaluate.tables import table

if TYPE_CHECKING:
    from autolights.evaluate.report import write_report

__all__ = ["Evaluation", "VariantScore", "evaluate", "gather_outcomes", "summary", "table", "write_report"]


def __getattr__(name: str) -> Any:
    if name != "write_report":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return importlib.import_module(f"{__name__}.report").write_report
