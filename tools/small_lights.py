"""What finds more small lights, and what it costs: recall by height of checkpoints, input sizes, tiles and regions.

Each way is a checkpoint, the long side of its input, and, after a slash, into how many tiles a side the image is cut,
or "map" for one region around all labelled lights with the margins of the runtime, as map and pose would give it:

    python tools/small_lights.py base=best.pt@1280 larger=best.pt@1920 tiled=best.pt@1280/2 --data runs/images
    python tools/small_lights.py whole=best.pt@640 region=best.pt@640/map --data runs/images

It runs as the car would: the exported model in ONNX Runtime, what is reported at the score threshold. A light is found
if a detection of its class overlaps it by an IoU of 0.5. Milliseconds are medians from decoded image to boxes.
"""

import argparse
import re
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from autolights.core import Detections, FloatArray, ImageArray
from autolights.core.boxes import nms
from autolights.core.errors import AutolightsError, UsageError
from autolights.core.progress import track
from autolights.data import ImageDataset, load_image_dataset
from autolights.infer import Detector, Execution
from autolights.infer.letterbox import rectangle_for
from autolights.track import RegionConfig, region_of_interest
from autolights.train import export_onnx, load_checkpoint
from autolights.train.measure.operating_point import recall_by_height, sweep_thresholds
from autolights.train.measure.predictions import Labels, Predictions
from autolights.train.network.complexity import gflops

OVERLAP_PX = 96  # of neighbouring tiles: a light of that size lies whole in one of them
IOU_THRESHOLD = 0.5


@dataclass(frozen=True)
class Way:
    """One way to look at an image."""

    name: str
    checkpoint: Path
    long_side: int
    tiles: int
    in_region: bool

    @classmethod
    def parse(cls, text: str) -> "Way":
        """Read ``name=checkpoint@long_side``, and ``/tiles`` or ``/map`` after it."""
        match = re.fullmatch(r"([^=]+)=(.+)@(\d+)(?:/(\d+|map))?", text)
        if match is None:
            raise UsageError(f"a way must read name=checkpoint@long_side[/tiles or /map], got {text!r}")
        name, checkpoint, long_side, tiles = match.groups()
        in_region = tiles == "map"
        return cls(name, Path(checkpoint), int(long_side), 1 if in_region else int(tiles or 1), in_region)


def tile_windows(size_wh: tuple[int, int], tiles: int) -> list[tuple[int, int, int, int]]:
    """Left, top, right and bottom of equal windows, `tiles` to a side, that overlap and cover the image."""
    width, height = (side if tiles == 1 else -(-(side + (tiles - 1) * OVERLAP_PX) // tiles) for side in size_wh)
    lefts = np.linspace(0, size_wh[0] - width, tiles).round().astype(int).tolist()
    tops = np.linspace(0, size_wh[1] - height, tiles).round().astype(int).tolist()
    return [(left, top, left + width, top + height) for top in tops for left in lefts]


def detect_in_tiles(detector: Detector, image: ImageArray, tiles: int) -> Detections:
    """Look at each tile by itself; what is cut by an inner edge is left to the neighbour, doubles are suppressed."""
    image_wh = (image.shape[1], image.shape[0])
    boxes, scores, class_scores = [], [], []
    for window in tile_windows(image_wh, tiles):
        left, top, right, bottom = window
        seen = detector(np.ascontiguousarray(image[top:bottom, left:right]))
        moved = seen.boxes_xyxy + np.array([left, top, left, top])
        whole = ~is_cut(moved, window, image_wh)
        boxes.append(moved[whole])
        scores.append(seen.objectness[whole])
        class_scores.append(seen.class_probs[whole])
    together = Detections(np.concatenate(boxes), np.concatenate(scores), np.concatenate(class_scores))
    kept = nms(together.boxes_xyxy, together.scores, iou_threshold=IOU_THRESHOLD, max_boxes=300)
    return together[kept]


def is_cut(boxes_xyxy: FloatArray, window: tuple[int, int, int, int], image_wh: tuple[int, int]) -> FloatArray:
    """(n,) whether a box reaches an edge of the window that is no edge of the image."""
    left, top, right, bottom = window
    return (
        ((left > 0) & (boxes_xyxy[:, 0] < left + 1))
        | ((top > 0) & (boxes_xyxy[:, 1] < top + 1))
        | ((right < image_wh[0]) & (boxes_xyxy[:, 2] > right - 1))
        | ((bottom < image_wh[1]) & (boxes_xyxy[:, 3] > bottom - 1))
    )


def measure(way: Way, dataset: ImageDataset, threads: int, score_threshold: float) -> list[str]:
    """A row of the table."""
    model = load_checkpoint(way.checkpoint, classes=dataset.classes)
    image = dataset.read(0)
    left, top, right, bottom = tile_windows((image.shape[1], image.shape[0]), way.tiles)[0]
    size_wh = rectangle_for((right - left, bottom - top), way.long_side)
    labels, reported, times = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        report = export_onnx(model, Path(folder) / "model.onnx", size_wh=size_wh, score_threshold=score_threshold)
        detector = Detector(report.path, report.info, Execution(threads=threads))
        detector(image)
        for i in track(range(len(dataset)), description=way.name, total=len(dataset), unit="images"):
            image = dataset.read(i)
            image_wh = (image.shape[1], image.shape[0])
            boxes_xyxy = dataset.boxes_xyxy(i, image_wh)
            start = time.perf_counter()
            if way.in_region:
                seen = detector(image, region_of_interest(RegionConfig(), boxes_xyxy, image_wh))
            else:
                seen = detector(image) if way.tiles == 1 else detect_in_tiles(detector, image, way.tiles)
            times.append(1e3 * (time.perf_counter() - start))
            labels.append(Labels(boxes_xyxy, dataset.class_ids[i]))
            reported.append(Predictions(seen.boxes_xyxy, seen.class_ids, seen.scores))
    bands = recall_by_height(labels, reported, iou_threshold=IOU_THRESHOLD)
    sweep = sweep_thresholds(labels, reported, iou_threshold=IOU_THRESHOLD)
    precision = sweep.precision[np.searchsorted(sweep.thresholds, score_threshold)]
    return [
        way.name,
        f"{size_wh[0]}×{size_wh[1]}"
        + (f" × {way.tiles**2} tiles" if way.tiles > 1 else " of a region" * way.in_region),
        f"{gflops(model, size_wh) * way.tiles**2:.1f}",
        f"{statistics.median(times):.0f}",
        *(f"{band.recall:.3f} of {band.labels}" for band in bands),
        f"{precision:.3f}",
    ]


def main() -> None:
    """Print a markdown table, a row for each way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ways", nargs="+", help="name=checkpoint@long_side, then /tiles or /map")
    parser.add_argument("--data", type=Path, required=True, help="YOLO-format folder; its part 'val' is looked at")
    parser.add_argument("--score-threshold", type=float, default=0.25)
    parser.add_argument("--threads", type=int, default=2, help="of ONNX Runtime")
    arguments = parser.parse_args()
    try:
        dataset = load_image_dataset(arguments.data, "val")
        ways = [Way.parse(text) for text in arguments.ways]
        rows = [measure(way, dataset, arguments.threads, arguments.score_threshold) for way in ways]
    except AutolightsError as error:
        sys.exit(f"error: {error}")
    heads = ["", "input", "GFLOPs", "ms", "4–8 px", "8–16 px", "16–32 px", "32+ px", "precision"]
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for row in rows:
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
