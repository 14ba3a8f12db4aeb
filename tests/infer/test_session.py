import numpy as np
import pytest

from autolights.core.errors import DataError, UsageError
from autolights.infer.session import OnnxSession

ROW = [32, 16, 10, 20, 0.9, 0.8, 0.1]


def test_runs(constant_model):
    session = OnnxSession(*constant_model([ROW]), threads=1)

    raw = session.run(np.zeros((1, 3, 32, 64), dtype=np.float32))

    np.testing.assert_allclose(raw, [[ROW]], rtol=1e-6)


def test_missing_model(constant_model, tmp_path):
    _, info = constant_model([ROW])

    with pytest.raises(UsageError, match=r"gone\.onnx: no such model; make one with `autolights export`"):
        OnnxSession(tmp_path / "gone.onnx", info)


def test_file_that_is_no_model(constant_model, tmp_path):
    _, info = constant_model([ROW])
    (tmp_path / "broken.onnx").write_bytes(b"not a protobuf")

    with pytest.raises(DataError, match=r"broken\.onnx: ONNX Runtime cannot read it"):
        OnnxSession(tmp_path / "broken.onnx", info)


def test_input_of_another_size(constant_model):
    path, info = constant_model([ROW], size_wh=(64, 32))

    with pytest.raises(DataError, match=r"input must be \[1, 3, 416, 640\] as described, got \[\[1, 3, 32, 64\]\]"):
        OnnxSession(path, info.model_copy(update={"size_wh": (640, 416)}))


def test_output_of_other_classes(constant_model):
    path, info = constant_model([ROW])

    with pytest.raises(DataError, match=r"output must be \[1, N, 8\] for 3 classes, got \[\[1, 1, 7\]\]"):
        OnnxSession(path, info.model_copy(update={"classes": ("3-red", "3-green", "3-yellow")}))


def test_provider_that_is_not_there(constant_model):
    with pytest.raises(UsageError, match=r"no provider 'AbacusProvider' here; there are: .*CPUExecutionProvider"):
        OnnxSession(*constant_model([ROW]), providers=["AbacusProvider"])
