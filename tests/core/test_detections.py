import numpy as np
import pytest

from autolights.core import Detections


@pytest.fixture
def two():
    return Detections(
        np.array([[0.0, 0, 4, 9], [5, 0, 9, 9]]), np.array([0.5, 0.9]), np.array([[0.2, 0.8], [0.7, 0.1]])
    )


def test_scores_and_classes(two):
    np.testing.assert_allclose(two.scores, [0.4, 0.63])
    assert two.class_ids.tolist() == [1, 0]


def test_rows_can_be_taken(two):
    assert two[np.array([True, False])].boxes_xyxy.tolist() == [[0, 0, 4, 9]]
    assert two[np.array([1, 0])].class_ids.tolist() == [0, 1]
    assert len(two[:0]) == 0


def test_no_detection_is_an_ordinary_case():
    none = Detections.empty(13)

    assert (len(none), none.scores.shape, none.class_ids.shape, none.class_probs.shape) == (0, (0,), (0,), (0, 13))


@pytest.mark.parametrize("column", ["boxes_xyxy", "objectness", "class_probs"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_must_be_finite(two, column, value):
    columns = {name: getattr(two, name).copy() for name in ("boxes_xyxy", "objectness", "class_probs")}
    columns[column].flat[-1] = value

    with pytest.raises(ValueError, match=f"{column} of detections must be finite, got {value}"):
        Detections(**columns)


@pytest.mark.parametrize(
    ("boxes", "objectness", "probs"),
    [
        pytest.param((2, 4), (1,), (2, 3), id="objectness"),
        pytest.param((2, 5), (2,), (2, 3), id="boxes"),
        pytest.param((2, 4), (2,), (1, 3), id="probs"),
        pytest.param((2, 4), (2,), (2,), id="flat-probs"),
    ],
)
def test_columns_must_fit(boxes, objectness, probs):
    with pytest.raises(ValueError, match=r"\(n, C\)"):
        Detections(np.zeros(boxes), np.zeros(objectness), np.zeros(probs))
