"""Training samples: images from a cache, placed on a canvas and changed, with the labels that are left in view."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from autolights.core.arrays import FloatArray, ImageArray, IntArray
from autolights.core.boxes import cxcywh_from_xyxy
from autolights.data.image_dataset import ImageDataset
from autolights.train.config import TrainConfig
from autolights.train.network.model import MAX_STRIDE
from autolights.train.samples.augment import PixelChanges, may_flip, may_turn_over, mirror_boxes
from autolights.train.samples.image_cache import ImageCache
from autolights.train.samples.placement import (
    Placement,
    draw_placed,
    place_crop,
    place_mosaic,
    place_whole,
    visible_part,
)


@dataclass(frozen=True)
class Visit:
    """One image's turn: the sample depends on nothing else, so it is the same in whatever process it is made.

    Attributes:
        epoch: From 1.
        position: In the order of the epoch, over all processes.
        index: Of the image.
        canvas_wh: Size of what enters the network, pixels; the same for all of a batch.
    """

    epoch: int
    position: int
    index: int
    canvas_wh: tuple[int, int]


class TrainingSamples:
    """Random samples of labelled images, one for each `Visit`."""

    def __init__(self, images: ImageDataset, mirrors: IntArray, config: TrainConfig) -> None:
        """Read the images into memory.

        Args:
            images: What to train on.
            mirrors: (C,) mirror class of each class, −1 for none.
            config: Of the run.

        Raises:
            DataError: If more images than `config.bad_images` allows do not decode.
        """
        self._mirrors = mirrors
        self._config = config
        self._changes = PixelChanges(config.augment)
        self._cache = ImageCache(
            images,
            long_side_px=None if config.crops else config.image_size,
            budget_mb=config.cache_mb,
            folder=Path(config.cache_dir) if config.cache_dir else None,
            bad_share=config.bad_images,
        )

    @property
    def images(self) -> ImageDataset:
        """What there is to train on: the images that decode."""
        return self._cache.images

    def __len__(self) -> int:
        return len(self.images)

    @property
    def canvases_wh(self) -> IntArray:
        """(n, 2) size of the input that each image asks for, pixels."""
        if self._config.rectangular:
            return -(-self._cache.sizes_wh // MAX_STRIDE) * MAX_STRIDE
        return np.full((len(self), 2), self._config.input_side_px)

    def sides_px(self) -> FloatArray:
        """(n, 2) width and height of all labels as the network will see them, before random scaling."""
        crops = self._config.crops
        # Scales of crops are uniform in the logarithm.
        scale = float(np.sqrt(crops.scale[0] * crops.scale[1])) if crops else 1.0
        sides = [
            boxes[:, 2:] * size for boxes, size in zip(self.images.boxes_cxcywh, self._cache.sizes_wh, strict=True)
        ]
        return scale * np.concatenate(sides)

    def draw(self, visit: Visit, canvas: ImageArray) -> FloatArray:
        """Draw the sample of a visit.

        Args:
            visit: Which image, when.
            canvas: (H, W, 3) RGB of the visit's size; overwritten.

        Returns:
            (n, 5) class, centre, width and height as fractions of the canvas.
        """
        config = self._config.augment
        rng = np.random.default_rng((self._config.seed, visit.epoch, visit.position))
        placed = self._placements(visit, rng)
        boxes = np.concatenate([placement.boxes(self._boxes(index)) for index, placement in placed])
        ids = np.concatenate([self.images.class_ids[index] for index, _ in placed])
        clipped, kept, seen = visible_part(boxes, visit.canvas_wh, config)
        if rng.random() < config.flip and may_flip(ids[seen], self._mirrors):
            width = visit.canvas_wh[0]
            placed = [(index, placement.mirrored(width)) for index, placement in placed]
            clipped, ids = mirror_boxes(clipped, width), self._mirrors[ids]
        if config.flip_vertical and rng.random() < config.flip_vertical and may_turn_over(ids[seen], self._mirrors):
            height = visit.canvas_wh[1]
            placed = [(index, placement.mirrored(height, axis=1)) for index, placement in placed]
            clipped = mirror_boxes(clipped, height, axis=1)
        draw_placed([(self._cache[index], placement) for index, placement in placed], canvas)
        canvas[:] = self._changes(canvas, rng)
        return np.column_stack([ids[kept], cxcywh_from_xyxy(clipped[kept]) / np.tile(visit.canvas_wh, 2)])

    def _placements(self, visit: Visit, rng: np.random.Generator) -> list[tuple[int, Placement]]:
        config = self._config
        size_wh = self._size_wh(visit.index)
        if config.crops:
            boxes = self._boxes(visit.index)
            return [(visit.index, place_crop(size_wh, boxes, config.crops, config.augment.rotate_deg, rng))]
        if config.rectangular or rng.random() >= config.augment.mosaic:
            return [(visit.index, place_whole(size_wh, visit.canvas_wh, config.augment, rng))]
        indices = [visit.index, *rng.integers(len(self.images), size=3).tolist()]
        sizes = [self._size_wh(index) for index in indices]
        return list(zip(indices, place_mosaic(sizes, config.image_size, config.augment, rng), strict=True))

    def _boxes(self, index: int) -> FloatArray:
        """(n, 4) labels in pixels of the image as it is kept."""
        return self.images.boxes_xyxy(index, self._size_wh(index))

    def _size_wh(self, index: int) -> tuple[int, int]:
        width, height = self._cache.sizes_wh[index].tolist()
        return width, height
