import importlib.util
import itertools
import subprocess

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from autolights.core import ModelInfo
from autolights.core.errors import DataError, UsageError
from autolights.train.deliver import tensorrt_check
from autolights.train.deliver.calibration import measure_ranges
from autolights.train.deliver.export import in_precision
from autolights.train.deliver.onnx_file import finish, trace
from autolights.train.deliver.quantization import QuantizableModel
from autolights.train.deliver.tensorrt_check import COMPUTE_CAPABILITIES, check_tensorrt
from autolights.train.deliver.tensorrt_shapes import input_shapes, trtexec_command

needs_tensorrt = pytest.mark.skipif(
    importlib.util.find_spec("tensorrt_rtx") is None, reason="TensorRT for RTX is not installed"
)
ODD = helper.make_model(
    helper.make_graph(
        [helper.make_node("Relu", ["x"], ["a"]), helper.make_node("Det", ["a"], ["y"], name="odd")],
        "odd",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 3, 3])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, [1])],
    ),
    opset_imports=[helper.make_opsetid("", 17)],
)


def described(network, **options):
    return ModelInfo(classes=network.classes, size_wh=(128, 96), max_detections=50, opset=17, **options)


@pytest.fixture
def odd(tmp_path, model):
    onnx.save(ODD, tmp_path / "odd.onnx")
    return tmp_path / "odd.onnx", described(model)


def in_8_bits(proto):
    """Calibrated on noise, without the layers that `quantize` leaves in float for accuracy."""
    quantizable = QuantizableModel(proto)
    noise = [np.random.default_rng(3).random((1, 3, 96, 128), dtype=np.float32)]
    return quantizable.quantize("tensorrt", measure_ranges(proto, quantizable.tensors("tensorrt"), noise, "minmax"))


@needs_tensorrt
@pytest.mark.parametrize(
    ("head", "precision", "freedom"),
    [
        *itertools.product(["raw", "end2end"], ["fp32", "fp16", "int8"], ["fixed", "dynamic"]),
        ("efficient-nms", "fp32", "fixed"),
    ],
)
def test_tensorrt_builds_every_form(model, tmp_path, head, precision, freedom):
    free = freedom == "dynamic"
    info = described(model, head=head, precision=precision, dynamic_batch=free, dynamic_size=free)
    path = tmp_path / "model.onnx"
    proto = trace(model, info)
    onnx.save(finish(in_8_bits(proto) if precision == "int8" else in_precision(proto, info), info), path)

    check = check_tensorrt(path, info)

    assert check.is_ok, check.to_text()
    check.raise_if_refused()
    assert [build.compute_capability for build in check.builds] == list(COMPUTE_CAPABILITIES)
    assert all(build.engine_bytes > 1_000_000 for build in check.builds)
    assert check.to_text().count("OK (") == 4
    assert ("all up to the plug-in" in check.to_text()) == (head == "efficient-nms")


@needs_tensorrt
def test_half_precision_makes_half_an_engine(model, tmp_path):
    sizes = {}
    for precision in ("fp32", "fp16"):
        info = described(model, precision=precision)
        onnx.save(finish(in_precision(trace(model, info), info), info), tmp_path / "model.onnx")
        sizes[precision] = check_tensorrt(tmp_path / "model.onnx", info, ["8.6"]).builds[0].engine_bytes

    assert sizes["fp16"] < 0.65 * sizes["fp32"]


@needs_tensorrt
def test_refusal_names_the_node(odd):
    check = check_tensorrt(*odd, ["8.6"])

    assert not check.is_ok
    assert "compute capability 8.6: node 'odd' (Det): " in check.to_text()
    with pytest.raises(DataError, match=r"odd\.onnx: TensorRT for RTX does not build it for 8\.6; see above"):
        check.raise_if_refused()


@needs_tensorrt
def test_a_gpu_that_the_sibling_lacks_is_said(model, tmp_path):
    info = described(model)
    onnx.save(finish(trace(model, info), info), tmp_path / "model.onnx")

    (build,) = check_tensorrt(tmp_path / "model.onnx", info, ["9.0"]).builds

    assert "builds for SM75, SM80, SM86, SM89" in build.error


def test_a_builder_that_dies_is_an_answer(odd, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    died = subprocess.CompletedProcess([], returncode=-11, stdout="", stderr="first\nSegmentation fault\n")
    monkeypatch.setattr(subprocess, "run", lambda *args, **kwargs: died)

    assert "the builder ended with code -11 (Segmentation fault)" in check_tensorrt(*odd, ["8.6"]).to_text()


def test_a_builder_that_hangs_is_an_answer(odd, monkeypatch):
    def hang(command, **options):
        raise subprocess.TimeoutExpired(command, options["timeout"])

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(subprocess, "run", hang)

    assert "not built within 600 s" in check_tensorrt(*odd, ["8.6"]).to_text()


def test_without_the_package_it_says_what_to_install(odd, monkeypatch):
    monkeypatch.setattr(tensorrt_check.importlib.util, "find_spec", lambda name: None)

    with pytest.raises(UsageError, match=r"pip install 'autolights\[check-tensorrt\]'"):
        check_tensorrt(*odd)


def test_compute_capability_must_read_like_one(odd, monkeypatch):
    monkeypatch.setattr(tensorrt_check.importlib.util, "find_spec", lambda name: object())

    with pytest.raises(UsageError, match=r"reads like 8\.6, got 'SM86'"):
        check_tensorrt(*odd, ["SM86"])


def test_shapes_of_free_sizes(model):
    assert set(input_shapes(described(model))) == {(1, 3, 96, 128)}
    assert input_shapes(described(model, dynamic_batch=True)) == ((1, 3, 96, 128), (1, 3, 96, 128), (8, 3, 96, 128))
    assert input_shapes(described(model, dynamic_size=True)) == ((1, 3, 32, 32), (1, 3, 96, 128), (1, 3, 192, 256))
    assert input_shapes(described(model, dynamic_size=True, head="end2end")).smallest == (1, 3, 96, 96)


def test_command_for_the_target(model, tmp_path):
    path = tmp_path / "model.onnx"

    fixed, free = (trtexec_command(path, described(model, dynamic_batch=batch)) for batch in (False, True))

    assert fixed == f"trtexec --onnx={path} --saveEngine={tmp_path}/model.engine --stronglyTyped"
    assert free == (
        f"{fixed} --minShapes=images:1x3x96x128 --optShapes=images:1x3x96x128 --maxShapes=images:8x3x96x128"
    )
