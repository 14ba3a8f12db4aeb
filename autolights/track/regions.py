"""Where in a camera's image lights can appear: a fixed band, or around the lights that the map expects."""

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from autolights.core import Config, FloatArray

Box = tuple[float, float, float, float]


class RegionConfig(Config):
    """What the detector looks at in one camera's images.

    Known lights, of the map or found on the way, always belong to it, so none is called missing where nobody looked.

    Attributes:
        kind: ``fixed``: the band `box`; ``map``: the smallest box around the known lights in view, the whole image
            where there are none.
        box: Left, top, right, bottom of the band as fractions of the image.
        margin_px: Around each known light, for errors of the vehicle's rotation and of the camera's.
        margin_heights: Added to it, in heights of the light, for errors of its position and the vehicle's.
        whole_every: In every so manieth set the whole image is looked at, for lights that nobody knows yet; 0 never.
    """

    kind: Literal["fixed", "map"] = "map"
    box: Box = (0.0, 0.0, 1.0, 1.0)
    margin_px: float = Field(default=48.0, ge=0)
    margin_heights: float = Field(default=1.0, ge=0)
    whole_every: int = Field(default=10, ge=0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        left, top, right, bottom = self.box
        if not (0 <= left < right <= 1 and 0 <= top < bottom <= 1):
            raise ValueError(f"box must be left, top, right, bottom as fractions from 0 to 1, got {list(self.box)}")
        return self


def region_of_interest(config: RegionConfig, known_boxes_xyxy: FloatArray, size_wh: tuple[int, int]) -> Box | None:
    """The part of an image in which lights can appear.

    Args:
        config: What is looked at.
        known_boxes_xyxy: (n, 4) known lights projected, pixels; what lies outside of the image is cut off.
        size_wh: Width and height of the image.

    Returns:
        Left, top, right, bottom in pixels; None for the whole image.
    """
    sizes = np.array([*size_wh, *size_wh], dtype=np.float64)
    margins = config.margin_px + config.margin_heights * (known_boxes_xyxy[:, 3:] - known_boxes_xyxy[:, 1:2])
    wide = np.concatenate([known_boxes_xyxy[:, :2] - margins, known_boxes_xyxy[:, 2:] + margins], axis=1)
    wide = np.clip(wide, 0.0, sizes)
    wide = wide[(wide[:, 2:] > wide[:, :2]).all(axis=1)]
    if config.kind == "fixed":
        wide = np.concatenate([wide, [np.array(config.box) * sizes]])
    if not len(wide):
        return None
    left, top = wide[:, :2].min(axis=0).tolist()
    right, bottom = wide[:, 2:].max(axis=0).tolist()
    return left, top, right, bottom
