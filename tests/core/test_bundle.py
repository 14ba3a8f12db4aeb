import hashlib
import json
from dataclasses import replace

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from autolights.core import Bundle, ConfusionMatrix, CountedWith, InitialWeights, ModelInfo, load_signals
from autolights.core.errors import BundleError, UsageError
from autolights.core.model_info import load_model_info
from autolights.train.deliver.hmm_fitting import fit_hmm

SIGNALS = load_signals()
FILES = ["confusion.json", "hmm.json", "manifest.json", "model.onnx", "signals.yaml"]


def passing_through() -> onnx.ModelProto:
    port = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, 416, 640])
    node = helper.make_node("Identity", ["images"], ["output"])
    return helper.make_model(helper.make_graph([node], "through", [port], [port]))


WEIGHTS = passing_through().SerializeToString()


@pytest.fixture
def bundle(tmp_path):
    model = tmp_path / "exported.onnx"
    model.write_bytes(WEIGHTS)
    confusion = ConfusionMatrix(SIGNALS.classes, np.eye(14, dtype=np.int64), 0.25, 0.5)
    weights = InitialWeights(name="yolov5n.pt", sha256="0" * 64, licence="AGPL-3.0")
    info = ModelInfo(classes=SIGNALS.classes, size_wh=(640, 416), opset=17, initial_weights=weights)
    return Bundle(info, model, SIGNALS, fit_hmm(confusion, SIGNALS), confusion)


@pytest.fixture
def folder(bundle, tmp_path):
    bundle.save(tmp_path / "bundle")
    return tmp_path / "bundle"


def test_reads_back(bundle, folder):
    read = Bundle.load(folder)

    assert sorted(path.name for path in folder.iterdir()) == FILES
    assert (read.model, read.signals) == (bundle.model, bundle.signals)
    assert read.model_path.read_bytes() == WEIGHTS
    assert read.confusion.to_json() == bundle.confusion.to_json()
    assert {name: hmm.to_json() for name, hmm in read.hmm.items()} == {
        name: hmm.to_json() for name, hmm in bundle.hmm.items()
    }


def test_may_be_moved(folder, tmp_path):
    moved = folder.rename(tmp_path / "elsewhere")

    assert Bundle.load(moved).model_path == moved / "model.onnx"


@pytest.mark.parametrize("name", [name for name in FILES if name != "manifest.json"])
def test_altered_file_is_refused(folder, name):
    (folder / name).write_bytes((folder / name).read_bytes() + b" ")

    with pytest.raises(BundleError, match=rf"{name}: its SHA-256 differs from the manifest's"):
        Bundle.load(folder)


@pytest.mark.parametrize("name", FILES)
def test_incomplete_bundle(folder, name):
    (folder / name).unlink()

    with pytest.raises(BundleError, match=rf"{name}: (missing; copy the whole bundle|cannot be read .* is this a)"):
        Bundle.load(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param(
            {"format_version": 4}, r"manifest\.json: format 4 is newer than 3; upgrade autolights", id="newer"
        ),
        pytest.param({"format_version": 1}, r"manifest\.json: format 1 is older than 3; make it again", id="older"),
        pytest.param({"format_version": None}, r"manifest\.json: no format_version; is this a bundle\?", id="none"),
        pytest.param({"colour": "red"}, r"manifest\.json: colour: Extra inputs are not permitted", id="unknown-key"),
        pytest.param({"model": {}}, r"manifest\.json: model.classes: Field required", id="field"),
    ],
)
def test_manifests_that_are_refused(folder, change, message):
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))

    with pytest.raises(BundleError, match=message):
        Bundle.load(folder)


def test_old_bundle_is_kept_unless_forced(bundle, folder):
    with pytest.raises(UsageError, match="exists already"):
        bundle.save(folder)
    bundle.save(folder, force=True)

    Bundle.load(folder)


def test_missing_model_leaves_nothing_behind(bundle, tmp_path):
    bundle.model_path.unlink()

    with pytest.raises(BundleError, match=r"exported\.onnx: no such model; make one with `autolights export`"):
        bundle.save(tmp_path / "bundle")

    assert list(tmp_path.iterdir()) == []


def test_parts_that_do_not_fit(bundle):
    with pytest.raises(BundleError, match=r"the model knows the classes \['red'\], the signal description"):
        replace(bundle, model=bundle.model.model_copy(update={"classes": ("red",)}))
    with pytest.raises(BundleError, match=r"hmm\.json has no model for type '5dh'; run `autolights fit-hmm` again"):
        replace(bundle, hmm={name: hmm for name, hmm in bundle.hmm.items() if name != "5dh"})
    with pytest.raises(BundleError, match="the states of type '3' are not those of the signal description"):
        replace(bundle, hmm={**bundle.hmm, "3": bundle.hmm["4"]})


def test_description_beside_a_model(bundle, tmp_path):
    (tmp_path / "model.json").write_text(bundle.model.model_dump_json())

    assert load_model_info(tmp_path / "model.onnx") == bundle.model
    (tmp_path / "model.json").write_text("{}")
    with pytest.raises(BundleError, match=r"model\.json: classes: Field required"):
        load_model_info(tmp_path / "model.onnx")
    with pytest.raises(BundleError, match=r"gone\.json: cannot be read .*; `autolights export` writes it"):
        load_model_info(tmp_path / "gone.onnx")


def test_model_that_reaches_out_is_not_saved(bundle, tmp_path):
    model = passing_through()
    model.graph.node[0].domain = "evil"
    bundle.model_path.write_bytes(model.SerializeToString())

    with pytest.raises(BundleError, match=r"exported\.onnx: node '' \(Identity\) uses operators of the domain 'evil'"):
        bundle.save(tmp_path / "bundle")
    assert not (tmp_path / "bundle").exists()


@pytest.mark.parametrize("name", FILES)
def test_links_out_of_the_folder_are_refused(folder, tmp_path, name):
    (folder / name).rename(tmp_path / "elsewhere")
    (folder / name).symlink_to(tmp_path / "elsewhere")

    with pytest.raises(BundleError, match=rf"{name}: a link out of the bundle"):
        Bundle.load(folder)


@pytest.mark.parametrize("names", [["model.onnx"], [*FILES[:4], "../secret"], ["/etc/passwd"]])
def test_manifest_that_names_other_files_is_refused(folder, names):
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "sha256": dict.fromkeys(names, "0" * 64)}))

    with pytest.raises(BundleError, match=r"sha256 must name model\.onnx, signals\.yaml, .*, got"):
        Bundle.load(folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        pytest.param("[" * 100_000, "nested too deeply", id="deep"),
        pytest.param('{"a": 1, "a": 2}', "key 'a' is repeated", id="twice"),
        pytest.param('{"format_version": ' + "9" * 5000 + "}", "not JSON", id="endless-number"),
        pytest.param('{"a": "' + "x" * 33 * 2**20 + '"}', "more than the 33,554,432", id="large"),
        pytest.param("\xff", "not JSON", id="no-text"),
    ],
)
def test_hostile_manifests_are_refused_in_words(folder, text, message):
    (folder / "manifest.json").write_text(text, encoding="latin-1")

    with pytest.raises(BundleError, match=rf"manifest\.json: .*{message}"):
        Bundle.load(folder)


def test_head_without_class_vectors_is_refused(bundle):
    with pytest.raises(BundleError, match="efficient-nms yields no class vectors"):
        replace(bundle, model=bundle.model.model_copy(update={"head": "efficient-nms"}))


@pytest.fixture
def int8(bundle):
    """The same bundle with a model in 8 bits, and a confusion matrix counted with it."""
    counted_with = CountedWith(hashlib.sha256(WEIGHTS).hexdigest(), "int8")
    confusion = replace(bundle.confusion, counted_with=counted_with)
    info = bundle.model.model_copy(update={"precision": "int8"})
    return replace(bundle, model=info, confusion=confusion, hmm=fit_hmm(confusion, SIGNALS))


def test_an_int8_model_comes_with_its_own_errors(int8, tmp_path):
    int8.save(tmp_path / "bundle")

    assert Bundle.load(tmp_path / "bundle").confusion.counted_with == int8.confusion.counted_with


@pytest.mark.parametrize("part", ["confusion matrix", "HMM of type '3'"])
@pytest.mark.parametrize(
    ("counted_with", "named"),
    [
        pytest.param(None, "an unknown model", id="unknown"),
        pytest.param(CountedWith("ab" * 32, "fp32"), "the fp32 model abababababab…", id="float"),
    ],
)
def test_an_int8_model_with_the_errors_of_another_is_refused(int8, tmp_path, part, counted_with, named):
    other = replace(int8.confusion, counted_with=counted_with)
    wrong = replace(int8, confusion=other) if part == "confusion matrix" else replace(int8, hmm=fit_hmm(other, SIGNALS))

    with pytest.raises(
        BundleError, match=rf"the {part} was counted with {named}, not with this int8 model .* `fit-hmm`"
    ):
        wrong.save(tmp_path / "bundle")

    assert not (tmp_path / "bundle").exists()


def test_an_int8_bundle_put_together_by_hand_is_refused(int8, tmp_path):
    folder = tmp_path / "bundle"
    int8.save(folder)
    replace(int8.confusion, counted_with=None).save(folder / "confusion.json")
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["sha256"]["confusion.json"] = hashlib.sha256((folder / "confusion.json").read_bytes()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))

    with pytest.raises(BundleError, match="the confusion matrix was counted with an unknown model"):
        Bundle.load(folder)
