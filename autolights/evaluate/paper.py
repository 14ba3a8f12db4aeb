"""The published figures that ours stand beside (Wu et al. 2023, Tables II and III; one RTX 3090)."""

from dataclasses import dataclass

from autolights.core.estimates import Variant


@dataclass(frozen=True)
class PaperVariant:
    """A row of Table III."""

    name: str
    fps: float
    ape_m: float
    class_accuracy: float


@dataclass(frozen=True)
class PaperDetector:
    """A row of Table II; average precision from 0 to 1."""

    fps: float
    ap: float
    ap50: float
    ap75: float
    ap_s: float
    ap_m: float


PIPELINE: dict[Variant, PaperVariant] = {
    "od": PaperVariant("OD", 109, 1.19, 92.8),
    "fusion": PaperVariant("OD + Fusion", 57, 0.39, 92.8),
    "full": PaperVariant("OD + Fusion + Tracking", 54, 0.39, 96.0),
}

DETECTORS: dict[str, PaperDetector] = {
    "YOLOv5n": PaperDetector(163, 0.77, 0.93, 0.89, 0.74, 0.79),
    "YOLOv5s": PaperDetector(109, 0.77, 0.93, 0.86, 0.72, 0.82),
    "YOLOv5m": PaperDetector(54, 0.75, 0.92, 0.86, 0.71, 0.79),
}
