"""Labelled images in the YOLO layout: a folder of images beside a folder of text files."""

import dataclasses
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Self

import cv2
import numpy as np

from autolights.core.arrays import FloatArray, ImageArray, IntArray
from autolights.core.boxes import xyxy_from_cxcywh
from autolights.core.config import read_yaml
from autolights.core.errors import DataError, UsageError
from autolights.core.image_files import IMAGE_ENDINGS
from autolights.core.progress import say
from autolights.data.image_labels import LabelWarnings, read_labels

Split = Literal["train", "val"]


@dataclass(frozen=True, eq=False)
class ImageDataset:
    """Images with labelled boxes; the images are decoded when they are asked for.

    Attributes:
        root: The folder that was read.
        classes: Class names; labels are indices into them.
        image_paths: One for each image.
        class_ids: Per image (n,).
        boxes_cxcywh: Per image (n, 4) centre, width and height as fractions of the image.
        signals: Signal description that the folder's ``data.yaml`` names; empty if it names none.
        warnings: What was unusual when it was read.
    """

    root: Path
    classes: tuple[str, ...]
    image_paths: tuple[Path, ...]
    class_ids: tuple[IntArray, ...]
    boxes_cxcywh: tuple[FloatArray, ...]
    signals: str = ""
    warnings: LabelWarnings = field(default_factory=LabelWarnings)

    def __post_init__(self) -> None:
        if not len(self.image_paths) == len(self.class_ids) == len(self.boxes_cxcywh):
            raise ValueError("image_paths, class_ids and boxes_cxcywh must have one entry per image")

    def __len__(self) -> int:
        return len(self.image_paths)

    @property
    def label_count(self) -> int:
        """Labels of all images together."""
        return sum(len(ids) for ids in self.class_ids)

    @property
    def class_counts(self) -> IntArray:
        """(C,) labels of each class."""
        ids = np.concatenate([np.empty(0, dtype=np.int64), *self.class_ids])
        return np.bincount(ids, minlength=len(self.classes))

    @property
    def empty_classes(self) -> tuple[str, ...]:
        """Classes that have no label here."""
        return tuple(name for name, count in zip(self.classes, self.class_counts, strict=True) if not count)

    @property
    def fingerprint(self) -> str:
        """Hash of the images' names and sizes and of all labels.

        Times of change are left out, so that a copy on another machine is the same data.
        """
        digest = hashlib.sha256(repr(self.classes).encode())
        for path, ids, boxes in zip(self.image_paths, self.class_ids, self.boxes_cxcywh, strict=True):
            size = path.stat().st_size if path.is_file() else -1
            digest.update(f"{path.name}|{size}|".encode())
            digest.update(ids.astype("<i8").tobytes() + boxes.astype("<f8").tobytes())
        return digest.hexdigest()

    def subset(self, indices: Sequence[int]) -> Self:
        """Only these images, in this order."""
        return dataclasses.replace(
            self,
            image_paths=tuple(self.image_paths[i] for i in indices),
            class_ids=tuple(self.class_ids[i] for i in indices),
            boxes_cxcywh=tuple(self.boxes_cxcywh[i] for i in indices),
        )

    def read(self, index: int) -> ImageArray:
        """Decode one image, BGR.

        Raises:
            DataError: If the file is missing, does not decode or ends too early.
        """
        path = self.image_paths[index]
        try:
            # Not imread: that fills what a truncated JPEG lacks with grey, where imdecode refuses it.
            image = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_COLOR)
        except OSError as error:
            raise DataError(f"{path}: cannot be read ({error.strerror})") from error
        except cv2.error:  # an empty file
            image = None
        if image is None:
            raise DataError(f"{path}: not an image that can be decoded; replace or delete it")
        return np.asarray(image, dtype=np.uint8)

    def boxes_xyxy(self, index: int, size_wh: tuple[int, int]) -> FloatArray:
        """(n, 4) boxes of one image in pixels of an image of `size_wh`."""
        scale = np.array([*size_wh, *size_wh], dtype=np.float64)
        return np.asarray(xyxy_from_cxcywh(self.boxes_cxcywh[index]) * scale)


def load_image_dataset(
    folder: Path,
    split: Split,
    *,
    classes: Sequence[str] | None = None,
    val_fraction: float = 0.0,
    group_pattern: str | None = None,
) -> ImageDataset:
    """Read one part of a YOLO-format folder.

    With a ``data.yaml`` (``names``, ``train``, ``val``) its word counts; without one the layouts ``train/images`` and
    ``images/train`` are known. A folder that has only a train part is split by the hash of each image's group, so that
    the split does not depend on the order or number of files.

    Args:
        folder: Where the data lie.
        split: Which part.
        classes: Class names, where no ``data.yaml`` gives them.
        val_fraction: Share of the groups held out, used only if there is no part ``val``.
        group_pattern: Regular expression with one group, matched against file names; files whose first group is equal
            stay on one side. None makes each file its own group.

    Raises:
        UsageError: If the folder or the part is missing, holds no image, the class names are unknown, or the split
            leaves one side without an image.
        DataError: If ``data.yaml`` or a label breaks the format; the text names file and line.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder")
    description = _read_description(folder / "data.yaml")
    names = _class_names(folder, description, classes)
    images = _image_folder(folder, split, description)
    if images is None:
        images = _image_folder(folder, "train", description)
        if images is None or not val_fraction:
            raise UsageError(
                f"{folder}: no images for '{split}'; expected {split}/images or images/{split}, with labels beside them"
                + ("; or set val_fraction to hold out a share of the training part" if split == "val" else "")
            )
    paths = sorted(path for path in images.iterdir() if path.suffix.lower() in IMAGE_ENDINGS)
    if not paths:
        raise UsageError(f"{images}: holds no image ({', '.join(sorted(IMAGE_ENDINGS))})")
    if val_fraction and _image_folder(folder, "val", description) is None:
        paths = _split_by_group(paths, split, val_fraction, group_pattern)
        if not paths:
            raise UsageError(
                f"{images}: val_fraction {val_fraction:g} leaves no image for '{split}'; choose another share"
            )
    return _with_labels(folder, names, paths, images, str(description.get("signals") or ""))


def _read_description(path: Path) -> dict[str, object]:
    if not path.is_file():
        return {}
    values = read_yaml(path)
    if not isinstance(values, dict):
        raise DataError(f"{path}: must hold keys and values, got {type(values).__name__}")
    return values


def _class_names(folder: Path, description: dict[str, object], classes: Sequence[str] | None) -> tuple[str, ...]:
    named = description.get("names")
    if isinstance(named, dict):
        if sorted(named) != list(range(len(named))):
            raise DataError(f"{folder / 'data.yaml'}: names must be numbered 0 to {len(named) - 1}, got {list(named)}")
        named = [named[i] for i in range(len(named))]
    if named is None:
        if not classes:
            raise UsageError(f"{folder}: has no data.yaml with the class names; give them as classes=[name, ...]")
        return tuple(classes)
    if not isinstance(named, list) or not named:
        raise DataError(f"{folder / 'data.yaml'}: names must be a list of class names, got {named!r}")
    names = tuple(str(name) for name in named)
    if classes and tuple(classes) != names:
        raise UsageError(f"{folder / 'data.yaml'} names the classes {list(names)}, but {list(classes)} were asked for")
    return names


def _image_folder(folder: Path, split: Split, description: dict[str, object]) -> Path | None:
    named = description.get(split)
    candidates = [folder / str(named)] if named else []
    candidates += [folder / split / "images", folder / "images" / split]
    return next((candidate for candidate in candidates if candidate.is_dir()), None)


def _split_by_group(paths: Sequence[Path], split: Split, val_fraction: float, group_pattern: str | None) -> list[Path]:
    pattern = _compiled(group_pattern) if group_pattern else None

    def held_out(path: Path) -> bool:
        match = pattern.search(path.name) if pattern else None
        group = match.group(1) if match else path.name
        digest = hashlib.sha256(group.encode()).digest()
        return int.from_bytes(digest[:8], "big") < val_fraction * 2**64

    return [path for path in paths if held_out(path) == (split == "val")]


def _compiled(group_pattern: str) -> re.Pattern[str]:
    try:
        pattern = re.compile(group_pattern)
    except re.error as error:
        raise UsageError(f"group_pattern {group_pattern!r} is no regular expression: {error}") from error
    if not pattern.groups:
        raise UsageError(
            f"group_pattern {group_pattern!r} must have a group in parentheses that names the source photo"
        )
    return pattern


def _with_labels(
    folder: Path, names: tuple[str, ...], paths: Sequence[Path], images: Path, signals: str
) -> ImageDataset:
    labels = _label_folder(images)
    if not labels.is_dir():
        raise UsageError(f"{labels}: no such folder; the labels of {images} belong there")
    read = [read_labels(labels / f"{path.stem}.txt", len(names)) for path in paths]
    warnings = sum((of_image.warnings for of_image in read), LabelWarnings())
    if warnings.without_label_file == len(paths):
        raise UsageError(f"{labels}: holds no label file for any of the {len(paths)} images in {images}")
    if str(warnings):
        say(f"{images}: {warnings}")
    return ImageDataset(
        root=folder,
        classes=names,
        image_paths=tuple(paths),
        class_ids=tuple(of_image.class_ids for of_image in read),
        boxes_cxcywh=tuple(of_image.boxes_cxcywh for of_image in read),
        signals=signals,
        warnings=warnings,
    )


def _label_folder(images: Path) -> Path:
    """``train/images`` → ``train/labels``; ``images/train`` → ``labels/train``: the last such part counts."""
    parts = list(images.parts)
    for i in reversed(range(len(parts))):
        if parts[i] == "images":
            parts[i] = "labels"
            return Path(*parts)
    raise UsageError(
        f"{images}: some part of the path must be called 'images', so that 'labels' can be found beside it"
    )
