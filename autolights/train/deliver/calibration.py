"""Between which values the tensors of a model run: from images, for quantisation to 8 bits."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Literal, TypeAlias

import numpy as np
import onnxruntime
from onnx import ModelProto, TensorProto, helper

from autolights.core import FloatArray, ImageArray, IntArray, ModelInfo
from autolights.core.errors import DataError, UsageError
from autolights.core.progress import track
from autolights.data.image_dataset import ImageDataset
from autolights.infer.letterbox import InputBuffer, Letterbox
from autolights.infer.region import view_of

Calibration: TypeAlias = Literal["mse", "minmax", "entropy"]

_BINS = 2048
_LEVELS = 128  # of a magnitude in 8 bits, the sign apart


class CalibrationImages:
    """Inputs from the images of a data set, evenly spread over it.

    Args:
        dataset: Where they come from; labels are not looked at.
        info: Of the model: the size of its input.
        count: How many; all, if there are not more.

    Raises:
        UsageError: If there are none.
    """

    def __init__(self, dataset: ImageDataset, info: ModelInfo, count: int) -> None:
        count = min(count, len(dataset))
        if count < 1:
            raise UsageError(f"{dataset.root}: calibration needs at least one image")
        self._dataset = dataset
        self._info = info
        self._indices = np.linspace(0, len(dataset) - 1, count).round().astype(int).tolist()

    def __len__(self) -> int:
        return len(self._indices)

    def __iter__(self) -> Iterator[FloatArray]:
        """(1, 3, H, W) float32 RGB in [0, 1] each; images that do not decode are left out."""
        for i in self._indices:
            try:
                image_bgr = self._dataset.read(i)
            except DataError:
                continue
            yield model_input(image_bgr, self._info)[0]


def model_input(image_bgr: ImageArray, info: ModelInfo) -> tuple[FloatArray, Letterbox]:
    """An image as the runtime would put it before the network: (1, 3, H, W), and where it lies in it."""
    view = view_of((image_bgr.shape[1], image_bgr.shape[0]), None, info)
    width, height = view.input_wh
    blob = np.empty((1, 3, height, width), dtype=np.float32)
    return blob, InputBuffer(view.input_wh).fill(image_bgr, blob[0], view)


def measure_ranges(
    model: ModelProto, tensors: Sequence[str], blobs: Sequence[FloatArray] | CalibrationImages, method: Calibration
) -> dict[str, tuple[float, float]]:
    """Run a float32 model on images and find a range for each tensor.

    Args:
        model: With one input, ``images``.
        tensors: Names of float tensors in it, or of its input.
        blobs: (1, 3, H, W) inputs as at runtime, e.g. `CalibrationImages`; run through twice, for ``minmax`` once.
        method: ``minmax`` takes the extremes. The others cut off the largest magnitudes, which are few, so that the
            many others are told apart in finer steps: ``mse`` where the mean squared error in 8 bits is least,
            ``entropy`` where 8 bits tell most of the distribution.

    Returns:
        For each tensor its lowest and highest value; the range always holds 0, which 8 bits must hit exactly.

    Raises:
        DataError: If no image could be read.
    """
    session = _session(model, tensors)
    ranges = dict.fromkeys(tensors, (0.0, 0.0))
    for name, values in _values(session, tensors, blobs, "find ranges"):
        low, high = ranges[name]
        ranges[name] = min(low, float(values.min())), max(high, float(values.max()))
    if not any(low < high for low, high in ranges.values()):
        raise DataError("calibration saw no image, or only black ones: none of the images decodes")
    if method == "minmax":
        return ranges
    magnitudes = {name: max(-low, high) for name, (low, high) in ranges.items()}
    histograms = {name: np.zeros(_BINS, dtype=np.int64) for name in tensors}
    for name, values in _values(session, tensors, blobs, "find distributions"):
        if magnitudes[name] > 0:
            scaled = np.abs(values.ravel()) * np.float32(_BINS / magnitudes[name])
            histograms[name] += np.bincount(np.minimum(scaled.astype(np.int32), _BINS - 1), minlength=_BINS)
    best_threshold = least_error if method == "mse" else least_divergence
    limits = {
        name: magnitudes[name] / _BINS * best_threshold(histogram) if magnitudes[name] > 0 else 0.0
        for name, histogram in histograms.items()
    }
    return {name: (max(low, -limits[name]), min(high, limits[name])) for name, (low, high) in ranges.items()}


def least_error(histogram: IntArray) -> int:
    """After how many bins magnitudes are best cut off for the least squared error in 127 steps.

    What is cut off errs by its distance from the threshold t, all else by rounding, (t / 127)² / 12 in the mean.

    Args:
        histogram: (n,) counts of magnitudes in equal bins from 0.

    Returns:
        A number of bins, from 1 to n.

    References:
        Choukroun et al. 2019, "Low-bit Quantization of Neural Networks for Efficient Inference", Sec. 3.
    """
    counts = np.asarray(histogram, dtype=np.float64)
    centres = np.arange(len(counts)) + 0.5
    thresholds = np.arange(1, len(counts) + 1, dtype=np.float64)
    number, first, second = (np.cumsum((counts * power)[::-1])[::-1] for power in (1.0, centres, centres**2))
    beyond = [np.append(moment[1:], 0.0) for moment in (number, first, second)]
    cut = beyond[2] - 2 * thresholds * beyond[1] + thresholds**2 * beyond[0]
    rounding = (counts.sum() - beyond[0]) * (thresholds / (_LEVELS - 1)) ** 2 / 12
    return 1 + int(np.argmin(cut + rounding))


def least_divergence(histogram: IntArray) -> int:
    """After how many bins magnitudes are best cut off, when the rest is told apart in 128 steps.

    Of all thresholds that one whose quantised distribution has the least Kullback-Leibler divergence from the original
    with its outliers moved to the threshold.

    Args:
        histogram: (n,) counts of magnitudes in equal bins from 0, n at least 128.

    Returns:
        A number of bins, from 128 to n.

    References:
        Migacz 2017, "8-bit Inference with TensorRT".
    """
    # Exact zeros (a padded border, a dead channel) are hit exactly by any threshold: they must not decide it.
    counts = np.asarray(histogram, dtype=np.float64).copy()
    counts[0] = 0 if counts[1:].any() else counts[0]
    outliers = counts.sum() - np.cumsum(counts)
    divergences = [_divergence(counts[:bins], outliers[bins - 1]) for bins in range(_LEVELS, len(counts) + 1)]
    return _LEVELS + int(np.argmin(divergences))


def _divergence(counts: FloatArray, outliers: float) -> float:
    """Of the 128-step version of `counts` from `counts` with the outliers in its last bin."""
    steps = np.arange(len(counts)) * _LEVELS // len(counts)
    there = counts > 0
    # What is quantised is the distribution without outliers: that it cannot tell them from the last step is the loss.
    sums = np.bincount(steps, counts, minlength=_LEVELS)
    occupied = np.bincount(steps, there, minlength=_LEVELS)
    shown = np.where(there, (sums / np.maximum(occupied, 1))[steps], 0.0)
    wanted = counts.copy()
    wanted[-1] += outliers
    if not shown.any():
        return np.inf
    p, q = wanted / wanted.sum(), shown / shown.sum()
    likely = p > 0
    # Where the quantised distribution says never, a small probability stands in for it.
    return float((p[likely] * np.log(p[likely] / np.maximum(q[likely], 1e-12))).sum())


def _session(model: ModelProto, tensors: Iterable[str]) -> onnxruntime.InferenceSession:
    """The model with the tensors among its outputs."""
    probed = ModelProto()
    probed.CopyFrom(model)
    own = {port.name for port in (*probed.graph.input, *probed.graph.output)}
    probed.graph.output.extend(
        helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in tensors if name not in own
    )
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(probed.SerializeToString(), options, providers=["CPUExecutionProvider"])


def _values(
    session: onnxruntime.InferenceSession,
    tensors: Sequence[str],
    blobs: Sequence[FloatArray] | CalibrationImages,
    description: str,
) -> Iterator[tuple[str, FloatArray]]:
    """Name and value of each tensor on each input."""
    inner = [name for name in tensors if name != "images"]
    for blob in track(blobs, description=description, total=len(blobs), unit="images"):
        if "images" in tensors:
            yield "images", blob
        if inner:
            yield from zip(inner, session.run(inner, {"images": blob}), strict=True)
