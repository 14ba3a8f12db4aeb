"""Scoring of runs against truth, tables, figures and the report. Figures and report need `autolights[train]`."""

from autolights.evaluate.outcomes import gather_outcomes
from autolights.evaluate.score import Evaluation, VariantScore, evaluate
from autolights.evaluate.table import ablation_table, detail_table

__all__ = ["Evaluation", "VariantScore", "ablation_table", "detail_table", "evaluate", "gather_outcomes"]
