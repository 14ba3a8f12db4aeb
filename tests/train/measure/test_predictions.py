import json
from pathlib import Path

import numpy as np
import pytest

from autolights.core.errors import DataError
from autolights.train.measure.predictions import Predictions, load_predictions, save_predictions

PATHS = [Path("a/one.rf.1.jpg"), Path("a/empty.png"), Path("a/000123.jpg")]
NONE = Predictions(np.empty((0, 4)), np.empty(0, dtype=np.int64), np.empty(0))
SEEN = [
    Predictions(np.array([[1.5, 2, 11.25, 22], [0, 0, 3, 9]]), np.array([2, 0]), np.array([0.9, 0.123456])),
    NONE,
    Predictions(np.array([[5.0, 6, 7, 8]]), np.array([1]), np.array([0.5])),
]


def test_round_trip(tmp_path):
    save_predictions(tmp_path / "p.json", PATHS, SEEN)

    loaded = load_predictions(tmp_path / "p.json", PATHS[::-1], 3)[::-1]

    for image, wanted in zip(loaded, SEEN, strict=True):
        np.testing.assert_allclose(image.boxes_xyxy, wanted.boxes_xyxy)
        np.testing.assert_allclose(image.scores, wanted.scores)
        assert image.class_ids.tolist() == wanted.class_ids.tolist()


def test_yolov5_writes_numbers_for_names_that_are_numbers(tmp_path):
    path = tmp_path / "p.json"
    path.write_text(json.dumps([{"image_id": 123, "category_id": 1, "bbox": [5, 6, 2, 2], "score": 0.5}]))

    assert load_predictions(path, PATHS, 3)[2].boxes_xyxy.tolist() == [[5, 6, 7, 8]]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        pytest.param("[", r"p\.json: not JSON", id="broken"),
        pytest.param("{}", r"p\.json: must be a list of COCO results", id="object"),
        pytest.param('[{"image_id": "one"}]', r"each with image_id, category_id, bbox, score", id="field-missing"),
        pytest.param(
            '[{"image_id": "two", "category_id": 0, "bbox": [0, 0, 1, 1], "score": 1}]',
            r"image_id 'two' is none of the 3 images",
            id="other-images",
        ),
        pytest.param(
            '[{"image_id": "empty", "category_id": 3, "bbox": [0, 0, 1, 1], "score": 1}]',
            r"category_id must be from 0 to 2, got 3",
            id="other-classes",
        ),
    ],
)
def test_files_that_do_not_fit(tmp_path, text, expected):
    path = tmp_path / "p.json"
    path.write_text(text)
    with pytest.raises(DataError, match=expected):
        load_predictions(path, PATHS, 3)


def test_missing_file_says_how_to_make_it(tmp_path):
    with pytest.raises(DataError, match="--save-predictions"):
        load_predictions(tmp_path / "p.json", PATHS, 3)
