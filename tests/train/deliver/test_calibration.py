import math

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from autolights.core import ModelInfo
from autolights.core.errors import DataError, UsageError
from autolights.data import load_image_dataset
from autolights.infer.letterbox import InputBuffer
from autolights.train.deliver.calibration import CalibrationImages, least_divergence, least_error, measure_ranges


@pytest.fixture
def doubler():
    """2 x images, then one less."""
    nodes = [
        helper.make_node("Add", ["images", "images"], ["twice"]),
        helper.make_node("Sub", ["twice", "one"], ["out"]),
    ]
    shape = [1, 3, 32, 32]
    graph = helper.make_graph(
        nodes,
        "doubler",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("out", TensorProto.FLOAT, shape)],
        [helper.make_tensor("one", TensorProto.FLOAT, [], [1.0])],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def test_extremes_over_all_images(doubler):
    rng = np.random.default_rng(0)
    blobs = [rng.uniform(0.2, high, (1, 3, 32, 32)).astype(np.float32) for high in (0.4, 0.9, 0.6)]

    ranges = measure_ranges(doubler, ["images", "twice", "out"], blobs, "minmax")

    low, high = min(b.min() for b in blobs), max(b.max() for b in blobs)
    assert ranges == {
        "images": (0.0, pytest.approx(high)),
        "twice": (0.0, pytest.approx(2 * high)),
        "out": (pytest.approx(2 * low - 1), pytest.approx(2 * high - 1)),
    }


def test_entropy_cuts_off_what_is_rare_and_far(doubler):
    blob = np.abs(np.random.default_rng(0).normal(0.0, 0.02, (1, 3, 32, 32))).astype(np.float32)
    blob[0, 0, 0, 0] = 1.0

    ranges = measure_ranges(doubler, ["images", "twice"], [blob, blob], "entropy")

    assert ranges["images"][0] == 0
    assert 0.05 < ranges["images"][1] < 0.3
    assert ranges["twice"][1] == pytest.approx(2 * ranges["images"][1], rel=1e-3)
    assert measure_ranges(doubler, ["images"], [blob], "minmax")["images"][1] == 1


def divergence_by_hand(counts, bins, levels=128):
    """Migacz' slides, cell by cell."""
    inside = [float(c) for c in counts[:bins]]
    wanted = inside.copy()
    wanted[-1] += float(sum(counts[bins:]))
    shown = [0.0] * bins
    for level in range(levels):
        cells = [i for i in range(bins) if i * levels // bins == level]
        occupied = [i for i in cells if inside[i] > 0]
        for i in occupied:
            shown[i] = sum(inside[j] for j in cells) / len(occupied)
    total, shown_total = sum(wanted), sum(shown)
    return sum(
        w / total * math.log((w / total) / max(s / shown_total, 1e-12))
        for w, s in zip(wanted, shown, strict=True)
        if w > 0
    )


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_threshold_is_the_best_of_all(seed):
    rng = np.random.default_rng(seed)
    values = np.concatenate([np.abs(rng.normal(0, 40, 4000)), rng.uniform(150, 299, 4)])
    counts = np.bincount(values.astype(int), minlength=300)
    counts[0] = 0

    best = least_divergence(counts)

    divergences = {bins: divergence_by_hand(counts, bins) for bins in range(128, 301)}
    assert divergences[best] == pytest.approx(min(divergences.values()), abs=1e-12)
    assert best < 300


def test_squared_error_minds_what_is_far_more_than_what_is_rare(doubler):
    blob = np.abs(np.random.default_rng(0).normal(0.0, 0.02, (1, 3, 32, 32))).astype(np.float32)
    blob[0, 0, 0, :2] = 0.1, 1.0

    ranges = measure_ranges(doubler, ["images", "twice"], [blob], "mse")

    assert 0.9 < ranges["images"][1] <= 1
    assert ranges["twice"][1] == pytest.approx(2 * ranges["images"][1], rel=1e-3)


def test_squared_error_is_the_least_of_all():
    rng = np.random.default_rng(0)
    values = np.concatenate([np.abs(rng.normal(0, 40, 40_000)), rng.uniform(150, 299, 4)])

    best = least_error(np.bincount(values.astype(int), minlength=300))

    def error(threshold):
        step = threshold / 127
        return ((np.minimum(np.round(values / step), 127) * step - values) ** 2).sum()

    errors = {threshold: error(threshold) for threshold in range(1, 301)}
    assert errors[best] == pytest.approx(min(errors.values()), rel=0.02)
    assert 100 < best < 250


def test_a_flat_distribution_is_kept_whole_and_zeros_decide_nothing():
    flat = np.full(1024, 10)

    assert least_divergence(flat) == 1024
    assert least_divergence(np.concatenate([[10**9], flat[1:]])) == 1024


@pytest.fixture
def info():
    return ModelInfo(classes=("red", "green"), size_wh=(96, 64), opset=17)


def test_inputs_are_those_of_the_runtime(lights, info):
    dataset = load_image_dataset(lights, "train")

    blobs = list(CalibrationImages(dataset, info, 4))

    wanted = np.empty((3, 64, 96), dtype=np.float32)
    for blob, i in zip(blobs, (0, 4, 7, 11), strict=True):
        InputBuffer((96, 64)).fill(dataset.read(i), wanted)
        np.testing.assert_array_equal(blob[0], wanted)
    assert len(CalibrationImages(dataset, info, 100)) == len(dataset)
    with pytest.raises(UsageError, match="at least one image"):
        CalibrationImages(dataset, info, 0)


def test_images_that_do_not_decode_are_left_out(tmp_path, info, doubler):
    for part in ("images/train", "labels/train"):
        (tmp_path / part).mkdir(parents=True)
    cv2.imwrite(str(tmp_path / "images/train/a.png"), np.full((64, 96, 3), 200, dtype=np.uint8))
    (tmp_path / "labels/train/a.txt").write_text("0 0.5 0.5 0.2 0.2\n")
    (tmp_path / "images/train/b.png").write_bytes(b"no image")
    dataset = load_image_dataset(tmp_path, "train", classes=["red", "green"], val_fraction=0.0)

    assert len(list(CalibrationImages(dataset, info, 2))) == 1
    (tmp_path / "images/train/a.png").write_bytes(b"")
    with pytest.raises(DataError, match="none of the images decodes"):
        measure_ranges(doubler, ["images"], CalibrationImages(dataset, info, 2), "minmax")


def test_the_model_stays_as_it_is(doubler):
    before = doubler.SerializeToString(deterministic=True)

    measure_ranges(doubler, ["twice"], [np.ones((1, 3, 32, 32), dtype=np.float32)], "minmax")

    assert doubler.SerializeToString(deterministic=True) == before
    onnx.checker.check_model(doubler)
