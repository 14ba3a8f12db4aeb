"""One image of one camera, with the time at which it was taken."""

from dataclasses import dataclass

from autolights.core.arrays import BoolArray, ImageArray


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """An image and where it comes from.

    Attributes:
        camera: Name of the camera, as in the calibration.
        stamp_ns: Integer nanoseconds of this very exposure.
        image_bgr: (H, W, 3) uint8 as OpenCV reads it.
        occlusion: (h, w) of the whole image, in any resolution: where something hides what is behind it, as far as
            anybody knows (lidar, segmentation, the vehicle's own parts). A light behind it is not missed. None hides
            nothing.

    Raises:
        ValueError: If the occlusion is no such mask.
    """

    camera: str
    stamp_ns: int
    image_bgr: ImageArray
    occlusion: BoolArray | None = None

    def __post_init__(self) -> None:
        mask = self.occlusion
        if mask is not None and not (mask.ndim == 2 and mask.size and mask.dtype == bool):
            raise ValueError(f"occlusion must be (h, w) of bool, got {mask.shape} of {mask.dtype}")
