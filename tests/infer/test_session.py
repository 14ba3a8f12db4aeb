import numpy as np
import onnxruntime
import pytest

from autolights.core.errors import DataError, UsageError
from autolights.infer import session as session_module
from autolights.infer.session import CPU, CUDA, OnnxSession

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


def test_what_cuda_cannot_record_runs_unrecorded(constant_model, monkeypatch):
    """A stand-in for CUDA: it computes on the CPU, and the session that is to be recorded fails in its first run."""
    started = []

    class Session(onnxruntime.InferenceSession):
        def __init__(self, model, options, providers, **how):
            settings = providers[0][1]
            started.append(settings)
            self.settings = settings
            super().__init__(model, options, providers=[CPU], **how)

        def get_providers(self):
            return [CUDA, CPU]

        def run_with_iobinding(self, binding):
            if "enable_cuda_graph" in self.settings:
                raise RuntimeError("capture failed")
            super().run_with_iobinding(binding)

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [CUDA, CPU])
    monkeypatch.setattr(onnxruntime, "InferenceSession", Session)
    monkeypatch.setitem(session_module._DEVICES, CUDA, "cpu")
    session = OnnxSession(*constant_model([ROW]), providers=[CUDA, CPU], io_binding=True)

    for _ in range(2):
        (raw,) = session.run(np.zeros((1, 3, 32, 64), dtype=np.float32))
        np.testing.assert_allclose(raw, [[ROW]], rtol=1e-6)

    exact = {"cudnn_conv_algo_search": "HEURISTIC", "use_tf32": "0"}
    assert started == [{**exact, "enable_cuda_graph": "1"}, exact]


def test_halves_may_use_tensor_cores_and_free_shapes_are_not_recorded(spot_model, monkeypatch):
    started = []
    start = onnxruntime.InferenceSession
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [CUDA, CPU])
    monkeypatch.setattr(start, "get_providers", lambda self: [CUDA, CPU])
    monkeypatch.setattr(
        onnxruntime,
        "InferenceSession",
        lambda model, options, providers, **how: started.append(providers[0][1]) or start(model, options),
    )
    monkeypatch.setitem(session_module._DEVICES, CUDA, "cpu")

    OnnxSession(*spot_model(half_io=True, precision="fp16"), providers=[CUDA, CPU], io_binding=True)
    OnnxSession(*spot_model(dynamic_size=True), providers=[CUDA, CPU], io_binding=True)
    OnnxSession(*spot_model(), providers=[CUDA, CPU], io_binding=True, one_launch=False)

    assert ["use_tf32" in settings for settings in started] == [False, True, True]
    assert ["enable_cuda_graph" in settings for settings in started] == [True, False, False]


def test_a_bound_model_of_fixed_size_refuses_another(spot_model):
    session = OnnxSession(*spot_model(), io_binding=True)

    with pytest.raises(ValueError, match=r"the model takes \[1, 3, 32, 64\], got \[1, 3, 64, 64\]"):
        session.run(np.zeros((1, 3, 64, 64), dtype=np.float32))


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
