"""Time the runtime's detector: letterbox, network, decoding; medians in milliseconds.

With a bundle its own model is timed, else a nano with random weights (needs the training stack):

    python tools/bench_infer.py --sizes 640x416 960x608 --threads 1 2
    python tools/bench_infer.py --bundle runs/demo/bundle
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from autolights.core import Bundle, ModelInfo
from autolights.infer import OnnxSession, decode
from autolights.infer.letterbox import InputBuffer

IMAGE_WH = (1280, 800)


def median_ms(work: Callable[[], object], seconds: float) -> float:
    """Median of as many runs as fit into the time, at least ten, after three that warm up."""
    for _ in range(3):
        work()
    times: list[float] = []
    end = time.perf_counter() + seconds
    while len(times) < 10 or time.perf_counter() < end:
        start = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


def random_nano(size_wh: tuple[int, int], folder: Path) -> tuple[Path, ModelInfo]:
    """Export a nano with 13 classes and random weights."""
    import torch

    from autolights.train.deliver.export import export_onnx
    from autolights.train.network.model import YoloV5

    torch.manual_seed(0)
    report = export_onnx(YoloV5("n", 13), folder / "nano.onnx", size_wh=size_wh)
    return report.path, report.info


def bench(model_path: Path, info: ModelInfo, threads: int, seconds: float) -> None:
    """Print one line."""
    width, height = info.size_wh
    random = np.random.default_rng(0)
    image = random.integers(0, 256, (IMAGE_WH[1], IMAGE_WH[0], 3), dtype=np.uint8)
    session = OnnxSession(model_path, info, threads=threads)
    buffer, blob = InputBuffer(info.size_wh), np.empty((1, 3, height, width), dtype=np.float32)
    letterbox = buffer.fill(image, blob[0])
    raw = session.run(blob)[0][0].copy()
    raw[:, 4:] = 0.01
    raw[random.choice(len(raw), 50, replace=False), 4:] = 0.9  # about what ten lights leave above the threshold

    fill_ms = median_ms(lambda: buffer.fill(image, blob[0]), seconds / 4)
    run_ms = median_ms(lambda: session.run(blob), seconds)
    decode_ms = median_ms(lambda: decode(raw, letterbox, score_threshold=info.score_threshold), seconds / 4)
    print(
        f"{width}x{height}  threads {threads}  letterbox {fill_ms:.2f}  network {run_ms:.1f}  "
        f"decode {decode_ms:.2f}  sum {fill_ms + run_ms + decode_ms:.1f} ms"
    )


def main() -> None:
    """Parse, time, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bundle", type=Path, help="time this bundle's model")
    parser.add_argument("--sizes", nargs="+", default=["640x416", "960x608"], help="inputs of the random nano")
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--seconds", type=float, default=4.0, help="per size and number of threads")
    arguments = parser.parse_args()

    print(f"image {IMAGE_WH[0]}x{IMAGE_WH[1]}")
    with tempfile.TemporaryDirectory() as folder:
        if arguments.bundle:
            bundle = Bundle.load(arguments.bundle)
            models = [(bundle.model_path, bundle.model)]
        else:
            sizes = [tuple(map(int, size.split("x"))) for size in arguments.sizes]
            models = [random_nano((width, height), Path(folder) / f"{width}x{height}") for width, height in sizes]
        for model_path, info in models:
            for threads in arguments.threads:
                bench(model_path, info, threads, arguments.seconds)


if __name__ == "__main__":
    main()
