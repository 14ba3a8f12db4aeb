"""The paper's Table II on this machine: speed and average precision of each size, beside the paper's own rows.

Of checkpoints that there are, or of a training of each size, which goes on where an earlier call was stopped:

    python tools/table_sizes.py runs/n/best.pt runs/s/best.pt --data runs/images --long-side 1280
    python tools/table_sizes.py --train train/paper 'weights=""' --sizes n s --data runs/images --out runs/table

FPS is the exported model's in ONNX Runtime, one image of the validation part after the other, from the decoded image to
boxes; the paper's is that of a GPU (RTX 3090), and its test images were real.
"""

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import torch

from autolights.core import ImageArray, load_config
from autolights.core.errors import AutolightsError
from autolights.core.progress import say
from autolights.data import ImageDataset, load_image_dataset
from autolights.infer import Detector, Execution
from autolights.infer.letterbox import rectangle_for
from autolights.train import TrainConfig, YoloV5, evaluate_detector, export_onnx, load_checkpoint, train
from autolights.train.network.complexity import gflops, parameter_count
from autolights.train.processes import ALONE
from autolights.train.run.environment import describe_environment

HEADS = ("", "parameters", "GFLOPs", "FPS", "AP", "AP50", "AP75", "AP_S", "AP_M")
PAPER_ROWS = (  # Wu et al. 2023, Table II
    ("paper's YOLOv5n", "", "", "163", "0.77", "0.93", "0.89", "0.74", "0.79"),
    ("paper's YOLOv5s", "", "", "109", "0.77", "0.93", "0.86", "0.72", "0.82"),
    ("paper's YOLOv5m", "", "", "54", "0.75", "0.92", "0.86", "0.71", "0.79"),
)
TIMED_IMAGES = 32


def frames_per_s(detector: Detector, images: Sequence[ImageArray], seconds: float) -> float:
    """One over the median time of an image, over as many as fit into the time, after three to warm up."""
    for image in images[:3]:
        detector(image)
    times: list[float] = []
    end = time.perf_counter() + seconds
    while len(times) < len(images) or time.perf_counter() < end:
        start = time.perf_counter()
        detector(images[len(times) % len(images)])
        times.append(time.perf_counter() - start)
    return 1 / statistics.median(times)


def table_row(name: str, model: YoloV5, dataset: ImageDataset, arguments: argparse.Namespace) -> tuple[str, ...]:
    """Measure one checkpoint."""
    images = [dataset.read(i) for i in range(min(len(dataset), TIMED_IMAGES))]
    size_wh = rectangle_for((images[0].shape[1], images[0].shape[0]), arguments.long_side)
    with tempfile.TemporaryDirectory() as folder:
        report = export_onnx(model, Path(folder) / "model.onnx", size_wh=size_wh)
        detector = Detector(
            report.path, report.info, Execution(providers=tuple(arguments.providers or ()), threads=arguments.threads)
        )
        fps = frames_per_s(detector, images, arguments.seconds)
    metrics = evaluate_detector(model, dataset, long_side=arguments.long_side, device=arguments.device)
    figures = (metrics.ap, metrics.ap50, metrics.ap75, metrics.ap_s, metrics.ap_m)
    return (
        f"YOLOv5{model.size} ({name})",
        f"{parameter_count(model):,}",
        f"{gflops(model, size_wh):.1f}",
        f"{fps:.1f}",
        *(f"{figure:.3f}" for figure in figures),
    )


def train_sizes(arguments: argparse.Namespace) -> list[Path]:
    """The best checkpoint of each size."""
    checkpoints = []
    config_name, *overrides = arguments.train
    for size in arguments.sizes:
        config = load_config(config_name, TrainConfig, [*overrides, f"size={size}", f"data={arguments.data}"])
        say(f"YOLOv5{size}: {config_name} into {arguments.out / size}")
        checkpoints.append(train(config, arguments.out / size, resume=True).best_path)
    return checkpoints


def main() -> None:
    """Parse, train if asked to, measure, print Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoints", type=Path, nargs="*", help="best.pt of training runs")
    parser.add_argument("--data", type=Path, required=True, help="YOLO-format folder; its part `val` is measured on")
    parser.add_argument("--long-side", type=int, default=1280, help="of the network's input, pixels")
    parser.add_argument("--train", nargs="+", metavar=("CONFIG", "KEY=VALUE"), help="train the sizes with this first")
    parser.add_argument("--sizes", nargs="+", default=["n", "s"], choices=list("nsmlx"), help="to train")
    parser.add_argument("--out", type=Path, default=Path("runs/table"), help="folder of the trainings")
    parser.add_argument("--device", default="cpu", help="on which average precision is measured")
    parser.add_argument("--providers", nargs="+", help="of ONNX Runtime, for FPS; the CPU if not given")
    parser.add_argument("--threads", type=int, help="of ONNX Runtime; its own choice if not given")
    parser.add_argument("--seconds", type=float, default=10.0, help="of timing for each size")
    arguments = parser.parse_args()
    if bool(arguments.checkpoints) == bool(arguments.train):
        parser.error("give either checkpoints or --train CONFIG")

    try:
        checkpoints = arguments.checkpoints or train_sizes(arguments)
        dataset = load_image_dataset(arguments.data, "val")
        models = [(path, load_checkpoint(path, classes=dataset.classes)) for path in checkpoints]
        rows = [table_row(path.parent.name, model, dataset, arguments) for path, model in models]
    except AutolightsError as error:
        sys.exit(f"error: {error}")
    processor = describe_environment(torch.device("cpu"), ALONE)["processor"]
    print(
        f"{len(dataset)} images at {arguments.long_side} px; {', '.join(arguments.providers or [processor])}, "
        f"{arguments.threads or 'all'} threads\n"
    )
    for row in (HEADS, ("---", *["---:"] * (len(HEADS) - 1)), *rows, *PAPER_ROWS):
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
