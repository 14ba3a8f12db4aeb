"""Labelled images: the same seed gives the same bytes, and labels agree with what was painted."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml

from autolights.core import load_config, load_signals
from autolights.core.errors import UsageError
from autolights.sim import ImagesConfig, simulate_images
from autolights.sim.config import NARROW, WIDE
from autolights.sim.images import draw_plans, draw_shown, simulate_image
from autolights.sim.town import build_town

SIGNALS = load_signals()
SMALL = tuple(camera.model_copy(update={"size_wh": (320, 200)}) for camera in (NARROW, WIDE))


def small_config(**changes: object) -> ImagesConfig:
    values = {"train_images": 4, "val_images": 2, "cameras": SMALL, "min_height_px": 5.0, "workers": 1, **changes}
    return ImagesConfig.model_validate(values)


def contents(folder: Path) -> dict[str, bytes]:
    files = sorted(folder.glob("*/*/*"))
    return {str(file.relative_to(folder)): file.read_bytes() for file in files}


def test_same_seed_same_bytes_whatever_the_number_of_workers(tmp_path: Path) -> None:
    simulate_images(small_config(), tmp_path / "one")
    simulate_images(small_config(workers=2), tmp_path / "two")
    simulate_images(small_config(seed=2), tmp_path / "other")
    one, two, other = (contents(tmp_path / name) for name in ("one", "two", "other"))
    assert len(one) == 12
    assert one == two
    assert all(one[name] != other[name] for name in one if name.endswith(".jpg"))


def test_the_folder_is_a_yolo_data_set(tmp_path: Path) -> None:
    simulate_images(small_config(), tmp_path / "set")
    description = yaml.safe_load((tmp_path / "set" / "data.yaml").read_text())
    assert description == {
        "names": list(SIGNALS.classes),
        "train": "images/train",
        "val": "images/val",
        "signals": "autolights_13",
    }
    labels = sorted((tmp_path / "set" / "labels" / "train").glob("*.txt"))
    images = sorted((tmp_path / "set" / "images" / "train").glob("*.jpg"))
    assert [file.stem for file in labels] == [file.stem for file in images] == [f"train_{i:05d}" for i in range(4)]
    rows = np.array([line.split() for file in labels for line in file.read_text().splitlines()], dtype=float)
    assert set(rows[:, 0]) <= set(range(len(SIGNALS.classes)))
    low, high = rows[:, 1:3] - rows[:, 3:] / 2, rows[:, 1:3] + rows[:, 3:] / 2
    assert low.min() > -1e-5
    assert high.max() < 1 + 1e-5


def test_an_output_that_exists_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(UsageError, match="exists already"):
        simulate_images(small_config(), tmp_path)
    assert (tmp_path / "mine.txt").read_text() == "precious"


def test_lit_lamps_shine_where_the_labels_say() -> None:
    calm = {"washout": (0.2, 0.2), "brightness": (1.0, 1.0), "share": 0.0}
    config = small_config(
        cameras=(NARROW,),
        disturbance=calm,
        lighting={"dusk": 1.0},
        max_occlusion=0.02,
        min_height_px=30,
        min_inside=1.0,
    )
    checked = 0
    for index in range(8):
        labelled = simulate_image(config, "train", index)
        for class_id, (left, top, right, bottom) in zip(labelled.class_ids, labelled.boxes_xyxy, strict=True):
            name = SIGNALS.classes[class_id]
            kind, lit = SIGNALS.types[SIGNALS.type_of[name]], SIGNALS.state(name).lit
            # Where no lamp is lit, or an arrow of a few pixels is among them, brightness alone says little.
            if len(lit) != 1 or kind.lamps[lit[0]].shape != "ball":
                continue
            brightness = {}
            for lamp_name, lamp in kind.lamps.items():
                x = left + lamp.center[0] * (right - left)
                y = top + lamp.center[1] * (bottom - top)
                reach = max(1, round(0.06 * (bottom - top)))
                patch = labelled.image_bgr[int(y) - reach : int(y) + reach + 1, int(x) - reach : int(x) + reach + 1]
                brightness[lamp_name] = float(patch.max(axis=2).mean())
            assert max(brightness, key=lambda lamp: brightness[lamp]) == lit[0], f"image {index}: {name}"
            checked += 1
    assert checked >= 8


def test_all_classes_are_about_equally_frequent() -> None:
    config = small_config()
    counts: Counter[str] = Counter()
    for seed in range(120):
        rng = np.random.default_rng(seed)
        town = build_town(SIGNALS, draw_plans(SIGNALS, rng, empty=False), rng)
        shown = draw_shown(config, SIGNALS, town, rng)
        counts.update(shown[head.id].lit_class for head in town.heads if head.group != "oncoming")
    total = sum(counts.values())
    assert all(counts[name] > 0.05 * total for name in SIGNALS.classes)


def test_a_town_without_signals_has_no_labels() -> None:
    labelled = simulate_image(small_config(empty_share=0.999), "train", 0)
    assert labelled.class_ids == ()
    assert labelled.boxes_xyxy.shape == (0, 4)


@pytest.mark.parametrize("name", ["sim/images_base", "sim/images_demo"])
def test_shipped_configurations_load(name: str) -> None:
    assert load_config(name, ImagesConfig).train_images >= 400


def test_shipped_towns_differ() -> None:
    seeds = {load_config(name, ImagesConfig).seed for name in ("sim/images_base", "sim/images_demo")}
    assert len(seeds) == 2
