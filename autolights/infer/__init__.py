"""From an image to detections: letterbox, ONNX Runtime, decoding."""

from autolights.infer.decode import decode
from autolights.infer.detector import Detector
from autolights.infer.draw import draw_detections
from autolights.infer.execution import Execution
from autolights.infer.letterbox import Letterbox, rectangle_for
from autolights.infer.region import Region
from autolights.infer.session import OnnxSession
from autolights.infer.sources import ImageSources

__all__ = [
    "Detector",
    "Execution",
    "ImageSources",
    "Letterbox",
    "OnnxSession",
    "Region",
    "decode",
    "draw_detections",
    "rectangle_for",
]
