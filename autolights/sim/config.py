"""Every number of the simulation, with its unit; YAML files in ``configs/sim`` fill these models."""

from typing import Literal

from pydantic import Field

from autolights.core.config import Config

LightingName = Literal["sunny", "overcast", "low_sun", "dusk"]
DisturbanceKind = Literal["washout", "faint", "sunlit", "veil"]
Range = tuple[float, float]


def _disturbance_kinds() -> dict[DisturbanceKind, float]:
    return {"washout": 0.5, "faint": 0.2, "sunlit": 0.2, "veil": 0.1}


def _lighting_shares() -> dict[LightingName, float]:
    return {"sunny": 0.35, "overcast": 0.3, "low_sun": 0.15, "dusk": 0.2}


class CameraConfig(Config):
    """One camera of the rig.

    Attributes:
        name: In calibration and frame lists.
        size_wh: Pixels.
        horizontal_fov_deg: Of the pinhole, distortion left aside.
        distortion: k1, k2, p1, p2 (Brown-Conrady).
        max_range_m: Lights farther away are not expected from it.
        position_m: In the vehicle frame: forward, left, up.
        pitch_deg: Upwards.
        yaw_deg: To the left.
        roll_deg: Clockwise as the camera sees it.
        stamp_offset_ms: How much later than the set's nominal time it exposes.
    """

    name: str
    size_wh: tuple[int, int] = (1280, 800)
    horizontal_fov_deg: float = Field(gt=10, lt=120)
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    max_range_m: float = Field(gt=0)
    position_m: tuple[float, float, float] = (0.6, 0.0, 1.1)
    pitch_deg: float = 2.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    stamp_offset_ms: float = Field(default=0.0, ge=0)


# Wu et al. 2023, Sec. V: 47.3 degrees to 64 m and 85.7 degrees to 30 m. Mounting and lens are plausible inventions.
NARROW = CameraConfig(
    name="narrow",
    horizontal_fov_deg=47.3,
    distortion=(-0.08, 0.03, 0.0004, -0.0003),
    max_range_m=64.0,
    position_m=(0.62, 0.12, 1.1),
    pitch_deg=2.6,
    yaw_deg=0.3,
    roll_deg=0.2,
)
WIDE = CameraConfig(
    name="wide",
    horizontal_fov_deg=85.7,
    distortion=(-0.12, 0.025, -0.0003, 0.0005),
    max_range_m=30.0,
    position_m=(0.6, -0.13, 1.12),
    pitch_deg=1.8,
    yaw_deg=-0.4,
    roll_deg=-0.3,
    stamp_offset_ms=4.0,
)


class SensorConfig(Config):
    """What lens, sensor and encoder do to the picture; ranges are drawn uniformly, once per image or drive.

    Attributes:
        exposure_ev: Error of the automatic exposure, in stops.
        noise_grey: Standard deviation at full light, in grey levels; `Lighting.noise_gain` multiplies it.
        blur_px: Standard deviation of the lens blur.
        motion_blur_share: Share of images that shake.
        motion_blur_px: Length of the shake.
        cast: Largest relative error of a colour channel's gain.
        vignetting: Loss of light in the corners, as a share.
        jpeg_quality: 0 to 100.
    """

    exposure_ev: Range = (-0.35, 0.3)
    noise_grey: Range = (1.5, 5.0)
    blur_px: Range = (0.3, 0.8)
    motion_blur_share: float = Field(default=0.12, ge=0, le=1)
    motion_blur_px: Range = (2.0, 5.0)
    cast: float = Field(default=0.05, ge=0, lt=0.5)
    vignetting: Range = (0.05, 0.25)
    jpeg_quality: int = Field(default=95, ge=1, le=100)


class DisturbanceConfig(Config):
    """What keeps a visible head from being read: an over-exposed, a faint or a sunlit lamp, or a veil of light.

    Attributes:
        washout: How far over-exposed the lit lamps are in ordinary times: 0 saturated colour, 1 white.
        brightness: How bright the lit lamps are in ordinary times: 0 as if off, 1 full.
        share: Share of heads (images) that are disturbed.
        rate_per_minute: How often a head (drives) is disturbed.
        duration_s: How long that lasts (drives).
        kinds: Relative frequency of each kind.
        severity: 0 as in ordinary times, 1 unreadable.
    """

    washout: Range = (0.0, 0.45)
    brightness: Range = (0.7, 1.0)
    share: float = Field(default=0.25, ge=0, le=1)
    rate_per_minute: float = Field(default=8.0, ge=0)
    duration_s: Range = (0.2, 0.7)
    kinds: dict[DisturbanceKind, float] = Field(default_factory=_disturbance_kinds)
    severity: Range = (0.2, 0.8)


class ImagesConfig(Config):
    """Labelled single images of towns that are all different.

    Attributes:
        seed: Same seed, same bytes.
        signals: Signal description, a file or the name of a shipped one.
        train_images: Count.
        val_images: Count.
        empty_share: Share of images in towns without signals: look-alikes only.
        min_height_px: Smaller lights get no label.
        max_occlusion: Lights hidden by more than this share of their box get no label.
        min_inside: Lights with less than this share of their box inside the image get no label.
        max_facing_deg: Lights turned farther away from the camera get no label.
        distance_m: From the camera to the near junction's heads.
        lighting: Relative frequency of each light.
        cameras: One is drawn for each image.
        workers: Processes; the images do not depend on it.
    """

    seed: int = 1
    signals: str = "signals/autolights_13"
    train_images: int = Field(gt=0)
    val_images: int = Field(ge=0)
    empty_share: float = Field(default=0.04, ge=0, lt=1)
    min_height_px: float = Field(default=7.0, gt=0)
    max_occlusion: float = Field(default=0.5, gt=0, le=1)
    min_inside: float = Field(default=0.7, gt=0, le=1)
    max_facing_deg: float = Field(default=70.0, gt=0, lt=90)
    distance_m: Range = (13.0, 62.0)
    lighting: dict[LightingName, float] = Field(default_factory=_lighting_shares)
    cameras: tuple[CameraConfig, ...] = (NARROW, WIDE)
    sensor: SensorConfig = SensorConfig()
    disturbance: DisturbanceConfig = DisturbanceConfig()
    workers: int = Field(default=2, ge=1)


class DriveConfig(Config):
    """One drive.

    Attributes:
        name: Of its folder.
        lighting: The light all along.
        duration_s: Seconds.
        near_types: Types of the near junction's heads over our lanes, from left to right.
        far_types: The same of the far junction.
        near_green_s: When the near junction's through signal turns green, after the start (negative: before it).
        far_green_s: The same of the far junction.
        cruise_mps: Speed on the open road.
    """

    name: str
    lighting: LightingName = "sunny"
    duration_s: float = Field(default=22.0, gt=0)
    near_types: tuple[str, ...] = Field(default=("4", "3", "5dh"), min_length=1, max_length=4)
    far_types: tuple[str, ...] = Field(default=("5dh", "4", "3"), min_length=1, max_length=4)
    near_green_s: float = 13.0
    far_green_s: float = 3.0
    cruise_mps: float = Field(default=9.0, gt=0)


class PoseConfig(Config):
    """Errors of the localisation: a slow part that wanders and a fast part, each Gaussian.

    Attributes:
        rate_hz: Of the pose stream.
        slow_position_m: Standard deviation per axis.
        fast_position_m: Standard deviation per axis.
        slow_rotation_deg: Standard deviation per axis.
        fast_rotation_deg: Standard deviation per axis.
        wander_s: Time constant of the slow part.
    """

    rate_hz: float = Field(default=100.0, ge=20, le=500)
    slow_position_m: float = Field(default=0.04, ge=0)
    fast_position_m: float = Field(default=0.01, ge=0)
    slow_rotation_deg: float = Field(default=0.08, ge=0)
    fast_rotation_deg: float = Field(default=0.02, ge=0)
    wander_s: float = Field(default=5.0, gt=0)


class SurveyConfig(Config):
    """How the map differs from the town.

    Attributes:
        noise_m: Standard deviation of a light's position per axis.
        heading_noise_deg: Standard deviation of its heading.
        missing: The near junction's kerb-side light, put up after the survey, is not in the map.
        extra: A light that was taken down is still in the map.
    """

    noise_m: float = Field(default=0.2, ge=0)
    heading_noise_deg: float = Field(default=1.0, ge=0)
    missing: bool = True
    extra: bool = True


class TrafficConfig(Config):
    """What passes between the cameras and the lights.

    Attributes:
        headway_s: From one vehicle on the crossing road to the next in its lane.
        lorry_share: Share of them that are 4 m high: one of these hides all lights behind it for about a second.
        van_share: Share of them that are 2.7 m high: one of these hides the far junction's lights.
        speed_mps: Of crossing vehicles.
        walker_gap_s: From one pedestrian with an umbrella to the next.
        walk_mps: Of pedestrians.
    """

    headway_s: Range = (1.8, 3.2)
    lorry_share: float = Field(default=0.3, ge=0, le=1)
    van_share: float = Field(default=0.2, ge=0, le=1)
    speed_mps: Range = (8.5, 11.0)
    walker_gap_s: Range = (2.0, 4.5)
    walk_mps: Range = (1.3, 1.8)


class DrivesConfig(Config):
    """Two-camera drives with truth.

    Attributes:
        seed: Same seed, same bytes.
        signals: Signal description, a file or the name of a shipped one.
        drives: What to simulate.
        frame_rate_hz: Sets of frames per second.
        stamp_jitter_ms: Standard deviation of each image's own stamp.
        origin_utm_m: East, north and height of the towns.
        utm_zone: Of the origin.
        truth_range_m: Lights farther away are not in the truth.
        workers: Processes; the images do not depend on it.
    """

    seed: int = 100
    signals: str = "signals/autolights_13"
    drives: tuple[DriveConfig, ...] = Field(min_length=1)
    frame_rate_hz: float = Field(default=10.0, gt=0, le=60)
    stamp_jitter_ms: float = Field(default=0.3, ge=0)
    origin_utm_m: tuple[float, float, float] = (627_300.0, 4_848_900.0, 152.0)
    utm_zone: int = Field(default=17, ge=1, le=60)
    truth_range_m: float = Field(default=80.0, gt=0)
    cameras: tuple[CameraConfig, ...] = (NARROW, WIDE)
    pose: PoseConfig = PoseConfig()
    survey: SurveyConfig = SurveyConfig()
    traffic: TrafficConfig = TrafficConfig()
    sensor: SensorConfig = SensorConfig(motion_blur_share=0.0, motion_blur_px=(2.0, 4.0))
    disturbance: DisturbanceConfig = DisturbanceConfig(severity=(0.6, 1.0))
    workers: int = Field(default=2, ge=1)
