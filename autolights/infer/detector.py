"""The detector that ships: an image in, lights out."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import Self

import numpy as np

from autolights.core import Bundle, Detections, FloatArray, ImageArray, ModelInfo
from autolights.core.atomic import sha256 as file_sha256
from autolights.infer.decode import decode_outputs
from autolights.infer.execution import Execution, open_session
from autolights.infer.letterbox import InputBuffer, Letterbox
from autolights.infer.region import Region, view_of
from autolights.infer.session import Session
from autolights.infer.tuning import tuned_execution


class Detector:
    """Find traffic lights in images of any size. Not to be shared between threads: it reuses its input's memory.

    Args:
        model_path: The ONNX file.
        info: Its description.
        execution: How it is run; by default in ONNX Runtime on the CPU.
        score_threshold: Instead of the description's.
        sha256: What the file must hash to, whenever it is opened; empty: anything.

    Raises:
        UsageError: If the file is missing, what `execution` asks for is not there, or the head yields no class vectors.
        BundleError: If the file hashes to something else.
        DataError: If the file is no model, or is not as described.
    """

    def __init__(
        self,
        model_path: Path,
        info: ModelInfo,
        execution: Execution | None = None,
        *,
        score_threshold: float | None = None,
        sha256: str = "",
    ) -> None:
        self.classes = info.classes
        self.score_threshold = info.score_threshold if score_threshold is None else score_threshold
        self.execution = execution or Execution()
        self._model_path = model_path
        self._sha256 = sha256
        self._info = info
        # A single image has all threads, streams share them. Who only ever asks for one of the two loads only that.
        self._single: _Lane | None = None
        self._streams = self.execution.streams if self.execution.streams > 1 else 0
        self._free: SimpleQueue[_Lane] = SimpleQueue()
        if self._streams:
            for _ in range(self._streams):
                self._free.put(self._open(self.execution.threads_of_stream))
            self._workers = ThreadPoolExecutor(self._streams, thread_name_prefix="detector")
        else:
            self._whole_machine()

    @classmethod
    def from_bundle(
        cls,
        bundle: Bundle,
        execution: Execution | None = None,
        *,
        providers: Sequence[str] | None = None,
        threads: int | None = None,
        score_threshold: float | None = None,
        images_at_once: int = 1,
    ) -> Self:
        """The detector of a bundle.

        Args:
            bundle: The bundle.
            execution: How it is run; by default as `autolights tune` found best on this machine for this bundle, if it
                was asked, else in ONNX Runtime on the CPU.
            providers: Shorthand for an execution in ONNX Runtime with these providers.
            threads: Shorthand for an execution with so many threads.
            score_threshold: Instead of the bundle's.
            images_at_once: As many as `batch` will mostly get, unless told or tuned otherwise; see
                `Execution.for_images`.

        Raises:
            UsageError: See the class.
            DataError: See the class.
        """
        if execution is None and not providers and threads is None:
            execution = tuned_execution(bundle.model_sha256 or file_sha256(bundle.model_path))
        if execution is None:
            execution = Execution.for_images(images_at_once, providers=providers or (), threads=threads)
        return cls(
            bundle.model_path,
            bundle.model,
            execution,
            score_threshold=score_threshold,
            sha256=bundle.model_sha256,
        )

    def __call__(self, image_bgr: ImageArray, region: Region | None = None) -> Detections:
        """Detect lights in one image.

        Args:
            image_bgr: (H, W, 3) uint8 as OpenCV reads it.
            region: Where lights can be; by default anywhere. See `batch`.

        Returns:
            Detections in pixels of this image, best first.

        Raises:
            ValueError: If the image is not (H, W, 3) uint8 or has no pixels.
        """
        _check_image(image_bgr)
        return self._whole_machine().detect([image_bgr], [self._view(image_bgr, region)])[0]

    def batch(
        self, images_bgr: Sequence[ImageArray], regions: Sequence[Region | None] | None = None
    ) -> list[Detections]:
        """Detect lights in several images, whose sizes may differ; see `__call__`.

        On a GPU a model of free batch size takes images of one input size in one call. On a CPU a larger batch is no
        faster; there images run one after the other, or side by side in streams.

        Args:
            images_bgr: (H, W, 3) uint8 each.
            regions: Of each image the part in which lights can be, or None for all of it. What is looked at may be
                larger, if that costs nothing, and keeps the image's resolution where the model's input allows it.
                Lights that its edge cuts are left out.

        Returns:
            Detections of each image, in pixels of that image.
        """
        if regions is None:
            regions = [None] * len(images_bgr)
        for image_bgr in images_bgr:
            _check_image(image_bgr)
        views = [self._view(*pair) for pair in zip(images_bgr, regions, strict=True)]
        if self._streams and len(views) > 1:
            return list(self._workers.map(self._in_free_stream, images_bgr, views))
        single = self._whole_machine()
        if len(views) > 1 and self._info.dynamic_batch and single.on_gpu:
            return self._together(single, images_bgr, views)
        return [single.detect([image_bgr], [view])[0] for image_bgr, view in zip(images_bgr, views, strict=True)]

    def _view(self, image_bgr: ImageArray, region: Region | None) -> Letterbox:
        return view_of((image_bgr.shape[1], image_bgr.shape[0]), region, self._info)

    def _open(self, threads: int | None) -> "_Lane":
        session = open_session(self._model_path, self._info, self.execution, threads=threads, sha256=self._sha256)
        return _Lane(session, self._info, self.score_threshold)

    def _whole_machine(self) -> "_Lane":
        if self._single is None:
            self._single = self._open(self.execution.threads)
        return self._single

    def _in_free_stream(self, image_bgr: ImageArray, view: Letterbox) -> Detections:
        lane = self._free.get()
        try:
            return lane.detect([image_bgr], [view])[0]
        finally:
            self._free.put(lane)

    def _together(
        self, lane: "_Lane", images_bgr: Sequence[ImageArray], views: Sequence[Letterbox]
    ) -> list[Detections]:
        """Images of one input size in one call."""
        found: dict[int, Detections] = {}
        for input_wh in dict.fromkeys(view.input_wh for view in views):
            group = [i for i, view in enumerate(views) if view.input_wh == input_wh]
            results = lane.detect([images_bgr[i] for i in group], [views[i] for i in group])
            found.update(zip(group, results, strict=True))
        return [found[i] for i in range(len(views))]


class _Lane:
    """One session with input memory of its own."""

    def __init__(self, session: Session, info: ModelInfo, score_threshold: float) -> None:
        self.on_gpu = session.on_gpu
        self._session = session
        self._info = info
        self._score_threshold = score_threshold
        self._buffer = InputBuffer(info.size_wh)
        self._memory: FloatArray = np.empty(0, dtype=np.float16 if info.half_io else np.float32)

    def detect(self, images_bgr: Sequence[ImageArray], views: Sequence[Letterbox]) -> list[Detections]:
        """Run images of one input size in one call."""
        blob = self._blob(len(views), views[0].input_wh)
        for image_bgr, view, out in zip(images_bgr, views, blob, strict=True):
            self._buffer.fill(image_bgr, out, view)
        outputs = self._session.run(blob)
        found = [
            decode_outputs(outputs, i, view, self._info, score_threshold=self._score_threshold)
            for i, view in enumerate(views)
        ]
        return [_uncut(*each) for each in zip(found, views, images_bgr, strict=True)]

    def _blob(self, count: int, input_wh: tuple[int, int]) -> FloatArray:
        """(count, 3, height, width) of the memory, which grows to the largest input that ever came."""
        shape = (count, 3, input_wh[1], input_wh[0])
        size = math.prod(shape)
        if size > len(self._memory):
            self._memory = np.empty(size, dtype=self._memory.dtype)
        return self._memory[:size].reshape(shape)


def _uncut(detections: Detections, view: Letterbox, image_bgr: ImageArray) -> Detections:
    """Without what the edge of a region cuts: half a light has the size of none."""
    height, width = image_bgr.shape[:2]
    if view.image_wh == (width, height):
        return detections
    (left, top), (view_width, view_height) = view.origin_xy, view.image_wh
    right, bottom = left + view_width, top + view_height
    low = np.array([left + 1 if left else -1, top + 1 if top else -1])
    high = np.array([right - 1 if right < width else width + 1, bottom - 1 if bottom < height else height + 1])
    boxes = detections.boxes_xyxy
    cut = (boxes[:, :2] <= low) | (boxes[:, 2:] >= high)
    return detections[np.flatnonzero(~cut.any(axis=1))]


def _check_image(image_bgr: ImageArray) -> None:
    if image_bgr.dtype != np.uint8:
        raise ValueError(f"the image must be uint8 with values 0 to 255, got {image_bgr.dtype}")
    if image_bgr.ndim != 3 or image_bgr.shape[2] != 3 or image_bgr.size == 0:
        raise ValueError(f"the image must be (height, width, 3) in BGR order, got {image_bgr.shape}")
