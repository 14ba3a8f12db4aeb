"""Time detection beside the public YOLOv5, from an image in memory to boxes, and the runtime's own parts alone.

All sides get the same image and number of threads. Each has a process of its own, and they take turns; the ratio of a
round is that of neighbours in time, so a busy machine slows all of them. The public side needs an interpreter with
PyPI's `yolov5` 7.0.14, onnx and onnxruntime (see `peer_infer.py`); without it ours run alone. Ours are exported from
the same weights, or random ones, with 80 classes like the public ones; other models come by name, with their
description beside them, and are compared with any row above:

    python tools/bench_infer.py --peer-python /opt/peer/bin/python --weights-n yolov5n.pt --threads 2
    python tools/bench_infer.py --sizes --openvino --model "float s=s.onnx" --model "int8 s=s_int8.onnx@float s"
"""

import argparse
import multiprocessing
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from autolights.core import Detections, FloatArray, ImageArray
from autolights.core.model_info import load_model_info
from autolights.core.progress import say, track
from autolights.infer import Detector, Execution
from autolights.infer.decode import decode
from autolights.infer.letterbox import InputBuffer, Letterbox, rectangle_for
from autolights.infer.session import can_limit_spinning
from autolights.tune import SPIN_US

IMAGE_WH = (1920, 1200)
LONG_SIDE = 640
SQUARE = (LONG_SIDE, LONG_SIDE)
CANDIDATES, LIGHTS, CELLS_OF_A_LIGHT = 25_200, 20, 6
START = """
import time
start = time.perf_counter()
import sys
from pathlib import Path
from typing import NamedTuple
import numpy as np
from autolights.core import Bundle, CameraFrame, CameraModel, Pose, TrafficLightMap
from autolights.pipeline import LightPipeline
bundle = Bundle.load(Path(sys.argv[1]))
axes = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
intrinsics = np.array([[1600.0, 0, 960], [0, 1600, 600], [0, 0, 1]])
camera = CameraModel("front", (1920, 1200), intrinsics, np.zeros(4), axes, 60.0)
lights = TrafficLightMap(("a",), ("3",), np.array([[40.0, 2, 5]]), np.array([270.0]), np.array([[0.36, 1.07, 0.3]]))
pipeline = LightPipeline.from_bundle(bundle, {"front": camera}, lights, threads=int(sys.argv[2]))
pipeline.update_pose(Pose(0, np.zeros(3), np.array([0.0, 0, 0, 1])))
pipeline.step([CameraFrame("front", 0, np.zeros((1200, 1920, 3), np.uint8))])
assert not pipeline.skipped, pipeline.last_skip
print(time.perf_counter() - start)
"""


class Turn(NamedTuple):
    """One set of images: milliseconds on the clock and of all CPUs together, boxes in the first image."""

    ms: float
    cpu_ms: float
    boxes: int


@dataclass(frozen=True)
class Row:
    """One contender.

    Attributes:
        label: In the table.
        model: None for the public one.
        against: Label of the row that it is compared with; itself for none.
        limit: What the ratio is to be at most.
        size: Of the network: n or s.
        images: In a set.
        execution: Of ours.
    """

    label: str
    model: Path | None
    against: str
    limit: float | None = None
    size: str = ""
    images: int = 1
    execution: Execution | None = None


def answer(model: Path, execution: Execution, images: int, image_path: Path, remote: Connection) -> None:
    """What a process of ours does: detect whenever it is asked to."""
    cv2.setNumThreads(execution.threads or 0)
    detector = Detector(model, load_model_info(model), execution)
    frames = [np.load(image_path)] * images
    with suppress(EOFError, BrokenPipeError):  # the other end is closed when all is measured
        remote.send(_timed(lambda: detector.batch(frames)))
        while True:
            remote.recv()
            remote.send(_timed(lambda: detector.batch(frames)))


def _timed(detect: Callable[[], Sequence[Detections]]) -> Turn:
    start, cpu_start = time.perf_counter(), time.process_time()
    found = detect()
    return Turn(1e3 * (time.perf_counter() - start), 1e3 * (time.process_time() - cpu_start), len(found[0]))


def start_ours(row: Row, image_path: Path, stack: ExitStack) -> Callable[[], Turn]:
    """A process of ours; the result asks it for milliseconds and boxes."""
    spawn = multiprocessing.get_context("spawn")
    here, remote = spawn.Pipe()
    process = spawn.Process(target=answer, args=(row.model, row.execution, row.images, image_path, remote), daemon=True)
    process.start()
    stack.callback(process.join)
    stack.callback(here.close)
    remote.close()
    here.recv()

    def ask() -> Turn:
        here.send(None)
        answered: Turn = here.recv()
        return answered

    return ask


def start_peer(command: list[str], log_path: Path, stack: ExitStack) -> Callable[[], Turn]:
    """The public one's process; it exports its model first."""
    log = stack.enter_context(log_path.open("w"))
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True)
    stack.callback(process.wait)
    stack.callback(process.stdin.close)

    def ask() -> Turn:
        process.stdin.write("\n")
        process.stdin.flush()
        milliseconds, cpu_ms, count = process.stdout.readline().split()
        return Turn(float(milliseconds), float(cpu_ms), int(count))

    if process.stdout.readline() != "ready\n":
        sys.exit(f"error: the public side did not start: {log_path.read_text()[-2000:]}")
    return ask


def export_ours(weights: dict[str, str], folder: Path) -> None:
    """Write ``n_640x416.onnx``, ... with 80 classes, and a bundle of a nano with 13 (in a process for torch)."""
    import torch

    from autolights.core import Bundle, ConfusionMatrix, load_signals
    from autolights.train import load_checkpoint
    from autolights.train.deliver.export import export_onnx
    from autolights.train.deliver.hmm_fitting import fit_hmm
    from autolights.train.network.model import YoloV5

    for size, path in weights.items():
        torch.manual_seed(0)
        model = load_checkpoint(Path(path)) if path != "-" else YoloV5(size, 80)
        for size_wh in (rectangle_for(IMAGE_WH, LONG_SIDE), SQUARE):
            export_onnx(model, folder / f"{size}_{size_wh[0]}x{size_wh[1]}.onnx", size_wh=size_wh)
    signals = load_signals()
    report = export_onnx(
        YoloV5("n", len(signals.classes), signals.classes),
        folder / "lights.onnx",
        size_wh=rectangle_for(IMAGE_WH, LONG_SIDE),
    )
    counts = np.zeros((len(signals.classes) + 1,) * 2, dtype=np.int64)
    confusion = ConfusionMatrix(signals.classes, counts, report.info.score_threshold, 0.5)
    Bundle(report.info, report.path, signals, fit_hmm(confusion, signals), confusion).save(folder / "bundle")


def our_rows(arguments: argparse.Namespace, folder: Path) -> list[Row]:
    """The table's rows but for those of the public side; each comes after the row that it is held against."""
    rectangle = rectangle_for(IMAGE_WH, LONG_SIDE)
    threads = arguments.threads
    plain = Execution(threads=threads)
    rows = []
    for size in arguments.sizes:
        peer = f"yolov5{size} 640x640" if arguments.peer_python else ""
        names = {wh: f"{size} {wh[0]}x{wh[1]}" for wh in (SQUARE, rectangle)}
        for wh, limit in ((SQUARE, 0.95), (rectangle, 0.70)):
            path = folder / f"{size}_{wh[0]}x{wh[1]}.onnx"
            against = peer or names[SQUARE]
            rows.append(Row(names[wh], path, against, limit if peer else None, size, execution=plain))
        if threads > 1 and can_limit_spinning():
            execution = Execution(threads=threads, spin_us=SPIN_US)
            label = f"{names[rectangle]}, spin {SPIN_US} us"
            rows.append(Row(label, path, names[rectangle], None, size, execution=execution))
        if arguments.openvino:
            for rounded in (False, True):
                execution = Execution(backend="openvino", threads=threads, bfloat16=rounded)
                label = f"{names[rectangle]} OpenVINO{' bfloat16' * rounded}"
                rows.append(Row(label, path, names[rectangle], None, size, execution=execution))
        if threads > 1 and size == "n":
            label = f"{names[rectangle]}, set of 2"
            for words, execution in (("", plain), (" in 2 streams", Execution(threads=threads, streams=2))):
                rows.append(Row(label + words, path, label, None, size, images=2, execution=execution))
    for text in arguments.model:
        label, _, rest = text.partition("=")
        path, _, against = rest.partition("@")
        if not path or (against and against not in {row.label for row in rows}):
            sys.exit(
                f"error: --model must be LABEL=FILE.onnx or LABEL=FILE.onnx@ROW with a row of the table, got {text!r}"
            )
        rows.append(Row(label, Path(path), against or label, execution=plain))
        if arguments.openvino:
            execution = Execution(backend="openvino", threads=threads)
            rows.append(Row(f"{label} OpenVINO", Path(path), against or label, execution=execution))
    return rows


def in_turns(askers: dict[str, Callable[[], Turn]], rounds: int) -> dict[str, list[Turn]]:
    """What each row took in each round: of its two sets of images the second counts."""
    turns: dict[str, list[Turn]] = {label: [] for label in askers}
    order, shuffle = list(askers), random.Random(0)
    for _ in track(range(rounds), description="rounds", total=rounds, unit="rounds"):
        shuffle.shuffle(order)
        for label in order:
            askers[label]()
            turns[label].append(askers[label]())
    return turns


def print_rows(rows: Sequence[Row], turns: dict[str, list[Turn]]) -> None:
    """The table of whole detections."""
    print(
        f"{'image in memory -> boxes':36} {'ms':>7} {'cpu ms':>7} {'boxes':>5} {'ratio':>6} {'limit':>5}  held against"
    )
    for row in rows:
        own, other = turns[row.label], turns[row.against]
        ratio = statistics.median(a.ms / b.ms for a, b in zip(own, other, strict=True))
        print(
            f"{row.label:36} {statistics.median(turn.ms for turn in own):7.1f} "
            f"{statistics.median(turn.cpu_ms for turn in own):7.1f} {own[-1].boxes:5d} {ratio:6.2f} "
            f"{'' if row.limit is None else format(row.limit, '.2f'):>5}  {row.against * (row.against != row.label)}"
        )


def parts(image: ImageArray, seconds: float) -> list[tuple[str, float, float]]:
    """Name, median milliseconds and limit of the runtime's own parts, in one thread."""
    cv2.setNumThreads(1)
    rows = []
    for width, height in (rectangle_for(IMAGE_WH, LONG_SIDE), SQUARE):
        buffer, out = InputBuffer((width, height)), np.empty((3, height, width), dtype=np.float32)
        rows.append((f"letterbox to {width}x{height}", median_ms(lambda: buffer.fill(image, out), seconds), 2.0))  # noqa: B023
    for class_count in (13, 80):
        raw = raw_output(class_count)
        letterbox = Letterbox(IMAGE_WH, SQUARE)
        name = f"decoding + NMS, 25,200 x {5 + class_count}, {len(decode(raw, letterbox, score_threshold=0.25))} lights"
        rows.append((name, median_ms(lambda: decode(raw, letterbox, score_threshold=0.25), seconds), 0.5))  # noqa: B023
    return rows


def raw_output(class_count: int) -> FloatArray:
    """A network's output at 640 x 640 that holds a few lights, each seen by several cells."""
    rng = np.random.default_rng(0)
    raw = rng.uniform(0, 0.01, (CANDIDATES, 5 + class_count)).astype(np.float32)
    rows = rng.choice(CANDIDATES, (LIGHTS, CELLS_OF_A_LIGHT), replace=False)
    raw[:, :4] = rng.uniform(10, 600, (CANDIDATES, 4))
    for i, cells in enumerate(rows):
        raw[cells, :4] = np.array([30 + 30 * i, 300, 12, 30]) + rng.normal(0, 0.5, (CELLS_OF_A_LIGHT, 4))
        raw[cells, 4] = raw[cells, 5 + i % class_count] = rng.uniform(0.6, 1, CELLS_OF_A_LIGHT)
    return raw


def median_ms(work: Callable[[], object], seconds: float) -> float:
    """Median of as many runs as fit into the time, at least twenty, after five that warm up."""
    for _ in range(5):
        work()
    times: list[float] = []
    while len(times) < 20 or sum(times) < 1e3 * seconds:
        start = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


def start_s(bundle: Path, threads: int) -> float:
    """Median time of imports, loading and the first set of frames in a new process; a first one fills the cache."""
    command = [sys.executable, "-c", START, str(bundle), str(threads)]
    times = [float(subprocess.run(command, check=True, capture_output=True, text=True).stdout) for _ in range(6)]
    return statistics.median(times[1:])


def main() -> None:
    """Parse, start all sides, let them take turns, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer-python", type=Path, help="interpreter that has PyPI's yolov5 7.0.14, onnx, onnxruntime")
    parser.add_argument("--sizes", nargs="*", choices=("n", "s"), default=["n", "s"], help="ours; empty: --model alone")
    for size in ("n", "s"):
        parser.add_argument(f"--weights-{size}", default="-", help="a public .pt of 80 classes for both sides")
    parser.add_argument(
        "--model", action="append", default=[], help="LABEL=FILE.onnx[@ROW]: one more, held against ROW"
    )
    parser.add_argument("--openvino", action="store_true", help="also time the backend OpenVINO")
    parser.add_argument("--image", type=Path, help="a picture, scaled to 1920x1200; by default soft noise")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=40)
    arguments = parser.parse_args()

    image = picture(arguments.image)
    weights = {size: getattr(arguments, f"weights_{size}") for size in arguments.sizes}
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        image_path = folder / "image.npy"
        np.save(image_path, image)
        say("exporting ...")
        exporting = multiprocessing.get_context("spawn").Process(target=export_ours, args=(weights, folder))
        exporting.start()
        exporting.join()
        if exporting.exitcode:
            sys.exit("error: our models could not be exported")
        rows = our_rows(arguments, folder)
        if not rows:
            sys.exit("error: nothing to time; give --sizes or --model")
        askers = {row.label: start_ours(row, image_path, stack) for row in rows}
        if arguments.peer_python:
            for size, path in weights.items():
                label = f"yolov5{size} 640x640"
                script = Path(__file__).with_name("peer_infer.py")
                command = [arguments.peer_python, script, image_path, size, path, arguments.threads, folder]
                askers[label] = start_peer([str(word) for word in command], folder / "peer.log", stack)
                rows.insert(next(i for i, row in enumerate(rows) if row.size == size), Row(label, None, label))
        turns = in_turns(askers, arguments.rounds)
        print(f"image {IMAGE_WH[0]}x{IMAGE_WH[1]}, {arguments.threads} threads, medians of {arguments.rounds} rounds")
        print_rows(rows, turns)
        print(f"\n{'alone, 1 thread':44} {'ms':>6} {'limit':>6}")
        for part, milliseconds, limit in parts(image, 1.0):
            print(f"{part:44} {milliseconds:6.2f} {limit:6.2f}")
        print(f"\nimport + load + first result: {start_s(folder / 'bundle', arguments.threads):.2f} s (limit 1.0 s)")


def picture(path: Path | None) -> ImageArray:
    """The image that all sides see."""
    if path is not None:
        image = cv2.imread(str(path))
        if image is None:
            sys.exit(f"error: {path}: no picture")
        return np.asarray(cv2.resize(image, IMAGE_WH), dtype=np.uint8)
    noise = np.random.default_rng(0).integers(0, 256, (75, 120, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(noise, IMAGE_WH, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)


if __name__ == "__main__":
    main()
