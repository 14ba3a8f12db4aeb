"""Training samples: images from a cache, placed on a canvas and changed, with the labels that are left in view."""

from dataclasses import dataclass

import numpy as np

from autolights.core.arrays import FloatArray, ImageArray, IntArray
from autolights.core.boxes import cxcywh_from_xyxy
from autolights.data.image_dataset import ImageDataset
from autolights.infer.letterbox import GREY
from autolights.train.augment import PixelChanges, flip, may_flip
from autolights.train.config import TrainConfig
from autolights.train.image_cache import ImageCache
from autolights.train.placement import Placement, place_crop, place_mosaic, place_whole, visible_part


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
        """
        self.images = images
        self._mirrors = mirrors
        self._config = config
        self._changes = PixelChanges(config.augment)
        self._cache = ImageCache(
            images, long_side_px=None if config.crops else config.image_size, budget_mb=config.cache_mb
        )

    def __len__(self) -> int:
        return len(self.images)

    @property
    def canvases_wh(self) -> IntArray:
        """(n, 2) size of the input that each image asks for, pixels."""
        return np.full((len(self), 2), self._config.input_side_px)

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
        side_px = self._config.input_side_px
        canvas[:] = GREY
        boxes, class_ids = [], []
        for index, placement in self._placements(visit.index, rng):
            image = self._cache[index]
            placement.draw(image, canvas)
            boxes.append(placement.boxes(self._boxes(index, image)))
            class_ids.append(self.images.class_ids[index])
        clipped, kept, seen = visible_part(np.concatenate(boxes), side_px, config)
        ids = np.concatenate(class_ids)
        flipped = rng.random() < config.flip and may_flip(ids[seen], self._mirrors)
        clipped, ids = clipped[kept], ids[kept]
        if flipped:
            canvas[:], clipped, ids = flip(canvas, clipped, ids, self._mirrors)
        canvas[:] = self._changes(canvas, rng)
        return np.column_stack([ids, cxcywh_from_xyxy(clipped) / side_px])

    def _placements(self, index: int, rng: np.random.Generator) -> list[tuple[int, Placement]]:
        config = self._config
        image = self._cache[index]
        if config.crops:
            boxes = self._boxes(index, image)
            return [(index, place_crop(_size_wh(image), boxes, config.crops, config.augment.rotate_deg, rng))]
        if rng.random() >= config.augment.mosaic:
            return [(index, place_whole(_size_wh(image), config.image_size, config.augment, rng))]
        indices = [index, *rng.integers(len(self.images), size=3).tolist()]
        sizes = [_size_wh(self._cache[i]) for i in indices]
        return list(zip(indices, place_mosaic(sizes, config.image_size, config.augment, rng), strict=True))

    def _boxes(self, index: int, image: ImageArray) -> FloatArray:
        return self.images.boxes_xyxy(index, _size_wh(image))


def _size_wh(image: ImageArray) -> tuple[int, int]:
    return image.shape[1], image.shape[0]
