"""The training side: the only home of torch. Names are loaded when they are first used."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from autolights.train.config import TrainConfig
    from autolights.train.curves import save_curves
    from autolights.train.dry_run import describe_run
    from autolights.train.engine import TrainResult, train
    from autolights.train.export import ExportReport, export_onnx
    from autolights.train.hmm_fitting import fit_hmm
    from autolights.train.metrics import DetectionMetrics
    from autolights.train.metrics_table import metrics_as_text
    from autolights.train.model import YoloV5
    from autolights.train.network_info import NetworkInfo, describe_network
    from autolights.train.prediction_sheet import save_sheet
    from autolights.train.predictions import load_predictions, save_predictions
    from autolights.train.validate import DatasetDetections, detect_dataset, evaluate_detector
    from autolights.train.weights import load_checkpoint

_HOMES = {
    "DatasetDetections": "validate",
    "DetectionMetrics": "metrics",
    "ExportReport": "export",
    "NetworkInfo": "network_info",
    "TrainConfig": "config",
    "TrainResult": "engine",
    "YoloV5": "model",
    "describe_network": "network_info",
    "describe_run": "dry_run",
    "detect_dataset": "validate",
    "evaluate_detector": "validate",
    "export_onnx": "export",
    "fit_hmm": "hmm_fitting",
    "load_checkpoint": "weights",
    "load_predictions": "predictions",
    "metrics_as_text": "metrics_table",
    "save_curves": "curves",
    "save_predictions": "predictions",
    "save_sheet": "prediction_sheet",
    "train": "engine",
}

__all__ = [
    "DatasetDetections",
    "DetectionMetrics",
    "ExportReport",
    "NetworkInfo",
    "TrainConfig",
    "TrainResult",
    "YoloV5",
    "describe_network",
    "describe_run",
    "detect_dataset",
    "evaluate_detector",
    "export_onnx",
    "fit_hmm",
    "load_checkpoint",
    "load_predictions",
    "metrics_as_text",
    "save_curves",
    "save_predictions",
    "save_sheet",
    "train",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
