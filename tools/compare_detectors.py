r"""Compare two detectors on the same photos: AP50 and AP, their difference and its 95 % interval over photos.

Each side is one or more files of COCO results, e.g. of trainings with several seeds: ``predictions.json`` of
`autolights val --save-predictions`, or what the public YOLOv5 writes with --save-json. The data are named as in
`autolights val`; images that share the first group of --group-pattern count as one photo.

    python tools/compare_detectors.py photos --val-fraction 0.15 --group-pattern '^(.*)\.rf\.' \
        --a runs/ours_0/predictions.json runs/ours_1/predictions.json --b runs/theirs/predictions.json
"""

import argparse
import re
import sys
from pathlib import Path

from autolights.core.errors import AutolightsError, DataError
from autolights.data import ImageDataset, load_image_dataset
from autolights.train.measure.bootstrap import compare_detectors
from autolights.train.measure.predictions import Labels, load_predictions


def read_labels(dataset: ImageDataset) -> tuple[list[Path], list[Labels]]:
    """Of the images that decode; `autolights val` leaves out the others too."""
    paths, labels = [], []
    for i, path in enumerate(dataset.image_paths):
        try:
            height, width = dataset.read(i).shape[:2]
        except DataError as error:
            print(f"left out: {error}", file=sys.stderr)
            continue
        paths.append(path)
        labels.append(Labels(dataset.boxes_xyxy(i, (width, height)), dataset.class_ids[i]))
    return paths, labels


def photo_of(path: Path, group_pattern: str | None) -> str:
    """The first group of the pattern, or the whole name."""
    match = re.search(group_pattern, path.name) if group_pattern else None
    return match.group(1) if match else path.name


def main() -> None:
    """Parse, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="YOLO-format folder")
    parser.add_argument("--a", type=Path, nargs="+", required=True, help="predictions of the first detector, by run")
    parser.add_argument("--b", type=Path, nargs="+", required=True, help="predictions of the second detector, by run")
    parser.add_argument("--split", choices=["train", "val"], default="val")
    parser.add_argument("--classes", help="comma-separated names, for a folder without data.yaml")
    parser.add_argument("--val-fraction", type=float, default=0.0)
    parser.add_argument("--group-pattern")
    parser.add_argument("--resamples", type=int, default=2000, help="how often the photos are drawn (2000)")
    parser.add_argument("--seed", type=int, default=0, help="of the draws")
    arguments = parser.parse_args()

    try:
        dataset = load_image_dataset(
            arguments.data,
            arguments.split,
            classes=arguments.classes.split(",") if arguments.classes else None,
            val_fraction=arguments.val_fraction,
            group_pattern=arguments.group_pattern,
        )
        paths, labels = read_labels(dataset)
        photos = [photo_of(path, arguments.group_pattern) for path in paths]
        a, b = (
            [load_predictions(path, paths, len(dataset.classes)) for path in files]
            for files in (arguments.a, arguments.b)
        )
    except AutolightsError as error:
        sys.exit(f"error: {error}")
    label_count = sum(len(image.class_ids) for image in labels)
    print(f"{len(paths)} images of {len(set(photos))} photos, {label_count} labels; {len(a)} and {len(b)} runs")
    figures = compare_detectors(
        labels,
        photos,
        a,
        b,
        class_count=len(dataset.classes),
        resamples=arguments.resamples,
        seed=arguments.seed,
    )
    print("          A      B    A - B  95 % interval")
    for name, figure in zip(("AP50", "AP"), figures, strict=True):
        print(
            f"{name:5} {figure.a:6.4f} {figure.b:6.4f}  {figure.difference:+.4f}  "
            f"{figure.low:+.4f} to {figure.high:+.4f}"
        )


if __name__ == "__main__":
    main()
