"""One image of one camera, with the time at which it was taken."""

from dataclasses import dataclass

from autolights.core.arrays import ImageArray


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """An image and where it comes from.

    Attributes:
        camera: Name of the camera, as in the calibration.
        stamp_ns: Integer nanoseconds of this very exposure.
        image_bgr: (H, W, 3) uint8 as OpenCV reads it.
    """

    camera: str
    stamp_ns: int
    image_bgr: ImageArray
