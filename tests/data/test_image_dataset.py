import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from autolights.core.errors import DataError, UsageError
from autolights.data import load_image_dataset
from autolights.data.image_labels import LabelWarnings

SHARED = Path(__file__).parents[2].parent / "shared"
CLASSES = ["green", "red"]


def write_folder(root: Path, labels: dict[str, str | None], *, images: str = "images/train") -> Path:
    """A folder of 40 × 20 images; a name whose labels are None gets no label file."""
    image_dir = root / images
    label_dir = root / images.replace("images", "labels")
    image_dir.mkdir(parents=True)
    label_dir.mkdir(parents=True)
    for name, text in labels.items():
        cv2.imwrite(str(image_dir / f"{name}.png"), np.full((20, 40, 3), 90, np.uint8))
        if text is not None:
            (label_dir / f"{name}.txt").write_text(text)
    return root


@pytest.mark.parametrize("images", ["images/train", "train/images"])
def test_both_layouts_are_read(tmp_path: Path, images: str) -> None:
    folder = write_folder(tmp_path, {"b": "1 0.5 0.5 0.5 0.5", "a": ""}, images=images)

    dataset = load_image_dataset(folder, "train", classes=CLASSES)

    assert [path.stem for path in dataset.image_paths] == ["a", "b"]
    assert [ids.tolist() for ids in dataset.class_ids] == [[], [1]]
    np.testing.assert_allclose(dataset.boxes_xyxy(1, (40, 20)), [[10, 5, 30, 15]])
    assert dataset.read(1).shape == (20, 40, 3)


def test_data_yaml_names_classes_and_parts(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, {"a": "2 .5 .5 .1 .1"}, images="photos/images/part1")
    (folder / "data.yaml").write_text(
        "names: {0: a, 1: off, 2: c}\ntrain: photos/images/part1\nsignals: autolights_13\n"
    )

    dataset = load_image_dataset(folder, "train")

    assert dataset.classes == ("a", "off", "c")
    assert dataset.signals == "autolights_13"


def test_oddities_are_counted_and_repaired(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    labels = {
        "outside": "0 0.0 0.5 0.5 0.5\n1 1.5 0.5 0.2 0.2\n",
        "unlabelled": None,
        "outline": "0 0.1 0.2 0.3 0.2 0.3 0.6 0.2 0.7 0.1 0.6",
        "twice": "1 0.5 0.5 0.2 0.2\n0 0.5 0.5 0.2 0.2\n1 0.50 0.5 0.2 0.2\n",
    }
    dataset = load_image_dataset(write_folder(tmp_path, labels), "train", classes=CLASSES)

    assert dataset.warnings == LabelWarnings(without_label_file=1, clipped_boxes=2, dropped_boxes=1, duplicate_boxes=1)
    np.testing.assert_allclose(dataset.boxes_cxcywh[1], [[0.125, 0.5, 0.25, 0.5]])
    np.testing.assert_allclose(dataset.boxes_cxcywh[0], [[0.2, 0.45, 0.2, 0.5]])
    assert dataset.class_ids[2].tolist() == [1, 0]
    assert "2 boxes cut at the image's edge" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "message"),
    [
        pytest.param("0 .5 .5 .5", r"a\.txt:2: must read 'class", id="four-numbers"),
        pytest.param("0 .5 .5 .5 nan", r"a\.txt:2: must read 'class", id="not-finite"),
        pytest.param("red .5 .5 .5 .5", r"a\.txt:2: must hold numbers only, got 'red", id="a-word"),
        pytest.param("2 .5 .5 .5 .5", r"a\.txt:2: class must be 0 to 1, got 2", id="class-too-high"),
        pytest.param("-1 .5 .5 .5 .5", r"a\.txt:2: class must be 0 to 1, got -1", id="negative-class"),
        pytest.param("0 .5 .5 -.2 .5", r"a\.txt:2: ", id="negative-width"),
        pytest.param("0.5 .5 .5 .5 .5", r"a\.txt:2: class must be 0 to 1, got 0\.5", id="half-a-class"),
        pytest.param("0 20 10 8 8", r"a\.txt:2: .*fractions of the image, not pixels", id="pixels"),
        pytest.param("0 20 10 28 10 28 18", r"a\.txt:2: .*fractions of the image, not pixels", id="outline-in-pixels"),
    ],
)
def test_bad_label_line_is_named(tmp_path: Path, line: str, message: str) -> None:
    folder = write_folder(tmp_path, {"a": f"0 .5 .5 .1 .1\n{line}\n"})

    with pytest.raises(DataError, match=message):
        load_image_dataset(folder, "train", classes=CLASSES)


@pytest.mark.parametrize("ending", [".jpg", ".png", ".bmp"])
@pytest.mark.parametrize("kept", [0.0, 0.6, 0.99], ids=["empty", "half", "end-missing"])
def test_image_that_is_not_whole_is_named(tmp_path: Path, ending: str, kept: float) -> None:
    folder = write_folder(tmp_path, {"a": ""})
    whole = cv2.imencode(ending, np.random.default_rng(0).integers(0, 255, (40, 60, 3), dtype=np.uint8))[1].tobytes()
    (folder / "images/train/a.png").write_bytes(whole[: int(kept * len(whole))])

    with pytest.raises(DataError, match=r"a\.png: not an image"):
        load_image_dataset(folder, "train", classes=CLASSES).read(0)


def test_image_that_went_away_is_named(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, {"a": ""})
    dataset = load_image_dataset(folder, "train", classes=CLASSES)
    (folder / "images/train/a.png").unlink()

    with pytest.raises(DataError, match=r"a\.png: cannot be read \(No such file"):
        dataset.read(0)


def test_classes_without_labels_are_known(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, {"a": "1 .5 .5 .1 .1\n1 .2 .2 .1 .1", "b": ""})
    dataset = load_image_dataset(folder, "train", classes=[*CLASSES, "off"])

    assert dataset.class_counts.tolist() == [0, 2, 0]
    assert dataset.empty_classes == ("green", "off")
    assert dataset.subset([1]).empty_classes == ("green", "red", "off")


def test_fingerprint_follows_content_not_place(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "here", {"a": "1 .5 .5 .1 .1", "b": ""})
    shutil.copytree(folder, tmp_path / "there")

    def fingerprint(place: str) -> str:
        return load_image_dataset(tmp_path / place, "train", classes=CLASSES).fingerprint

    first = fingerprint("here")
    assert fingerprint("there") == first
    (tmp_path / "there/labels/train/a.txt").write_text("0 .5 .5 .1 .1")
    assert fingerprint("there") != first
    with (tmp_path / "here/images/train/b.png").open("ab") as image:
        image.write(b"more")
    assert fingerprint("here") != first


def test_missing_parts_say_what_was_expected(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="nowhere: no such folder"):
        load_image_dataset(tmp_path / "nowhere", "train")
    folder = write_folder(tmp_path / "data", {"a": ""})
    with pytest.raises(UsageError, match=r"no data\.yaml with the class names"):
        load_image_dataset(folder, "train")
    with pytest.raises(UsageError, match=r"no images for 'val'; .*val_fraction"):
        load_image_dataset(folder, "val", classes=CLASSES)


def test_split_keeps_groups_together_whatever_else_lies_there(tmp_path: Path) -> None:
    names = [f"photo{i}.rf.{version}" for i in range(40) for version in "abc"]
    folder = write_folder(tmp_path, dict.fromkeys(names, ""))
    split = {"classes": CLASSES, "val_fraction": 0.25, "group_pattern": r"^(.*)\.rf\."}

    train = {path.name for path in load_image_dataset(folder, "train", **split).image_paths}
    val = {path.name for path in load_image_dataset(folder, "val", **split).image_paths}

    assert len(train | val) == 120
    assert not train & val
    assert not {name.split(".")[0] for name in train} & {name.split(".")[0] for name in val}
    assert 3 < len(val) < 60
    for name in sorted(train)[:30]:
        (folder / "images/train" / name).unlink()
    assert {path.name for path in load_image_dataset(folder, "val", **split).image_paths} == val


def test_cinta_splits_by_source_photo() -> None:
    folder = SHARED / "data/cinta_v2"
    if not folder.is_dir():
        pytest.skip("the public photo set cinta_v2 is not here")
    split = {"classes": ["green", "red", "yellow"], "val_fraction": 0.15, "group_pattern": r"^(.*)\.rf\."}

    train, val = (load_image_dataset(folder, part, **split) for part in ("train", "val"))

    assert len(train) + len(val) == 2097
    assert train.label_count + val.label_count == 2749
    sources = [{path.name.split(".rf.")[0] for path in part.image_paths} for part in (train, val)]
    assert not sources[0] & sources[1]
