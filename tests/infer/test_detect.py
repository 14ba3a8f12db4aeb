import json

import cv2
import numpy as np
import pytest

from autolights.core import Bundle, ConfusionMatrix, load_signals
from autolights.core.errors import UsageError
from autolights.detect import detect_files
from autolights.infer import Detector
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


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    cv2.imwrite(str(folder / "a.png"), np.zeros((32, 64, 3), dtype=np.uint8))
    cv2.imwrite(str(folder / "b.png"), np.zeros((64, 128, 3), dtype=np.uint8))
    (folder / "c.jpg").write_bytes(b"broken")
    return folder


def test_lines_pictures_and_counts(bundle_dir, photos, tmp_path, capsys):
    summary = detect_files(bundle_dir, [photos], tmp_path / "out", threads=1)

    assert summary.to_json() == {"images": 2, "detections": 2, "skipped": 1}
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
    with pytest.raises(UsageError, match=r"none of the 1 files could be decoded, the first: .*c\.jpg"):
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
