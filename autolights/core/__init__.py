"""What all parts share: geometry, signals, maps, the types that travel between parts, files and errors."""

from autolights.core.arrays import BoolArray, FloatArray, ImageArray, IntArray
from autolights.core.bundle import Bundle
from autolights.core.camera import CameraModel, back_project, project_points
from autolights.core.config import Config, find_config, load_config, parse_config, save_config
from autolights.core.confusion import ConfusionMatrix, CountedWith
from autolights.core.detections import Detections
from autolights.core.estimates import CameraView, LightEstimate
from autolights.core.frames import CameraFrame
from autolights.core.hmm import Certainty, HmmParameters, load_hmm, save_hmm
from autolights.core.light_map import TrafficLightMap
from autolights.core.model_info import InitialWeights, ModelInfo
from autolights.core.pose import Pose, PoseBuffer
from autolights.core.signals import FlashingPair, Lamp, LightType, SignalSet, SignalState, load_signals

__all__ = [
    "BoolArray",
    "Bundle",
    "CameraFrame",
    "CameraModel",
    "CameraView",
    "Certainty",
    "Config",
    "ConfusionMatrix",
    "CountedWith",
    "Detections",
    "FlashingPair",
    "FloatArray",
    "HmmParameters",
    "ImageArray",
    "InitialWeights",
    "IntArray",
    "Lamp",
    "LightEstimate",
    "LightType",
    "ModelInfo",
    "Pose",
    "PoseBuffer",
    "SignalSet",
    "SignalState",
    "TrafficLightMap",
    "back_project",
    "find_config",
    "load_config",
    "load_hmm",
    "load_signals",
    "parse_config",
    "project_points",
    "save_config",
    "save_hmm",
]
