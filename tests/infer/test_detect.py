import json
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import count

import cv2
import numpy as np
import pytest
from pycocotools.coco import COCO
from typer.testing import CliRunner

from autolights.cli.app import app
from autolights.core import Bundle, ConfusionMatrix, load_signals
from autolights.core.errors import UsageError
from autolights.data.image_labels import read_labels
from autolights.detect import detect_files
from autolights.infer import Detector, Execution, sources
from autolights.train.deliver.hmm_fitting import fit_hmm

SIGNALS = load_signals()


@pytest.fixture
def bundle_dir(constant_model, tmp_path):
    """A detector that always sees one red light in the middle."""
    probs = [0.0] * len(SIGNALS.classes)
    probs[SIGNALS.class_ids["3-red"]] = 0.8
    path, info = constant_model([[32, 16, 10, 20, 0.5, *probs]], classes=SIGNALS.classes)
    confusion = ConfusionMatrix(SIGNALS.classes, np.zeros((14, 14), dtype=np.int64), 0.25, 0.5)
    Bundle(info, path, SIGNALS, fit_hmm(confusion, SIGNALS), confusion).save(tmp_path / "bundle")
    return tmp_path / "bundle"


@pytest.fixture(autouse=True)
def ctrl_c_interrupts():
    """Also where the tests themselves run in the background, which ignores it."""
    earlier = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, earlier)


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    cv2.imwrite(str(folder / "a.png"), np.zeros((32, 64, 3), dtype=np.uint8))
    cv2.imwrite(str(folder / "b.png"), np.zeros((64, 128, 3), dtype=np.uint8))
    (folder / "c.jpg").write_bytes(b"broken")
    return folder


def test_lines_pictures_and_counts(bundle_dir, photos, tmp_path, capsys):
    summary = detect_files(bundle_dir, [photos], tmp_path / "out", execution=Execution(threads=1))

    assert (summary.images, summary.detections, summary.skipped, summary.bad_frames) == (2, 2, 1, 0)
    assert summary.images_per_s > 0
    lines = [json.loads(line) for line in (tmp_path / "out" / "detections.jsonl").read_text().splitlines()]
    assert lines[1] == {
        "path": str(photos / "b.png"),
        "frame": None,
        "boxes_xyxy": [[54.0, 12.0, 74.0, 52.0]],
        "scores": [0.4],
        "classes": ["3-red"],
    }
    pictures = sorted((tmp_path / "out" / "pictures").iterdir())
    assert [cv2.imread(str(path)).shape for path in pictures] == [(32, 64, 3), (64, 128, 3)]
    assert "c.jpg: does not decode, skipped" in capsys.readouterr().err


def test_threshold_and_pictures_are_settings(bundle_dir, photos, tmp_path):
    summary = detect_files(bundle_dir, [photos], tmp_path / "out", score_threshold=0.5, pictures=False)

    assert (summary.images, summary.detections) == (2, 0)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["detections.jsonl"]


def test_nothing_half_written_is_left_behind(bundle_dir, photos, tmp_path):
    with pytest.raises(UsageError, match=r"none of the 1 inputs gave an image, the first: .*c\.jpg"):
        detect_files(bundle_dir, [photos / "c.jpg"], tmp_path / "out")

    assert sorted(path.name for path in tmp_path.iterdir()) == ["bundle", "constant.onnx", "photos"]


def test_an_old_result_is_kept_unless_forced(bundle_dir, photos, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "old.txt").write_text("old")

    with pytest.raises(UsageError, match="exists already"):
        detect_files(bundle_dir, [photos], tmp_path / "out")
    detect_files(bundle_dir, [photos], tmp_path / "out", force=True)

    assert not (tmp_path / "out" / "old.txt").exists()


def test_detector_of_a_bundle(bundle_dir):
    detector = Detector.from_bundle(Bundle.load(bundle_dir))

    assert (detector.classes, detector.score_threshold) == (SIGNALS.classes, 0.25)
    assert len(detector(np.zeros((32, 64, 3), dtype=np.uint8))) == 1


def test_yolo_labels_are_read_back_as_labels(bundle_dir, photos, tmp_path):
    detect_files(bundle_dir, [photos], tmp_path / "out", formats=["yolo"], scores=False, pictures=False)

    labels = read_labels(tmp_path / "out/labels/b.txt", len(SIGNALS.classes))
    np.testing.assert_allclose(labels.boxes_cxcywh, [[0.5, 0.5, 20 / 128, 40 / 64]], atol=1e-6)
    assert (tmp_path / "out/classes.txt").read_text().splitlines() == list(SIGNALS.classes)


def test_yolo_scores_are_a_sixth_column(bundle_dir, photos, tmp_path):
    detect_files(bundle_dir, [photos / "a.png"], tmp_path / "out", formats=["yolo"], pictures=False)

    class_id = SIGNALS.class_ids["3-red"]
    assert (tmp_path / "out/labels/a.txt").read_text() == f"{class_id} 0.500000 0.500000 0.156250 0.625000 0.400000\n"


def test_coco_is_read_by_its_own_library(bundle_dir, photos, tmp_path, capsys):
    detect_files(bundle_dir, [photos], tmp_path / "out", formats=["coco", "jsonl", "coco"], pictures=False)

    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["coco.json", "detections.jsonl"]
    dataset = COCO(str(tmp_path / "out/coco.json"))
    assert [(image["file_name"], image["width"]) for image in dataset.loadImgs([1, 2])] == [
        (str(photos / "a.png"), 64),
        (str(photos / "b.png"), 128),
    ]
    assert [(a["bbox"], a["score"]) for a in dataset.loadAnns(dataset.getAnnIds(imgIds=[2]))] == [
        ([54.0, 12.0, 20.0, 40.0], 0.4)
    ]
    assert dataset.loadCats([3])[0]["name"] == SIGNALS.classes[3]
    assert len(dataset.loadRes(dataset.dataset["annotations"]).getAnnIds()) == 2


def test_coco_of_nothing_found(bundle_dir, photos, tmp_path):
    detect_files(bundle_dir, [photos], tmp_path / "out", formats=["coco"], score_threshold=0.9, pictures=False)

    values = json.loads((tmp_path / "out/coco.json").read_text())
    assert (values["annotations"], len(values["images"])) == ([], 2)


def black(monkeypatch, at=3, raises=None, length=None):
    """A camera that gives black images, endlessly unless a length is given, and in the middle raises a signal."""

    def frames(_index, stop):
        for i in range(length) if length is not None else count():
            if i == at and raises is not None:
                signal.raise_signal(raises)
            yield np.zeros((32, 64, 3), dtype=np.uint8)
            if stop.is_set():
                return

    monkeypatch.setattr(sources, "camera_frames", frames)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_camera_and_what_was_seen_is_kept(bundle_dir, tmp_path, monkeypatch, number):
    black(monkeypatch, raises=number)
    handler = signal.getsignal(number)

    summary = detect_files(bundle_dir, ["camera:0"], tmp_path / "out", pictures=False)

    assert (summary.images, len((tmp_path / "out/detections.jsonl").read_text().splitlines())) == (4, 4)
    assert not summary.lost_camera
    assert signal.getsignal(number) is handler


def test_a_second_ctrl_c_ends_a_camera_at_once(bundle_dir, tmp_path, monkeypatch):
    def stubborn(_index, _stop):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        yield np.zeros((32, 64, 3), dtype=np.uint8)

    monkeypatch.setattr(sources, "camera_frames", stubborn)

    with pytest.raises(KeyboardInterrupt):
        detect_files(bundle_dir, ["camera:0"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_what_a_lost_camera_saw_is_kept(bundle_dir, tmp_path, monkeypatch, capsys):
    black(monkeypatch, length=2)

    summary = detect_files(bundle_dir, ["camera:0"], tmp_path / "out", pictures=False)

    assert (summary.images, summary.lost_camera) == (2, True)
    assert "camera:0: gives no frames any more" in capsys.readouterr().err


def test_a_camera_outside_of_the_main_thread(bundle_dir, tmp_path, monkeypatch):
    black(monkeypatch)
    with ThreadPoolExecutor(1) as pool:
        summary = pool.submit(detect_files, bundle_dir, ["camera:0"], tmp_path / "out", max_images=2).result()

    assert (summary.images, summary.lost_camera) == (2, False)


def test_a_picture_that_cannot_be_written_is_an_error(bundle_dir, photos, tmp_path, monkeypatch):
    real = cv2.imwrite
    monkeypatch.setattr(cv2, "imwrite", lambda path, *rest: "b.jpg" not in path and real(path, *rest))

    with pytest.raises(OSError, match=r"is the disk full\?: '.*b\.jpg'"):
        detect_files(bundle_dir, [photos], tmp_path / "out")
    assert not (tmp_path / "out").exists()


_WITH_CAMERA = """
import time
import cv2, numpy as np

class Camera:
    def __init__(self, index): self.left = FRAMES
    def isOpened(self): return True
    def open(self, index): pass
    def release(self): pass
    def read(self):
        self.left -= 1
        time.sleep(0.02)
        return (True, np.zeros((32, 64, 3), np.uint8)) if self.left >= 0 else (False, None)

cv2.VideoCapture = Camera
from autolights.infer import videos
videos._CAMERA_PATIENCE_S = 0.2
from autolights.cli import main
main()
"""


def detect_camera(bundle_dir, out, frames):
    arguments = ["detect", bundle_dir, "camera:0", "--out", out, "--format", "coco", "--json", "--threads", 1]
    return subprocess.Popen(
        [sys.executable, "-c", f"FRAMES = {frames}\n{_WITH_CAMERA}", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_program_with_a_camera_ends_well_when_stopped(bundle_dir, tmp_path, number):
    with detect_camera(bundle_dir, tmp_path / "out", 1_000_000) as process:
        deadline = time.monotonic() + 60
        while len(list(tmp_path.glob(".out.*.tmp/pictures/*/*"))) < 5 and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        process.send_signal(number)
        printed, errors = process.communicate(timeout=60)

    assert process.returncode == 0, errors
    summary = json.loads(printed)
    assert len(COCO(str(tmp_path / "out/coco.json")).imgs) == summary["images"] >= 5
    assert len(list((tmp_path / "out/pictures/camera0").iterdir())) == summary["images"]
    assert [path.name for path in tmp_path.glob(".out*")] == []


def test_program_tells_by_its_exit_code_that_the_camera_was_lost(bundle_dir, tmp_path):
    with detect_camera(bundle_dir, tmp_path / "out", 3) as process:
        printed, errors = process.communicate(timeout=60)

    assert process.returncode == 1
    assert json.loads(printed)["images"] == 3
    assert "gives no frames any more" in errors
    assert "Traceback" not in errors


def test_ctrl_c_in_the_middle_of_files_leaves_nothing(bundle_dir, photos, tmp_path, monkeypatch):
    monkeypatch.setattr(sources.cv2, "imdecode", lambda *_: signal.raise_signal(signal.SIGINT))

    with pytest.raises(KeyboardInterrupt):
        detect_files(bundle_dir, [photos], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_limit_of_images(bundle_dir, photos, tmp_path):
    assert detect_files(bundle_dir, [photos], tmp_path / "out", max_images=1, pictures=False).images == 1


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--backend", "abacus"], "--backend must be one of onnxruntime, openvino, tensorrt, got 'abacus'"),
        (["--provider", "AbacusProvider"], "ONNX Runtime has no provider 'AbacusProvider' here; there are:"),
        (["--backend", "tensorrt", "--provider", "X"], "--provider is a choice of the backend onnxruntime"),
    ],
)
def test_a_way_to_run_that_is_not_there_is_misuse(bundle_dir, photos, tmp_path, options, text):
    result = CliRunner().invoke(app, ["detect", str(bundle_dir), str(photos), "-o", str(tmp_path / "out"), *options])

    assert isinstance(result.exception, UsageError)
    assert text in str(result.exception)
    assert not (tmp_path / "out").exists()


def test_a_way_to_run_is_chosen(bundle_dir, photos, tmp_path, monkeypatch):
    chosen = []
    monkeypatch.setattr(Detector, "__init__", lambda _self, _path, _info, execution, **_: chosen.append(execution))
    options = ["--backend", "onnxruntime", "--provider", "CPUExecutionProvider", "--threads", "2"]

    CliRunner().invoke(app, ["detect", str(bundle_dir), str(photos), "-o", str(tmp_path / "out"), *options])

    assert chosen == [Execution(providers=("CPUExecutionProvider",), threads=2)]
