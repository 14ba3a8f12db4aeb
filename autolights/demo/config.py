"""Settings of the main job: which configurations its stages take."""

from pydantic import Field

from autolights.core.config import Config


class StageConfig(Config):
    """A shipped or own configuration file with dotted overrides."""

    config: str
    overrides: tuple[str, ...] = ()


class DemoConfig(Config):
    """The whole way from nothing to a report.

    Attributes:
        images: Simulated training and validation images.
        drives: Simulated test drives, which neither training nor the confusion matrix sees.
        train: Fine-tuning on the images.
        runtime: The pipeline's settings.
        input_size_wh: Of the exported network, pixels; multiples of 32.
        score_threshold: Of the runtime and of the confusion matrix.
        pseudocount: Added to each cell of the confusion matrix before the HMMs are fitted, in counts.
        frame_rate_hz: Nominal, for the transition matrices that are given per frame.
        threads: Of ONNX Runtime; 0 leaves the choice to it.
    """

    images: StageConfig
    drives: StageConfig
    train: StageConfig
    runtime: StageConfig
    signals: str = "signals/autolights_13"
    input_size_wh: tuple[int, int]
    score_threshold: float = Field(gt=0, lt=1)
    pseudocount: float = Field(default=1.0, gt=0)
    frame_rate_hz: float = Field(default=10.0, gt=0)
    threads: int = Field(default=0, ge=0)
