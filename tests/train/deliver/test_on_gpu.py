"""What is exported says the same on a GPU, where there is one, through each library that is installed."""

import importlib.util

import numpy as np
import onnxruntime
import pytest
import torch

from autolights.core.boxes import match_boxes
from autolights.core.errors import UsageError
from autolights.infer import Detector, Execution, OnnxSession
from autolights.infer.gpu import Gpu
from autolights.infer.session import CPU, CUDA
from autolights.train.deliver.export import export_onnx
from autolights.train.deliver.tensorrt_engine import build_engine

SIZE_WH = (320, 192)
FORMS = [
    pytest.param({"head": "raw"}, id="raw"),
    pytest.param({"head": "end2end"}, id="end2end"),
    pytest.param({"head": "raw", "precision": "fp16"}, id="raw-fp16"),
    pytest.param({"head": "end2end", "precision": "fp16", "half_io": True}, id="end2end-half-io"),
    pytest.param({"head": "raw", "dynamic_batch": True, "dynamic_size": True}, id="raw-free"),
    pytest.param({"head": "end2end", "dynamic_batch": True}, id="end2end-free-batch"),
]


@pytest.fixture(scope="module")
def gpu():
    try:
        return Gpu()
    except UsageError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def cuda_provider():
    if CUDA not in onnxruntime.get_available_providers():
        pytest.skip("needs onnxruntime-gpu")
    if not torch.cuda.is_available():
        pytest.skip("needs a GPU")
    return Execution(providers=(CUDA, CPU))


def exported(model, image, folder, form):
    report = export_onnx(model, folder / "model.onnx", size_wh=SIZE_WH, images=[image], **form)
    return report.path, report.info


def assert_same_lights(found, wanted, info):
    """To what halves leave of a probability, or another order of sums."""
    assert len(wanted) >= 6
    a, b = match_boxes(found.boxes_xyxy, wanted.boxes_xyxy, iou_threshold=0.8)
    assert len(a) == len(found) == len(wanted)
    tolerance = 0.05 if info.precision == "fp16" else 0.001
    np.testing.assert_allclose(found.objectness[a], wanted.objectness[b], atol=tolerance)
    np.testing.assert_allclose(found.class_probs[a], wanted.class_probs[b], atol=tolerance)


@pytest.mark.parametrize("form", FORMS)
def test_cuda_provider_finds_what_the_cpu_finds(cuda_provider, base, street, tmp_path, form):
    path, info = exported(base, street, tmp_path, form)

    detector = Detector(path, info, cuda_provider)
    for images in ([street], [street, street[:, ::-1].copy()], [street]):  # the batch changes, and back
        for found, wanted in zip(detector.batch(images), Detector(path, info).batch(images), strict=True):
            assert_same_lights(found, wanted, info)


@pytest.mark.parametrize("io_binding", [False, True])
@pytest.mark.parametrize("free", [False, True])
def test_cuda_provider_keeps_nothing_of_the_last_call(cuda_provider, base, street, tmp_path, io_binding, free):
    form = {"head": "raw", "dynamic_batch": free, "dynamic_size": free}
    path, info = exported(base, street, tmp_path, form)
    on_gpu = OnnxSession(path, info, providers=cuda_provider.providers, io_binding=io_binding)
    assert on_gpu.on_gpu
    on_cpu = OnnxSession(path, info)
    random = np.random.default_rng(1)

    usual = (1, 3, 192, 320)
    for shape in [usual, usual, (3, 3, 96, 128) if free else usual, usual]:
        blob = random.random(shape, dtype=np.float32)
        np.testing.assert_allclose(on_gpu.run(blob)[0][..., 4:], on_cpu.run(blob)[0][..., 4:], atol=0.001)


def test_memory_of_the_gpu(gpu):
    if torch.cuda.is_available():
        assert gpu.info.compute_capability == ".".join(map(str, torch.cuda.get_device_capability()))
        assert gpu.info.name == torch.cuda.get_device_name()
    sent = np.random.default_rng(2).random((3, 100, 70), dtype=np.float32)
    back = np.zeros_like(sent)

    address = gpu.allocate(sent.nbytes)
    gpu.upload(address, sent)
    gpu.download(back, address)
    gpu.wait()
    gpu.free(address)

    np.testing.assert_array_equal(back, sent)
    with pytest.raises(UsageError, match="CUDA cannot be used here: cudaMalloc: out of memory"):
        gpu.allocate(1 << 50)


@pytest.mark.skipif(not importlib.util.find_spec("tensorrt"), reason="needs TensorRT")
@pytest.mark.parametrize("form", FORMS)
def test_engine_finds_what_the_cpu_finds(gpu, base, street, tmp_path, form):
    path, info = exported(base, street, tmp_path, form)

    described = build_engine(path, info)

    assert described.gpu == gpu.info.name
    assert described.layer_types.get("unknown", 0) == 0
    detector = Detector(path, info, Execution(backend="tensorrt"))
    for images in ([street], [street, street[:, ::-1].copy()], [street]):
        for found, wanted in zip(detector.batch(images), Detector(path, info).batch(images), strict=True):
            assert_same_lights(found, wanted, info)
