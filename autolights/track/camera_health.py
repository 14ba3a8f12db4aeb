"""What the images say of each camera: whether it still looks where its calibration has it, and at its stamps."""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class CameraHealth:
    """How far a camera looks past its calibration, errors of the vehicle's pose included, and how late.

    Attributes:
        yaw_deg: Lights are seen so far to the right of where they should be.
        pitch_deg: So far below.
        sigma_deg: Standard deviation of the less certain of the two.
        alarm: It is surely, by two standard deviations, more than `AlignmentConfig.alarm_deg`.
        delay_s: Its images are exposed so long after their stamps, as the poses have time; None without `places`.
        delay_sigma_s: Standard deviation.
        delay_alarm: It is surely more than `PlaceConfig.alarm_delay_s`, either way.
    """

    yaw_deg: float
    pitch_deg: float
    sigma_deg: float
    alarm: bool
    delay_s: float | None = None
    delay_sigma_s: float | None = None
    delay_alarm: bool = False

    def warnings(self) -> list[str]:
        """What is to be mended, for people; empty if nothing raises an alarm."""
        found = []
        if self.alarm:
            found.append(
                f"looks past its calibration: lights are seen {abs(self.yaw_deg):.2f} degrees too far to the "
                f"{'right' if self.yaw_deg > 0 else 'left'} and {abs(self.pitch_deg):.2f} too "
                f"{'low' if self.pitch_deg > 0 else 'high'}; calibrate it again"
            )
        if self.delay_alarm and self.delay_s is not None:
            found.append(
                f"is exposed {abs(self.delay_s):.3f} s {'after' if self.delay_s > 0 else 'before'} its stamps, "
                "as the poses have time; check its clock"
            )
        return found

    def to_json(self) -> dict[str, Any]:
        """All of it, rounded to what is worth reading."""
        return {name: round(value, 4) if isinstance(value, float) else value for name, value in asdict(self).items()}
