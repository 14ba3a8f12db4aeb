"""An exported model where a network is wanted: measured as the runtime runs it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np
import torch

from autolights.core import Bundle, CountedWith, Detections, FloatArray, ModelInfo
from autolights.core.atomic import sha256 as file_sha256
from autolights.core.errors import UsageError
from autolights.core.model_info import load_model_info
from autolights.infer.decode import decode_outputs
from autolights.infer.execution import Execution, open_session
from autolights.infer.letterbox import Letterbox
from autolights.infer.region import view_of
from autolights.train.measure.every_class import COCO_SCORE_THRESHOLD, decode_every_class
from autolights.train.measure.predictions import Predictions


class ExportedModel:
    """A model file with its description, for `detect_dataset`.

    Args:
        model_path: The ONNX file.
        info: Its description.
        execution: How it is run; by default in ONNX Runtime on the CPU.
        sha256: What the file must hash to; empty: anything.

    Attributes:
        info: Its description.
        counted_with: Names the file in what is counted with it.

    Raises:
        UsageError: If the file is missing, or its head yields no class vectors.
        DataError: If the file is no model, or is not as described.
    """

    def __init__(
        self, model_path: Path, info: ModelInfo, execution: Execution | None = None, *, sha256: str = ""
    ) -> None:
        execution = execution or Execution()
        self.info = info
        self._session = open_session(model_path, info, execution, threads=execution.threads, sha256=sha256)
        self.counted_with = CountedWith(sha256 or file_sha256(model_path), info.precision)

    @classmethod
    def open(cls, path: Path, execution: Execution | None = None) -> Self:
        """Open ``model.onnx`` with its description beside it, or a bundle's folder.

        Raises:
            UsageError: See the class; or if there is nothing at `path`.
            BundleError: If the description is missing or wrong, or the bundle is damaged.
            DataError: See the class.
        """
        if path.is_dir():
            bundle = Bundle.load(path)
            return cls(bundle.model_path, bundle.model, execution, sha256=bundle.model_sha256)
        if not path.is_file():
            raise UsageError(f"{path}: no such model; make one with `autolights export`")
        return cls(path, load_model_info(path), execution)

    def view(self, image_wh: tuple[int, int]) -> Letterbox:
        """Where an image lies in the input, as in the runtime."""
        return view_of(image_wh, None, self.info)

    def detect(
        self, blob: FloatArray, views: Sequence[Letterbox], *, score_threshold: float
    ) -> list[tuple[Predictions, Detections]]:
        """Run the model on images of one input size.

        Args:
            blob: (B, 3, H, W) float32 RGB in [0, 1].
            views: Where each image lies in it.
            score_threshold: Of what is reported.

        Returns:
            For each image its predictions for average precision, each class of each box one, and what the runtime would
            report.
        """
        blob = blob.astype(np.float16 if self.info.half_io else np.float32, copy=False)
        parts = [blob] if self.info.dynamic_batch else [blob[i : i + 1] for i in range(len(blob))]
        seen: list[tuple[Predictions, Detections]] = []
        for part in parts:
            outputs = self._session.run(part)
            for i in range(len(part)):
                view = views[len(seen)]
                reported = decode_outputs(outputs, i, view, self.info, score_threshold=score_threshold)
                seen.append((self._every_class(outputs, i, view), reported))
        return seen

    def _every_class(self, outputs: Sequence[FloatArray], index: int, view: Letterbox) -> Predictions:
        if self.info.head == "raw":
            rows = np.array(outputs[0][index], dtype=np.float32)  # the session may write over its own
            return decode_every_class(torch.from_numpy(rows), view)
        # The graph has chosen already; each class of a box is a prediction, none is suppressed again.
        chosen = decode_outputs(outputs, index, view, self.info, score_threshold=COCO_SCORE_THRESHOLD)
        scores = chosen.objectness[:, None] * chosen.class_probs
        boxes, class_ids = np.nonzero(scores >= COCO_SCORE_THRESHOLD)
        return Predictions(chosen.boxes_xyxy[boxes], class_ids, scores[boxes, class_ids])
