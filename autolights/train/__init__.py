"""The training side: the only home of torch. Names are loaded when they are first used."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from autolights.train.config import TrainConfig
    from autolights.train.deliver.export import ExportReport, export_onnx
    from autolights.train.deliver.hmm_fitting import fit_hmm
    from autolights.train.deliver.int8 import Int8Settings
    from autolights.train.measure.curves import save_curves
    from autolights.train.measure.metrics import DetectionMetrics
    from autolights.train.measure.metrics_table import metrics_as_text
    from autolights.train.measure.onnx_model import ExportedModel
    from autolights.train.measure.prediction_sheet import save_sheet
    from autolights.train.measure.predictions import load_predictions, save_predictions
    from autolights.train.measure.validate import DatasetDetections, detect_dataset, evaluate_detector
    from autolights.train.network.model import YoloV5
    from autolights.train.network.network_info import NetworkInfo, describe_network
    from autolights.train.network.weights import load_checkpoint
    from autolights.train.run.dry_run import describe_run
    from autolights.train.run.engine import TrainResult, train

_HOMES = {
    "DatasetDetections": "measure.validate",
    "DetectionMetrics": "measure.metrics",
    "ExportReport": "deliver.export",
    "ExportedModel": "measure.onnx_model",
    "Int8Settings": "deliver.int8",
    "NetworkInfo": "network.network_info",
    "TrainConfig": "config",
    "TrainResult": "run.engine",
    "YoloV5": "network.model",
    "describe_network": "network.network_info",
    "describe_run": "run.dry_run",
    "detect_dataset": "measure.validate",
    "evaluate_detector": "measure.validate",
    "export_onnx": "deliver.export",
    "fit_hmm": "deliver.hmm_fitting",
    "load_checkpoint": "network.weights",
    "load_predictions": "measure.predictions",
    "metrics_as_text": "measure.metrics_table",
    "save_curves": "measure.curves",
    "save_predictions": "measure.predictions",
    "save_sheet": "measure.prediction_sheet",
    "train": "run.engine",
}

__all__ = [
    "DatasetDetections",
    "DetectionMetrics",
    "ExportReport",
    "ExportedModel",
    "Int8Settings",
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
