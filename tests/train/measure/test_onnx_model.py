from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from autolights.core import Bundle, load_signals
from autolights.core.atomic import sha256
from autolights.core.errors import BundleError, UsageError
from autolights.data import load_image_dataset
from autolights.infer import Detector
from autolights.train import export_onnx, fit_hmm
from autolights.train.measure.onnx_model import ExportedModel
from autolights.train.measure.validate import detect_dataset
from autolights.train.network.model import YoloV5

CLASSES = ("green", "red", "yellow")
SIZE_WH = (64, 64)


@pytest.fixture(scope="module")
def network():
    """It has learned nothing, but it sees much."""
    torch.manual_seed(3)
    network = YoloV5("n", 3, CLASSES)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.1)
            module.running_var.uniform_(0.5, 1.5)
    for convolution in network.detect.m:
        nn.init.normal_(convolution.weight, std=0.5)
        nn.init.normal_(convolution.bias, std=0.5)
    return network.eval()


@pytest.fixture
def dataset(lights):
    return replace(load_image_dataset(lights, "val"), classes=CLASSES)


@pytest.mark.parametrize("dynamic", ["fixed", "batch", "size"])
def test_figures_are_those_of_the_network(network, dataset, tmp_path, dynamic):
    report = export_onnx(
        network,
        tmp_path / "model.onnx",
        size_wh=SIZE_WH,
        dynamic_batch=dynamic == "batch",
        dynamic_size=dynamic == "size",
    )

    found = detect_dataset(ExportedModel.open(report.path), dataset, batch_size=3, progress=False)

    wanted = detect_dataset(network, dataset, long_side=64, progress=False)
    assert sum(len(image.scores) for image in wanted.predictions) > 100
    for ours, theirs in zip(found.predictions, wanted.predictions, strict=True):
        # Of the rows of such a network some overlap by just the threshold, and rounding decides who is suppressed.
        difference = np.abs(np.sort(ours.scores) - np.sort(theirs.scores))
        assert (difference > 1e-4).mean() < 0.02
    assert found.metrics().confusion.counts.tolist() == wanted.metrics().confusion.counts.tolist()
    assert found.metrics().to_json().keys() == wanted.metrics().to_json().keys()
    counted_with = found.metrics().confusion.counted_with
    assert (counted_with.sha256, counted_with.precision) == (sha256(report.path), "fp32")
    assert wanted.metrics().confusion.counted_with is None


@pytest.mark.parametrize("head", ["raw", "end2end"])
def test_what_is_reported_is_what_the_detector_reports(network, dataset, tmp_path, head):
    report = export_onnx(network, tmp_path / "model.onnx", size_wh=(96, 64), head=head)  # letterboxed
    detector = Detector(report.path, report.info)

    found = detect_dataset(ExportedModel(report.path, report.info), dataset, score_threshold=0.25, progress=False)

    for i, image in enumerate(found.reported):
        wanted = detector(dataset.read(i))
        assert len(wanted) > 3
        np.testing.assert_allclose(image.above(0.25).boxes_xyxy, wanted.boxes_xyxy)
        np.testing.assert_allclose(image.above(0.25).scores, wanted.scores)


def test_each_class_of_a_chosen_light_is_a_prediction(network, dataset, tmp_path):
    report = export_onnx(network, tmp_path / "model.onnx", size_wh=SIZE_WH, head="end2end", max_detections=10)
    model = ExportedModel(report.path, report.info)
    found = detect_dataset(model, dataset, progress=False)

    for image in found.predictions:
        rows = sorted(zip(image.boxes_xyxy.sum(axis=1).tolist(), image.class_ids.tolist(), strict=True))
        assert 10 < len(rows) <= 30  # nearly every class of ten lights is above a score of 0.001
        assert len({left for left, _ in rows}) == 10


def test_a_bundle_is_measured_too(network, dataset, tmp_path):
    signals = load_signals("signals/three_lamp")
    report = export_onnx(network, tmp_path / "model.onnx", size_wh=SIZE_WH)
    alone = detect_dataset(ExportedModel.open(report.path), dataset, progress=False).metrics()
    bundle = Bundle(report.info, report.path, signals, fit_hmm(alone.confusion, signals), alone.confusion)
    bundle.save(tmp_path / "bundle")

    bundled = detect_dataset(ExportedModel.open(tmp_path / "bundle"), dataset, progress=False).metrics()

    assert bundled.confusion.to_json() == alone.confusion.to_json()


def test_misuse_is_named(network, dataset, tmp_path):
    with pytest.raises(UsageError, match="no such model"):
        ExportedModel.open(tmp_path / "gone.onnx")
    report = export_onnx(network, tmp_path / "model.onnx", size_wh=SIZE_WH)
    model = ExportedModel(report.path, report.info.model_copy(update={"classes": ("red", "blue", "grey")}))
    with pytest.raises(
        UsageError, match=r"the model knows the classes \['red', 'blue', 'grey'\], the data of .* 'yellow'\]"
    ):
        detect_dataset(model, dataset, progress=False)
    report.path.with_suffix(".json").unlink()
    with pytest.raises(BundleError, match="export"):
        ExportedModel.open(report.path)
