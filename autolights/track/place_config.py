"""What is known of the errors of places, boxes, mounting and poses before anything is seen."""

from pydantic import Field

from autolights.core import Config


class PlaceConfig(Config):
    """What is known of all errors before anything is seen: standard deviations, per axis.

    Attributes:
        map_m: Of a light's place in the map.
        size_share: Of a housing's height against its type's, and of how tightly the detector draws boxes.
        box_px: Of a box's edges.
        box_share: The same in heights of the box; both add up as variances.
        rotation_deg: Of each camera's mounting.
        position_m: Of what is constant in the error of the poses.
        delay_s: Of how long after their stamps, as the poses have time, a camera's images are exposed.
        wander_deg: Of the vehicle's attitude, from place to place.
        wander_m: Of its position, from place to place.
        decorrelation_m: Errors of boxes and poses hang together over so many metres of way,
        decorrelation_s: or so many seconds where the vehicle stands.
        drift_deg: How far a mounting wanders in a minute.
        drift_m: How far the constant error of the poses wanders in a minute.
        drift_delay_s: How far a camera's delay does.
        alarm_delay_s: A camera whose delay is found to be more, either way, raises an alarm.
        every_s: Images of a camera that follow sooner are no keyframes, from which places are learnt, if no other
            camera's are,
        least_news: nor is one that is worth less than this share of an independent one, by way and time since the last:
            where the vehicle stands there is little to learn.
        projected_sigmas: Lights of the map are looked for where the images showed them, but no farther from their place
            in the map than so many times `map_m`; 0 looks for them where the map has them.
    """

    map_m: float = Field(default=0.25, gt=0)
    size_share: float = Field(default=0.04, gt=0)
    box_px: float = Field(default=1.0, gt=0)
    box_share: float = Field(default=0.03, ge=0)
    rotation_deg: float = Field(default=0.3, gt=0)
    position_m: float = Field(default=0.05, gt=0)
    delay_s: float = Field(default=0.02, gt=0)
    wander_deg: float = Field(default=0.1, ge=0)
    wander_m: float = Field(default=0.06, ge=0)
    decorrelation_m: float = Field(default=2.0, gt=0)
    decorrelation_s: float = Field(default=5.0, gt=0)
    drift_deg: float = Field(default=0.02, ge=0)
    drift_m: float = Field(default=0.05, ge=0)
    drift_delay_s: float = Field(default=0.002, ge=0)
    alarm_delay_s: float = Field(default=0.03, gt=0)
    every_s: float = Field(default=0.25, ge=0)
    least_news: float = Field(default=0.1, ge=0, lt=1)
    projected_sigmas: float = Field(default=1.5, ge=0)
