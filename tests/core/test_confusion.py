import json
from dataclasses import replace

import numpy as np
import pytest

from autolights.core import ConfusionMatrix, CountedWith
from autolights.core.errors import DataError


@pytest.fixture
def matrix():
    return ConfusionMatrix(("3-red", "3-green"), np.array([[5, 1, 2], [0, 7, 0], [3, 0, 0]]), 0.25, 0.5)


def test_file_reads_back(matrix, tmp_path):
    matrix.save(tmp_path / "confusion.json")

    read = ConfusionMatrix.load(tmp_path / "confusion.json")

    assert read.to_json() == matrix.to_json()
    assert read.counts.dtype == np.int64


def test_it_may_say_what_it_was_counted_with(matrix, tmp_path):
    counted = replace(matrix, counted_with=CountedWith("0" * 64, "int8"))
    counted.save(tmp_path / "confusion.json")

    assert ConfusionMatrix.load(tmp_path / "confusion.json").counted_with == counted.counted_with
    assert ConfusionMatrix.from_json(matrix.to_json()).counted_with is None  # files of earlier versions say nothing
    with pytest.raises(DataError, match="counted_with must hold sha256 and precision, got 'int8'"):
        ConfusionMatrix.from_json({**matrix.to_json(), "counted_with": "int8"})


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        pytest.param(np.zeros((2, 2), dtype=int), r"counts must be \(3, 3\) for 2 classes, got \(2, 2\)", id="shape"),
        pytest.param(-np.eye(3, dtype=int), "counts must not be negative", id="negative"),
    ],
)
def test_counts_no_matrix_can_have(counts, message):
    with pytest.raises(ValueError, match=message):
        ConfusionMatrix(("3-red", "3-green"), counts, 0.25, 0.5)


def test_broken_files_are_named(matrix, tmp_path):
    path = tmp_path / "confusion.json"
    values = matrix.to_json()
    for text, message in [
        ("{", r"confusion\.json: not JSON"),
        (json.dumps({**values, "counts": [[1]]}), r"confusion\.json: confusion matrix: counts must be \(3, 3\)"),
        (json.dumps({"classes": []}), r"confusion\.json: confusion matrix: field 'counts' is missing"),
    ]:
        path.write_text(text)
        with pytest.raises(DataError, match=message):
            ConfusionMatrix.load(path)
    with pytest.raises(DataError, match=r"gone\.json: cannot be read"):
        ConfusionMatrix.load(tmp_path / "gone.json")
