"""What the suite runs: scenarios with frozen seeds, the detector model and the matrix that C is fitted from."""

from typing import Literal

from pydantic import Field

from autolights.core.config import Config
from autolights.sim.config import NARROW, WIDE, CameraConfig, PoseConfig
from autolights.sim.detector_model import DetectorModelConfig
from autolights.sim.script import START_M

Range = tuple[float, float]


class MapErrors(Config):
    """How the map differs from the town.

    Attributes:
        noise_m: Standard deviation of a light's position per axis.
        heading_noise_deg: Standard deviation of its heading.
        missing_share: Share of the lights that are not in the map.
        extra_per_junction: Lights that were taken down and are still in the map.
        moved_share: Share of the lights that have been moved since the survey.
        moved_m: How far, across the road.
    """

    noise_m: float = Field(default=0.1, ge=0)
    heading_noise_deg: float = Field(default=1.0, ge=0)
    missing_share: float = Field(default=0.0, ge=0, lt=1)
    extra_per_junction: int = Field(default=0, ge=0)
    moved_share: float = Field(default=0.0, ge=0, le=1)
    moved_m: float = Field(default=1.0, ge=0)


class ScenarioConfig(Config):
    """One scenario: what is ordinary stays as it is by default.

    Attributes:
        about: One line for the table.
        drives: How many, each with its own seed.
        duration_s: Of each drive.
        junctions: How many the road has; the drive may end before the last.
        layouts: Types over our lanes, from left to right; drawn for each junction.
        row_spacing_m: If set, the lights over our lanes hang so far apart.
        rows: How many rows of lights over our lanes hang above each other.
        junction_spacing_m: If set, all junctions are so far apart and have the same layout.
        start_m: Where the drive starts; the first stop line is at 0.
        programme: ``ordinary``; ``flashing_red``: red balls flash in the crossing phase; ``steady``: nothing flashes,
            left turns are protected instead.
        signals: Signal description.
        frame_rate_hz: Sets of frames per second.
        cruise_mps: Speed on the open road; 0 stands still.
        occlusions_per_minute: Of each junction: a lorry's edge sweeps over its lights, hides them and frees them.
        occlusion_s: How long each light stays hidden, edge to edge.
        mounting_error_deg: Each camera is turned by this, about a vertical or (every third drive) a lateral axis, and
            the calibration does not know it.
        pose_error_m: Constant horizontal error of the poses.
        dropped_share: Of the camera frames that never arrive.
        dead_camera: Name of the camera that stops in the middle of the drive.
        late_share: Of the wide camera's frames that arrive late, alone and out of order.
        late_sets: How many sets later.
        lookalikes_per_junction: Things that look like lights, in the world.
        map_errors: Of the map.
        poses: Of the localisation.
        detector: Settings of the detector model that differ.
        ablation: Whether detections alone, fusion alone and the paper's rules run here too.
        recordable: Whether recorded drives can have it: of them only mounting, poses and arrival are disturbed.
        counts_for_accuracy: Whether the scenario is part of the suite's class accuracy (10 frames a second and more).
    """

    about: str
    drives: int = Field(default=2, ge=1)
    duration_s: float = Field(default=60.0, gt=0)
    junctions: int = Field(default=6, ge=1)
    layouts: tuple[tuple[str, ...], ...] = (("4", "3", "5dh"), ("4", "3", "3"), ("5dh", "3", "3"), ("4", "5dh", "3"))
    row_spacing_m: float | None = Field(default=None, gt=0)
    programme: Literal["ordinary", "steady", "flashing_red"] = "ordinary"
    signals: str = "signals/autolights_13"
    rows: int = Field(default=1, ge=1, le=4)
    junction_spacing_m: float | None = Field(default=None, ge=22)
    start_m: float = START_M
    frame_rate_hz: float = Field(default=10.0, gt=0, le=60)
    cruise_mps: float = Field(default=9.0, ge=0)
    occlusions_per_minute: float = Field(default=3.0, ge=0)
    occlusion_s: Range = (0.2, 0.8)
    mounting_error_deg: float = Field(default=0.0, ge=0)
    pose_error_m: float = Field(default=0.0, ge=0)
    dropped_share: float = Field(default=0.0, ge=0, lt=1)
    dead_camera: str | None = None
    late_share: float = Field(default=0.0, ge=0, lt=1)
    late_sets: int = Field(default=2, ge=1)
    lookalikes_per_junction: int = Field(default=0, ge=0)
    map_errors: MapErrors = MapErrors()
    poses: PoseConfig = PoseConfig(rate_hz=50, slow_position_m=0.03, slow_rotation_deg=0.04)
    detector: dict[str, float] = Field(default_factory=dict)
    ablation: bool = True
    recordable: bool = False
    counts_for_accuracy: bool = True


class SuiteConfig(Config):
    """The whole suite.

    Attributes:
        seed: Same seed, same drives and same errors of the detector.
        cameras: The rig.
        stamp_jitter_ms: Standard deviation of each image's own stamp.
        truth_range_m: Lights farther away are neither in the truth nor detected.
        detector: The detector model.
        confusion: Class → class that it is taken for → rate, of the validation set: from it C is fitted.
        confusion_lights: Lights of each class in that validation set.
        confusion_miss_rate: Share of them that were missed.
        confusion_spread: The detector on the road errs otherwise: each rate times a log-normal factor of this spread.
        pseudocount: Of the fit.
        scenarios: By name.
    """

    seed: int = 2026
    cameras: tuple[CameraConfig, ...] = (NARROW, WIDE)
    stamp_jitter_ms: float = Field(default=0.3, ge=0)
    truth_range_m: float = Field(default=130.0, gt=0)
    detector: DetectorModelConfig = DetectorModelConfig()
    confusion: dict[str, dict[str, float]]
    confusion_lights: int = Field(default=400, ge=1)
    confusion_miss_rate: float = Field(default=0.05, ge=0, lt=1)
    confusion_spread: float = Field(default=0.6, ge=0)
    pseudocount: float = Field(default=1.0, gt=0)
    scenarios: dict[str, ScenarioConfig] = Field(min_length=1)
