"""Where in an image the network looks, and at what scale."""

import math
from functools import lru_cache
from typing import TypeAlias

from autolights.core import ModelInfo
from autolights.infer.letterbox import STRIDE, Letterbox, rectangle_for

# Left, top, right, bottom in pixels of the image, edge coordinates.
Region: TypeAlias = tuple[float, float, float, float]

# Of an input of free size: an end2end head chooses among at least as many cells as a square of this has.
LEAST_SIDES = {"raw": STRIDE, "end2end": 96}


def view_of(image_wh: tuple[int, int], region: Region | None, info: ModelInfo) -> Letterbox:
    """Fit an image, or a region of it, into a model's input.

    A whole image is scaled to the model's size; a model of free size gets the smallest rectangle that holds it. A
    region keeps the image's resolution: in a model of free size always, in one of fixed size if it fits into the input,
    else it is scaled to it. Where that leaves room in the input, the region grows into it.

    Args:
        image_wh: Width and height of the image in pixels.
        region: See `Region`; what lies outside of the image is cut off.
        info: Size of the model's input.

    Raises:
        ValueError: If the region does not overlap the image.
    """
    return _view(image_wh, region, info.size_wh, LEAST_SIDES[info.head] if info.dynamic_size else None)


@lru_cache(maxsize=64)  # cameras and fixed regions come again with every frame
def _view(
    image_wh: tuple[int, int], region: Region | None, size_wh: tuple[int, int], least_side: int | None
) -> Letterbox:
    """`least_side` is that of a free size, None where the size is fixed."""
    if region is None:
        if least_side is not None:
            width, height = rectangle_for(image_wh, max(size_wh))
            size_wh = max(width, least_side), max(height, least_side)
        return Letterbox(image_wh, size_wh)
    spans = [_whole_pixels(region[axis], region[axis + 2], image_wh[axis]) for axis in (0, 1)]
    if any(high <= low for low, high in spans):
        raise ValueError(f"the region {list(region)} does not overlap the image of {image_wh[0]} x {image_wh[1]} px")
    sides = [high - low for low, high in spans]
    if least_side is not None:
        wanted = [_padded(side, least_side) for side in sides]
    else:
        scale = max(sides[0] / size_wh[0], sides[1] / size_wh[1], 1.0)
        wanted = [math.floor(side * scale) for side in size_wh]
    (left, width), (top, height) = (_grown(*spans[axis], wanted[axis], image_wh[axis]) for axis in (0, 1))
    if least_side is not None:
        size_wh = _padded(width, least_side), _padded(height, least_side)
    return Letterbox((width, height), size_wh, origin_xy=(left, top), enlarge=False)


def _padded(side: int, least: int) -> int:
    return max(math.ceil(side / STRIDE) * STRIDE, least)


def _whole_pixels(low: float, high: float, length: int) -> tuple[int, int]:
    """The pixels that a span touches: first, and one past the last."""
    return max(math.floor(low), 0), min(math.ceil(high), length)


def _grown(low: int, high: int, wanted: int, length: int) -> tuple[int, int]:
    """Start and size of a span that is at least as long as wanted, as far as the image reaches."""
    size = min(max(wanted, high - low), length)
    start = low - (size - (high - low)) // 2
    return min(max(start, 0), length - size), size
