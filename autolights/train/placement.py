"""Where images land on a training canvas: whole, cropped around a light, or four in a mosaic.

A placement is one affine map in edge coordinates, so that rotation, scale, shift and crop cost one interpolation.
"""

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np

from autolights.core.arrays import BoolArray, FloatArray, ImageArray
from autolights.core.boxes import area, clip
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

    def draw(self, image: ImageArray, canvas: ImageArray) -> None:
        """Put the image onto a square canvas, in place; what it does not cover keeps its colour."""
        matrix = self.canvas_from_image.copy()
        # OpenCV counts from the centre of the first pixel, edge coordinates from its corner.
        matrix[:, 2] += 0.5 * matrix[:, :2].sum(axis=1) - 0.5
        size_wh = (canvas.shape[1], canvas.shape[0])
        cv2.warpAffine(image, matrix, size_wh, dst=canvas, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT)

    def boxes(self, boxes_xyxy: FloatArray) -> FloatArray:
        """(n, 4) upright boxes around the turned ones, on the canvas and beyond."""
        corners = boxes_xyxy[:, [[0, 1], [2, 1], [2, 3], [0, 3]]]  # (n, 4 corners, 2)
        moved = corners @ self.canvas_from_image[:, :2].T + self.canvas_from_image[:, 2]
        return np.concatenate([moved.min(axis=1), moved.max(axis=1)], axis=1)


def place_whole(image_wh: tuple[int, int], side_px: int, config: AugmentConfig, rng: np.random.Generator) -> Placement:
    """Fit a whole image into the canvas, then scale, move and turn it at random."""
    centre = np.array(image_wh) / 2
    shift = rng.uniform(-config.translate, config.translate, size=2) * side_px
    return Placement.turned_about(
        centre,
        side_px / 2 + shift,
        scale=side_px / max(image_wh) * rng.uniform(1 - config.scale, 1 + config.scale),
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
    boxes_xyxy: FloatArray, side_px: int, config: AugmentConfig
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Clip boxes to the canvas and tell which still count.

    Args:
        boxes_xyxy: (n, 4) on the canvas and beyond, pixels.
        side_px: Of the canvas.
        config: Least visible share and side.

    Returns:
        (n, 4) clipped boxes, (n,) which to keep, (n,) which are in view at all.
    """
    clipped = clip(boxes_xyxy, (side_px, side_px))
    visible = area(clipped)
    seen = visible > 0
    sides = clipped[:, 2:] - clipped[:, :2]
    kept = seen & (visible >= config.min_visible * area(boxes_xyxy)) & (sides >= config.min_side_px).all(axis=1)
    return clipped, kept, seen
