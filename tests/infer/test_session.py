import numpy as np
import onnxruntime
import pytest

from autolights.core.errors import DataError, UsageError
from autolights.infer.session import CPU, OnnxSession

ROW = [32, 16, 10, 20, 0.9, 0.8, 0.1]


def test_runs(constant_model):
    session = OnnxSession(*constant_model([ROW]), threads=1)

    (raw,) = session.run(np.zeros((1, 3, 32, 64), dtype=np.float32))

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


def test_provider_that_does_not_start(constant_model, monkeypatch):
    # What ONNX Runtime does where a provider's libraries are missing: it goes on without it and says nothing.
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CUDAExecutionProvider", CPU])
    monkeypatch.setattr(onnxruntime.InferenceSession, "get_providers", lambda self: [CPU])
    start = onnxruntime.InferenceSession
    monkeypatch.setattr(onnxruntime, "InferenceSession", lambda path, options, providers: start(path, options))

    with pytest.raises(UsageError, match=r"'CUDAExecutionProvider' does not start here; it needs onnxruntime-gpu"):
        OnnxSession(*constant_model([ROW]), providers=["CUDAExecutionProvider", CPU])


def test_io_binding_gives_the_same(spot_model):
    model = spot_model(head="end2end", dynamic_batch=True, dynamic_size=True)
    plain, bound = OnnxSession(*model), OnnxSession(*model, io_binding=True)
    random = np.random.default_rng(0)

    for shape in [(1, 3, 32, 64), (1, 3, 32, 64), (3, 3, 64, 96), (1, 3, 32, 64)]:
        blob = random.random(shape, dtype=np.float32)
        before = blob.copy()
        for got, wanted in zip(bound.run(blob), plain.run(blob), strict=True):
            np.testing.assert_array_equal(got, wanted)
        np.testing.assert_array_equal(blob, before)


@pytest.mark.parametrize(
    ("form", "described_as", "message"),
    [
        pytest.param({}, {"half_io": True}, "input must be float16 as described, got float32", id="not-half"),
        pytest.param({"half_io": True}, {"half_io": False}, "must be float32 as described, got float16", id="half"),
        pytest.param({}, {"dynamic_batch": True}, r"\[\?, 3, 32, 64\] as described, got \[\[1,", id="one-image"),
        pytest.param({"dynamic_size": True}, {"dynamic_size": False}, r"got \[\[1, 3, \?, \?\]\]", id="free-size"),
        pytest.param({}, {"head": "end2end"}, "boxes, scores, classes and class_probs, got output;", id="raw"),
        pytest.param({"head": "end2end"}, {"head": "raw"}, r"output must be \[1, N, 7\] for 2 classes", id="end2end"),
        pytest.param(
            {"head": "end2end"},
            {"classes": ("a", "b", "c")},
            r"class_probs must be \[\?, \?, 3\] for 3 classes, got \[1, 5, 2\]",
            id="end2end-of-other-classes",
        ),
    ],
)
def test_model_that_is_not_as_described(spot_model, form, described_as, message):
    path, info = spot_model(**form)

    with pytest.raises(DataError, match=message):
        OnnxSession(path, info.model_copy(update=described_as))


def test_spinning_is_never_unlimited(constant_model, monkeypatch):
    (raw,) = OnnxSession(*constant_model([ROW]), threads=2, spin_us=50).run(np.zeros((1, 3, 32, 64), dtype=np.float32))
    np.testing.assert_allclose(raw, [[ROW]], rtol=1e-6)

    monkeypatch.setattr(onnxruntime, "__version__", "1.22.0")  # does not know the limit
    with pytest.raises(UsageError, match=r"spin_us needs ONNX Runtime 1\.26 or newer, this is 1\.22\.0"):
        OnnxSession(*constant_model([ROW]), threads=2, spin_us=50)
