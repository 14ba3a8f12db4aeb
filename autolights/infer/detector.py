"""The detector that ships: an image in, lights out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np

from autolights.core import Bundle, Detections, ImageArray, ModelInfo
from autolights.infer.decode import decode
from autolights.infer.letterbox import InputBuffer
from autolights.infer.session import OnnxSession


class Detector:
    """Find traffic lights in images of any size. Not to be shared between threads: it reuses its input's memory.

    Args:
        model_path: The ONNX file.
        info: Its description.
        score_threshold: Instead of the description's.
        providers: See `OnnxSession`.
        threads: See `OnnxSession`.
    """

    def __init__(
        self,
        model_path: Path,
        info: ModelInfo,
        *,
        score_threshold: float | None = None,
        providers: Sequence[str] | None = None,
        threads: int | None = None,
    ) -> None:
        self.classes = info.classes
        self.score_threshold = info.score_threshold if score_threshold is None else score_threshold
        width, height = info.size_wh
        self._session = OnnxSession(model_path, info, providers=providers, threads=threads)
        self._buffer = InputBuffer(info.size_wh)
        self._blob = np.empty((1, 3, height, width), dtype=np.float32)

    @classmethod
    def from_bundle(
        cls,
        bundle: Bundle,
        *,
        score_threshold: float | None = None,
        providers: Sequence[str] | None = None,
        threads: int | None = None,
    ) -> Self:
        """The detector of a bundle."""
        return cls(
            bundle.model_path, bundle.model, score_threshold=score_threshold, providers=providers, threads=threads
        )

    def __call__(self, image_bgr: ImageArray) -> Detections:
        """Detect lights in one image.

        Args:
            image_bgr: (H, W, 3) uint8 as OpenCV reads it.

        Returns:
            Detections in pixels of this image, best first.

        Raises:
            ValueError: If the image is not (H, W, 3) uint8 or has no pixels.
        """
        _check_image(image_bgr)
        letterbox = self._buffer.fill(image_bgr, self._blob[0])
        return decode(self._session.run(self._blob)[0], letterbox, score_threshold=self.score_threshold)

    def batch(self, images_bgr: Sequence[ImageArray]) -> list[Detections]:
        """Detect lights in several images, whose sizes may differ; see `__call__`.

        They run one after the other: on a CPU a larger batch is no faster, and each image is ready sooner.
        """
        return [self(image_bgr) for image_bgr in images_bgr]


def _check_image(image_bgr: ImageArray) -> None:
    if image_bgr.dtype != np.uint8:
        raise ValueError(f"the image must be uint8 with values 0 to 255, got {image_bgr.dtype}")
    if image_bgr.ndim != 3 or image_bgr.shape[2] != 3 or image_bgr.size == 0:
        raise ValueError(f"the image must be (height, width, 3) in BGR order, got {image_bgr.shape}")
