"""Fit an image of any size into the network's input, and boxes back onto the image.

The image is scaled as a whole (up or down) until it fits, centred, and the rest is grey.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray
from autolights.core.boxes import clip

GREY = 114  # what YOLOv5-style networks are trained to ignore
STRIDE = 32  # of the coarsest level: input sides are multiples of it


def rectangle_for(image_wh: tuple[int, int], long_side: int, *, stride: int = STRIDE) -> tuple[int, int]:
    """The smallest input that holds the image scaled to `long_side` pixels.

    Returns:
        Width and height, multiples of `stride`: (1280, 800) at 640 gives (640, 416).
    """
    scale = long_side / max(image_wh)
    width, height = (math.ceil(round(side * scale) / stride) * stride for side in image_wh)
    return max(width, stride), max(height, stride)


@dataclass(frozen=True)
class Letterbox:
    """Where an image of one size lies in an input of another.

    Attributes:
        image_wh: Width and height of the image in pixels.
        input_wh: Width and height of the network's input.
    """

    image_wh: tuple[int, int]
    input_wh: tuple[int, int]

    @property
    def scaled_wh(self) -> tuple[int, int]:
        """Size of the image inside the input, in whole pixels."""
        (image_width, image_height), (width, height) = self.image_wh, self.input_wh
        scale = min(width / image_width, height / image_height)
        return (
            min(max(round(image_width * scale), 1), width),
            min(max(round(image_height * scale), 1), height),
        )

    @property
    def offset_xy(self) -> tuple[int, int]:
        """Input pixels left of and above the image."""
        scaled_width, scaled_height = self.scaled_wh
        return (self.input_wh[0] - scaled_width) // 2, (self.input_wh[1] - scaled_height) // 2

    def paste(self, image_bgr: ImageArray, canvas_bgr: ImageArray) -> None:
        """Scale the image into its place on a canvas of the input's size; the margins are left as they are."""
        (left, top), (width, height) = self.offset_xy, self.scaled_wh
        place = canvas_bgr[top : top + height, left : left + width]
        if image_bgr.shape == place.shape:
            place[:] = image_bgr
        else:
            cv2.resize(image_bgr, (width, height), dst=place, interpolation=cv2.INTER_LINEAR)

    def boxes_to_image(self, boxes_xyxy: FloatArray) -> FloatArray:
        """(n, 4) boxes in input pixels → (n, 4) float64 in pixels of the image, cut at its edges."""
        scale = np.divide(self.image_wh, self.scaled_wh)
        return clip((boxes_xyxy - np.tile(self.offset_xy, 2)) * np.tile(scale, 2), self.image_wh)


class InputBuffer:
    """The network's input for images of any size, made without allocating: BGR bytes → RGB planes in [0, 1].

    Args:
        input_wh: Width and height of the network's input.
    """

    def __init__(self, input_wh: tuple[int, int]) -> None:
        width, height = input_wh
        self._input_wh = input_wh
        self._canvas = np.full((height, width, 3), GREY, dtype=np.uint8)
        self._planes = [np.empty((height, width), dtype=np.uint8) for _ in range(3)]
        self._letterbox: Letterbox | None = None

    def fill(self, image_bgr: ImageArray, out: FloatArray) -> Letterbox:
        """Letterbox one image.

        Args:
            image_bgr: (H, W, 3) uint8.
            out: (3, height, width) float32, overwritten.

        Returns:
            Where the image lies.
        """
        letterbox = Letterbox((image_bgr.shape[1], image_bgr.shape[0]), self._input_wh)
        if letterbox != self._letterbox:
            self._canvas[:] = GREY
            self._letterbox = letterbox
        letterbox.paste(image_bgr, self._canvas)
        # Planes first: the scaling to floats then runs over contiguous bytes, twice as fast as over every third one.
        cv2.split(self._canvas, self._planes)
        for channel, plane in enumerate(reversed(self._planes)):
            np.multiply(plane, np.float32(1 / 255), out=out[channel])
        return letterbox
