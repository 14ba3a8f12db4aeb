"""`autolights tune`: measure in which way a bundle's detector is fastest on this machine, and remember it."""

import os
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

from autolights.core import Bundle, FloatArray, ImageArray
from autolights.core.atomic import sha256
from autolights.core.errors import AutolightsError
from autolights.core.progress import say, track
from autolights.infer import Detector, Execution
from autolights.infer.execution import open_session, openvino_is_installed, usable_cpus
from autolights.infer.session import CPU, can_limit_spinning
from autolights.infer.tuning import Measurement, Tuning, this_machine

GPU_PROVIDERS = (
    "TensorrtExecutionProvider",
    "CUDAExecutionProvider",
    "CoreMLExecutionProvider",
    "DmlExecutionProvider",
)
FINALISTS = 4
# About the time of a small operator: beside busy neighbours it cost a fifth, spinning without limit fourfold.
SPIN_US = 100
# Differences below this are within the noise: then the candidate that comes first wins, with the fewest threads.
WORTH_A_CHANGE = 0.97


@dataclass(frozen=True)
class TuneResult:
    """What was found.

    Attributes:
        tuning: The record.
        path: Where it is kept.
        refused: Why executions could not be started.
    """

    tuning: Tuning
    path: Path
    refused: dict[Execution, str]


def tune_bundle(
    bundle: Bundle,
    *,
    images: int = 2,
    image_wh: tuple[int, int] = (1920, 1200),
    seconds: float = 6.0,
    bfloat16: bool = False,
) -> TuneResult:
    """Measure the ways of running a bundle's detector that this machine offers, and remember the fastest.

    All are timed briefly, then the best few in turns, so that a busy moment hits them alike. The bundle's folder is not
    written to.

    Args:
        bundle: The bundle.
        images: In a set, as many as cameras expose together; what counts is the time of a whole set.
        image_wh: Width and height of an image in pixels.
        seconds: About how long to measure.
        bfloat16: Also try OpenVINO's rounding to bfloat16; see `OpenVinoSession`.

    Raises:
        AutolightsError: If the model cannot be run at all.
    """
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    if load > usable_cpus() / 2:
        say(f"warning: the machine is busy (load {load:.1f} on {usable_cpus()} CPUs): this is what will be measured")
    frames = _soft_noise(images, image_wh)
    candidates = list(_candidates(images, bfloat16))
    model = bundle.model_path, bundle.model
    model_sha256 = bundle.model_sha256 or sha256(bundle.model_path)
    wanted = _probabilities(bundle, candidates[0])
    differences: dict[Execution, float] = {}
    brief_ms: dict[Execution, float] = {}
    refused: dict[Execution, str] = {}
    for execution in track(candidates, description="all ways, briefly", total=len(candidates), unit="ways"):
        try:
            differences[execution] = float(np.abs(_probabilities(bundle, execution) - wanted).max())
            brief_ms[execution] = _brief_ms(
                Detector(*model, execution, sha256=model_sha256), frames, seconds / 3 / len(candidates)
            )
        except AutolightsError as error:
            if execution == candidates[0]:
                raise
            refused[execution] = str(error)
    fastest = sorted(brief_ms, key=brief_ms.__getitem__)[:FINALISTS]
    finalists = {each: Detector(*model, each, sha256=model_sha256) for each in candidates if each in fastest}
    rounds = max(round(1e3 * seconds * 2 / 3 / sum(brief_ms[each] for each in fastest)), 3)
    medians = brief_ms | _in_turns_ms(finalists, frames, rounds)
    tuning = Tuning(
        machine=this_machine(),
        model_sha256=model_sha256,
        onnxruntime=onnxruntime.__version__,
        images=images,
        image_wh=image_wh,
        best=_best([(each, medians[each]) for each in finalists]),
        measurements=tuple(
            Measurement(
                execution=each,
                set_ms=medians[each],
                prob_difference=differences[each],
                in_turns=each in finalists,
            )
            for each in sorted(medians, key=lambda each: (each not in finalists, medians[each]))
        ),
    )
    return TuneResult(tuning, tuning.save(), refused)


def _candidates(images: int, bfloat16: bool) -> Iterator[Execution]:
    """The plainest first, and in each group the fewest threads."""
    cpus = usable_cpus()
    thread_counts = sorted({*(2**i for i in range(5) if 2**i <= cpus), min(cpus, 16)})
    streams = [(threads, streams) for threads in thread_counts for streams in sorted({1, images}) if streams <= threads]
    for threads, count in streams:
        yield Execution(threads=threads, streams=count)
        if threads > count == 1 and can_limit_spinning():
            yield Execution(threads=threads, spin_us=SPIN_US)
    if openvino_is_installed():
        for rounded in (False, True) if bfloat16 else (False,):
            for threads, count in streams:
                yield Execution(backend="openvino", threads=threads, streams=count, bfloat16=rounded)
    for provider in GPU_PROVIDERS:
        if provider in onnxruntime.get_available_providers():
            yield Execution(providers=(provider, CPU))


def _best(measured: Sequence[tuple[Execution, float]]) -> Execution:
    """The first that no later one beats by more than noise."""
    best, best_ms = measured[0]
    for execution, set_ms in measured[1:]:
        if set_ms < WORTH_A_CHANGE * best_ms:
            best, best_ms = execution, set_ms
    return best


def _brief_ms(detector: Detector, frames: Sequence[ImageArray], seconds: float) -> float:
    """Median time of a set of images, of at least two; one before them warms up."""
    detector.batch(frames)
    times: list[float] = []
    while len(times) < 2 or sum(times) < 1e3 * seconds:
        times.append(_set_ms(detector, frames))
    return statistics.median(times)


def _in_turns_ms(
    detectors: dict[Execution, Detector], frames: Sequence[ImageArray], rounds: int
) -> dict[Execution, float]:
    """Median times of a set of images, detector after detector in each round."""
    times: dict[Execution, list[float]] = {execution: [] for execution in detectors}
    for number in track(range(rounds + 1), description="the best, in turns", total=rounds + 1, unit="rounds"):
        for execution, detector in detectors.items():
            set_ms = _set_ms(detector, frames)
            if number:  # the first round warms up
                times[execution].append(set_ms)
    return {execution: statistics.median(each) for execution, each in times.items()}


def _set_ms(detector: Detector, frames: Sequence[ImageArray]) -> float:
    start = time.perf_counter()
    detector.batch(frames)
    return 1e3 * (time.perf_counter() - start)


def _probabilities(bundle: Bundle, execution: Execution) -> FloatArray:
    """What a session says of one fixed input: objectness and classes of a raw head, scores of another."""
    width, height = bundle.model.size_wh
    image = _soft_noise(1, (width, height))[0]
    dtype = np.float16 if bundle.model.half_io else np.float32
    blob: FloatArray = np.ascontiguousarray(image.transpose(2, 0, 1)[None] / 255).astype(dtype)
    session = open_session(
        bundle.model_path,
        bundle.model,
        execution,
        threads=execution.threads_of_stream,
        sha256=bundle.model_sha256,
    )
    outputs = session.run(blob)
    return np.array(outputs[0][..., 4:] if bundle.model.head == "raw" else outputs[1], dtype=np.float64)


def _soft_noise(count: int, image_wh: tuple[int, int]) -> list[ImageArray]:
    """Coarse coloured structure, always the same."""
    width, height = image_wh
    random = np.random.default_rng(0)
    small = random.integers(0, 256, (count, max(height // 16, 1), max(width // 16, 1), 3), dtype=np.uint8)
    return [np.asarray(cv2.resize(each, image_wh, interpolation=cv2.INTER_CUBIC), dtype=np.uint8) for each in small]
