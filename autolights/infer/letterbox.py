"""Fit an image of any size, or a region of it, into the network's input, and boxes back onto the image.

The image is scaled as a whole (up or down) until it fits, centred, and the rest is grey.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from autolights.core import FloatArray, ImageArray

GREY = 114  # what YOLOv5-style networks are trained to ignore
STRIDE = 32  # of the coarsest level: input sides are multiples of it
_LEVELS = np.arange(256, dtype=np.float32) / np.float32(255)


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
        image_wh: Width and height in pixels of the image, or of the region of it that is looked at.
        input_wh: Width and height of the network's input.
        origin_xy: Top left corner of the region in the image.
        enlarge: Scale what is smaller than the input up; else it keeps its size.
    """

    image_wh: tuple[int, int]
    input_wh: tuple[int, int]
    origin_xy: tuple[int, int] = (0, 0)
    enlarge: bool = True

    @cached_property
    def scaled_wh(self) -> tuple[int, int]:
        """Size of the image inside the input, in whole pixels."""
        (image_width, image_height), (width, height) = self.image_wh, self.input_wh
        scale = min(width / image_width, height / image_height)
        if not self.enlarge:
            scale = min(scale, 1.0)
        return (
            min(max(round(image_width * scale), 1), width),
            min(max(round(image_height * scale), 1), height),
        )

    @cached_property
    def offset_xy(self) -> tuple[int, int]:
        """Input pixels left of and above the image."""
        scaled_width, scaled_height = self.scaled_wh
        return (self.input_wh[0] - scaled_width) // 2, (self.input_wh[1] - scaled_height) // 2

    @cached_property
    def _to_image(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Offset, scale, and the lowest and highest edges: (4,) each."""
        (left, top), (width, height), (x, y) = self.offset_xy, self.image_wh, self.origin_xy
        scaled_width, scaled_height = self.scaled_wh
        scale_x, scale_y = width / scaled_width, height / scaled_height
        return (
            np.array([left - x / scale_x, top - y / scale_y] * 2),
            np.array([scale_x, scale_y] * 2),
            np.array([x, y] * 2, dtype=np.float64),
            np.array([x + width, y + height] * 2, dtype=np.float64),
        )

    def boxes_to_image(self, boxes_xyxy: FloatArray) -> FloatArray:
        """(n, 4) boxes in input pixels → (n, 4) float64 in pixels of the image, cut at the edges of what was seen."""
        offset, scale, low, high = self._to_image
        boxes = (boxes_xyxy - offset) * scale
        return np.minimum(np.maximum(boxes, low, out=boxes), high, out=boxes)


class InputBuffer:
    """The network's input for images of any size, made without allocating: BGR bytes → RGB planes in [0, 1].

    Args:
        input_wh: Size to keep memory for; a larger input takes more.
    """

    def __init__(self, input_wh: tuple[int, int]) -> None:
        self._bytes = np.empty(6 * input_wh[0] * input_wh[1], dtype=np.uint8)

    def fill(self, image_bgr: ImageArray, out: FloatArray, letterbox: Letterbox | None = None) -> Letterbox:
        """Letterbox one image.

        Args:
            image_bgr: (H, W, 3) uint8.
            out: (3, height, width) float32 or float16, overwritten.
            letterbox: What goes where; by default the whole image into the whole of `out`.

        Returns:
            Where the image lies.
        """
        if letterbox is None:
            letterbox = Letterbox((image_bgr.shape[1], image_bgr.shape[0]), (out.shape[2], out.shape[1]))
        (left, top), (width, height) = letterbox.offset_xy, letterbox.scaled_wh
        (x, y), (image_width, image_height) = letterbox.origin_xy, letterbox.image_wh
        region = image_bgr[y : y + image_height, x : x + image_width]  # a view
        scaled, planes = self._memory(width, height)
        if region.shape == scaled.shape:
            scaled = region
        else:
            cv2.resize(region, (width, height), dst=scaled, interpolation=cv2.INTER_LINEAR)
        # Planes first: the table then runs over contiguous bytes. It is as fast as a product, and ten times for halves.
        cv2.split(scaled, planes)
        levels = _LEVELS.astype(out.dtype)
        for channel, plane in enumerate(reversed(planes)):
            cv2.LUT(plane, levels, dst=out[channel, top : top + height, left : left + width])
        grey = levels[GREY]
        out[:, :top] = out[:, top + height :] = grey
        out[:, :, :left] = out[:, :, left + width :] = grey
        return letterbox

    def _memory(self, width: int, height: int) -> tuple[ImageArray, list[ImageArray]]:
        """The scaled image, (height, width, 3), and its three planes."""
        pixels = width * height
        if len(self._bytes) < 6 * pixels:
            self._bytes = np.empty(6 * pixels, dtype=np.uint8)
        scaled = self._bytes[: 3 * pixels].reshape(height, width, 3)
        return scaled, list(self._bytes[3 * pixels : 6 * pixels].reshape(3, height, width))
