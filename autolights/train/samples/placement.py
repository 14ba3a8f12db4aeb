"""Where images land on a training canvas: whole, cropped around a light, or four in a mosaic.

A placement is one affine map in edge coordinates, so that rotation, scale, shift and crop cost one interpolation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np

from autolights.core.arrays import BoolArray, FloatArray, ImageArray
from autolights.core.boxes import area, clip
from autolights.infer.letterbox import GREY
from autolights.train.config import AugmentConfig, CropConfig


@dataclass(frozen=True, eq=False)
class Placement:
    """An image on the canvas.

    Attributes:
        canvas_from_image: (2, 3) affine map of edge coordinates in pixels.
    """

    canvas_from_image: FloatArray

    @classmethod
    def turned_about(
        cls, point_image: FloatArray, point_canvas: FloatArray, *, scale: float, rotation_deg: float
    ) -> Self:
        """Scale and rotate an image so that one of its points falls on a point of the canvas."""
        angle = np.deg2rad(rotation_deg)
        linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return cls(np.column_stack([linear, point_canvas - linear @ point_image]))

    def mirrored(self, canvas_side_px: int, axis: int = 0) -> Self:
        """The same with the canvas seen in a mirror: axis 0 left to right, 1 upside down."""
        matrix = self.canvas_from_image.copy()
        matrix[axis] = -matrix[axis]
        matrix[axis, 2] += canvas_side_px
        return replace(self, canvas_from_image=matrix)

    def boxes(self, boxes_xyxy: FloatArray) -> FloatArray:
        """(n, 4) upright boxes around the turned ones, on the canvas and beyond."""
        linear, offset = self.canvas_from_image[:, :2], self.canvas_from_image[:, 2]
        lows, highs = boxes_xyxy[:, :2], boxes_xyxy[:, 2:]
        centres = (lows + highs) / 2 @ linear.T + offset
        halves = (highs - lows) / 2 @ np.abs(linear).T  # of the parallelogram that the box becomes
        return np.concatenate([centres - halves, centres + halves], axis=1)


def draw_placed(placed: Sequence[tuple[ImageArray, Placement]], canvas_rgb: ImageArray) -> None:
    """Draw images over each other on a canvas, which is grey where none of them lies.

    Args:
        placed: (H, W, 3) RGB images and where they belong.
        canvas_rgb: (H, W, 3); overwritten.
    """
    # OpenCV interpolates four channels in half the time that it takes for three.
    canvas = np.full((*canvas_rgb.shape[:2], 4), GREY, dtype=np.uint8)
    for image, placement in placed:
        _draw(image, placement, canvas)
    cv2.cvtColor(canvas, cv2.COLOR_RGBA2RGB, dst=canvas_rgb)


def _draw(image_rgb: ImageArray, placement: Placement, canvas_rgba: ImageArray) -> None:
    """Draw one image, looking at no more pixels of it and of the canvas than meet."""
    matrix = placement.canvas_from_image
    covered = _landing(matrix, (0, 0, *image_rgb.shape[1::-1]), canvas_rgba.shape[1::-1])
    if covered is None:
        return
    left, top, right, bottom = covered
    image_from_canvas = np.asarray(cv2.invertAffineTransform(matrix), dtype=np.float64)
    # What is interpolated at the edge needs one more pixel.
    needed = _landing(image_from_canvas, covered, image_rgb.shape[1::-1], margin_px=1)
    if needed is None:  # the box around a turned image met the canvas, the image does not
        return
    first_x, first_y, last_x, last_y = needed
    shifted = matrix.copy()
    # OpenCV counts from the centre of the first pixel, edge coordinates from its corner.
    shifted[:, 2] += matrix[:, :2] @ (first_x + 0.5, first_y + 0.5) - (left + 0.5, top + 0.5)
    cv2.warpAffine(
        cv2.cvtColor(image_rgb[first_y:last_y, first_x:last_x], cv2.COLOR_RGB2RGBA),
        shifted,
        (right - left, bottom - top),
        dst=canvas_rgba[top:bottom, left:right],
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_TRANSPARENT,
    )


def _landing(
    matrix: FloatArray, box_xyxy: tuple[float, float, float, float], size_wh: tuple[int, int], *, margin_px: int = 0
) -> tuple[int, int, int, int] | None:
    """Left, top, right, bottom of the pixels that a box touches once it is mapped; None if it misses them all.

    Plain numbers: for a single box, arrays would take several times as long.
    """
    left, top, right, bottom = box_xyxy
    edges = []
    for (along_x, along_y, offset), size in zip(matrix.tolist(), size_wh, strict=True):
        centre = (along_x * (left + right) + along_y * (top + bottom)) / 2 + offset
        half = (abs(along_x) * (right - left) + abs(along_y) * (bottom - top)) / 2 + margin_px
        edges.append((max(math.floor(centre - half), 0), min(math.ceil(centre + half), size)))
    (first_x, last_x), (first_y, last_y) = edges
    if first_x >= last_x or first_y >= last_y:
        return None
    return first_x, first_y, last_x, last_y


def place_whole(
    image_wh: tuple[int, int], canvas_wh: tuple[int, int], config: AugmentConfig, rng: np.random.Generator
) -> Placement:
    """Fit a whole image into the canvas, then scale, move and turn it at random."""
    size = np.array(canvas_wh)
    shift = rng.uniform(-config.translate, config.translate, size=2) * size
    return Placement.turned_about(
        np.array(image_wh) / 2,
        size / 2 + shift,
        scale=float((size / image_wh).min()) * rng.uniform(1 - config.scale, 1 + config.scale),
        rotation_deg=rng.uniform(-config.rotate_deg, config.rotate_deg),
    )


def place_crop(
    image_wh: tuple[int, int],
    boxes_xyxy: FloatArray,
    crops: CropConfig,
    rotate_deg: float,
    rng: np.random.Generator,
) -> Placement:
    """Cut a crop around a random light, or anywhere; inside the image as far as that is large enough.

    Args:
        image_wh: Size of the image, pixels.
        boxes_xyxy: (n, 4) its labels, pixels.
        crops: Side, scales and share of lights.
        rotate_deg: Largest rotation either way.
        rng: Source of randomness.
    """
    # Uniform in the logarithm: halving is as likely as doubling.
    scale = float(np.exp(rng.uniform(*np.log(crops.scale))))
    if len(boxes_xyxy) and rng.random() < crops.light_share:
        box = boxes_xyxy[rng.integers(len(boxes_xyxy))]
        focus = (box[:2] + box[2:]) / 2
        # The light lies anywhere in the crop, but wholly inside if it fits.
        margin = np.minimum((box[2:] - box[:2]) / 2 * scale, crops.size / 2)
    else:
        focus = rng.uniform(0, image_wh)
        margin = np.zeros(2)
    window = crops.size / scale
    start = focus - rng.uniform(margin, crops.size - margin) / scale
    start = np.clip(start, 0, np.maximum(np.array(image_wh) - window, 0))
    return Placement.turned_about(
        start + window / 2,
        np.full(2, crops.size / 2),
        scale=scale,
        rotation_deg=rng.uniform(-rotate_deg, rotate_deg),
    )


def place_mosaic(
    images_wh: list[tuple[int, int]], side_px: int, config: AugmentConfig, rng: np.random.Generator
) -> list[Placement]:
    """Put four images around a random point of a canvas of twice the side, of which a random part is seen.

    Args:
        images_wh: Sizes of the four images, pixels: top left, top right, bottom left, bottom right.
        side_px: Of the canvas.
        config: Ranges of scale, shift and rotation.
        rng: Source of randomness.

    References:
        Bochkovskiy et al. 2020, "YOLOv4"; centre in the middle half as in YOLOv5.
    """
    meeting_point = rng.uniform(0.5 * side_px, 1.5 * side_px, size=2)
    shift = rng.uniform(-config.translate, config.translate, size=2) * side_px
    view = Placement.turned_about(
        np.full(2, float(side_px)),
        side_px / 2 + shift,
        scale=rng.uniform(1 - config.scale, 1 + config.scale),
        rotation_deg=rng.uniform(-config.rotate_deg, config.rotate_deg),
    ).canvas_from_image
    placements = []
    for image_wh, touching in zip(images_wh, ((1, 1), (0, 1), (1, 0), (0, 0)), strict=True):
        scale = side_px / max(image_wh)
        offset = meeting_point - scale * np.array(image_wh) * touching
        linear = view[:, :2] * scale
        placements.append(Placement(np.column_stack([linear, view[:, :2] @ offset + view[:, 2]])))
    return placements


def visible_part(
    boxes_xyxy: FloatArray, canvas_wh: tuple[int, int], config: AugmentConfig
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Clip boxes to the canvas and tell which still count.

    Args:
        boxes_xyxy: (n, 4) on the canvas and beyond, pixels.
        canvas_wh: Its size, pixels.
        config: Least visible share and side.

    Returns:
        (n, 4) clipped boxes, (n,) which to keep, (n,) which are in view at all.
    """
    clipped = clip(boxes_xyxy, canvas_wh)
    visible = area(clipped)
    seen = visible > 0
    sides = clipped[:, 2:] - clipped[:, :2]
    kept = seen & (visible >= config.min_visible * area(boxes_xyxy)) & (sides >= config.min_side_px).all(axis=1)
    return clipped, kept, seen
