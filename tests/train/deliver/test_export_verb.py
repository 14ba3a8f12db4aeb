import json

import pytest

from autolights.cli.delivery import export
from autolights.core.errors import DataError, UsageError
from autolights.core.model_info import load_model_info
from autolights.train.deliver import tensorrt_check
from autolights.train.deliver.tensorrt_check import TensorRtBuild, TensorRtCheck
from autolights.train.network.weights import weights_path


def test_options_reach_the_model(tmp_path, capsys, monkeypatch):
    seen = []

    def check(path, info, compute_capabilities):
        seen.append((path, info.head, tuple(compute_capabilities)))
        return TensorRtCheck(path, (TensorRtBuild("8.6", engine_bytes=2**20, seconds=1.0),))

    monkeypatch.setattr(tensorrt_check, "check_tensorrt", check)
    out = tmp_path / "model.onnx"

    export(
        weights_path("base"),
        out,
        size="128x96",
        head="end2end",
        precision="fp16",
        dynamic=["batch"],
        max_detections=30,
        nms_iou_threshold=0.4,
        check_tensorrt=True,
        compute_capability=["8.6"],
    )

    info = load_model_info(out)
    assert (info.size_wh, info.head, info.precision, info.max_detections) == ((128, 96), "end2end", "fp16", 30)
    assert (info.dynamic_batch, info.dynamic_size, info.nms_iou_threshold) == (True, False, 0.4)
    assert seen == [(out, "end2end", ("8.6",))]
    printed = capsys.readouterr()
    first, _, rest = printed.out.partition("\n")
    assert json.loads(first.partition(": ")[2]) == info.parity
    assert "compute capability 8.6: OK (1.0 MiB, 1.0 s)" in rest
    assert f"trtexec --onnx={out} --saveEngine={tmp_path}/model.engine --stronglyTyped --minShapes=" in printed.err


def test_a_model_that_was_exported_is_only_checked(tmp_path, capsys, monkeypatch):
    out = tmp_path / "model.onnx"
    export(weights_path("base"), out, size="128x96")
    before = out.stat().st_mtime_ns
    refused = TensorRtCheck(out, (TensorRtBuild("7.5", error="node 'x' (Y): no"), TensorRtBuild("8.6", engine_bytes=1)))
    monkeypatch.setattr(tensorrt_check, "check_tensorrt", lambda *_: refused)

    with pytest.raises(DataError, match=r"does not build it for 7\.5; see above"):
        export(out, check_tensorrt=True)

    assert "compute capability 7.5: node 'x' (Y): no" in capsys.readouterr().out
    assert out.stat().st_mtime_ns == before
    with pytest.raises(UsageError, match="is exported already; give --tensorrt or --check-tensorrt"):
        export(out)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        pytest.param({"head": "yolo"}, "--head must be raw, end2end or efficient-nms, got 'yolo'", id="head"),
        pytest.param({"precision": "fp8"}, "--precision must be fp32, fp16 or int8, got 'fp8'", id="precision"),
        pytest.param({"dynamic": ["width"]}, "--dynamic must be batch or size, got 'width'", id="dynamic"),
        pytest.param({"size": "960"}, "--size must read WIDTHxHEIGHT", id="size"),
        pytest.param({"dla": 0}, "--dla is a choice of --tensorrt", id="dla"),
    ],
)
def test_misuse_is_told_before_anything_is_loaded(tmp_path, options, text):
    with pytest.raises(UsageError, match=text):
        export(tmp_path / "none.pt", tmp_path / "model.onnx", **options)


def test_what_is_there_stays(tmp_path):
    (tmp_path / "model.engine").write_bytes(b"engine")

    with pytest.raises(UsageError, match=r"model\.engine: exists already"):
        export(tmp_path / "none.pt", tmp_path / "model.onnx", tensorrt=True)
