import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autolights.core.boxes import iou_matrix
from autolights.infer.decode import decode, decode_chosen
from autolights.infer.letterbox import Letterbox

SAME_SIZE = Letterbox((640, 416), (640, 416))


def decoded(rows, letterbox=SAME_SIZE, score_threshold=0.25, **settings):
    raw = np.array(rows, dtype=np.float32).reshape(-1, 8)
    return decode(raw, letterbox, score_threshold=score_threshold, **settings)


def test_one_light_by_hand():
    found = decoded([[100, 200, 20, 60, 0.9, 0.1, 0.8, 0.3]], Letterbox((1280, 800), (640, 416)))

    # (90, 170, 110, 230) in the input; 8 grey rows above, everything twice as large in the image
    np.testing.assert_allclose(found.boxes_xyxy, [[180, 324, 220, 444]])
    np.testing.assert_allclose(found.class_probs, [[0.1, 0.8, 0.3]], atol=1e-7)
    np.testing.assert_allclose(found.objectness, [0.9], atol=1e-7)
    assert found.scores == pytest.approx([0.72])
    assert found.class_ids.tolist() == [1]


def test_one_head_is_one_light_whatever_its_classes():
    washed_out = [[100, 100, 20, 60, 0.9, 0.6, 0.5, 0], [101, 100, 20, 60, 0.9, 0.1, 0.8, 0]]

    found = decoded(washed_out)

    np.testing.assert_allclose(found.class_probs, [[0.1, 0.8, 0.0]], atol=1e-7)


def test_lights_side_by_side_stay_two():
    found = decoded([[100, 100, 20, 60, 0.8, 0.9, 0, 0], [120, 100, 20, 60, 0.9, 0.9, 0, 0]])

    assert found.boxes_xyxy[:, 0].tolist() == [110, 90]  # best first


@pytest.mark.parametrize(
    ("objectness", "probability", "count"),
    [
        pytest.param(0.5, 0.5, 1, id="on-the-threshold"),
        pytest.param(0.5, 0.49, 0, id="sure-of-a-light-not-of-its-class"),
        pytest.param(0.2, 1.0, 0, id="objectness-below"),
        pytest.param(float("nan"), 1.0, 0, id="nan"),
    ],
)
def test_threshold_is_on_the_product(objectness, probability, count):
    assert len(decoded([[100, 100, 20, 60, objectness, probability, 0, 0]])) == count


def test_nothing_found_is_an_ordinary_case():
    found = decoded([])

    assert (found.boxes_xyxy.shape, found.class_probs.shape) == ((0, 4), (0, 3))


def test_only_the_best_are_kept():
    rows = [[50 * i + 25, 100, 20, 60, 0.5 + 0.04 * i, 1, 0, 0] for i in range(10)]

    found = decoded(rows, max_detections=3)

    np.testing.assert_allclose(found.scores, [0.86, 0.82, 0.78], atol=1e-6)


@given(st.integers(0, 2**32 - 1))
def test_suppression_against_its_definition(seed):
    random = np.random.default_rng(seed)
    raw = random.uniform(0, 1, (60, 8)).astype(np.float32)
    raw[:, :2] = random.uniform(40, 120, (60, 2))
    raw[:, 2:4] = random.uniform(10, 60, (60, 2))
    before = raw.copy()

    found = decode(raw, SAME_SIZE, score_threshold=0.3, iou_threshold=0.4)

    everything = decode(raw, SAME_SIZE, score_threshold=0.3, iou_threshold=1.0)
    overlap = iou_matrix(everything.boxes_xyxy, everything.boxes_xyxy)
    kept: list[int] = []
    for i in np.argsort(-everything.scores, kind="stable"):
        if all(overlap[i, j] <= 0.4 for j in kept):
            kept.append(int(i))
    np.testing.assert_array_equal(found.boxes_xyxy, everything.boxes_xyxy[kept])
    assert (np.diff(found.scores) <= 0).all()
    np.testing.assert_array_equal(raw, before)


def test_what_the_graph_has_chosen():
    found = decode_chosen(
        np.array([[90, 170, 110, 230], [0, 0, 20, 5], [300, 100, 320, 160], [0, 0, 0, 0]], np.float32),
        np.array([0.72, 0.6, 0.3, 0], np.float32),
        np.array([[0.1, 0.8, 0.3], [0.9, 0, 0], [0.2, 0.1, 0.6], [0, 0, 0]], np.float32),
        Letterbox((1280, 800), (640, 416)),
        score_threshold=0.25,
    )

    # the second box lies in the grey rows above the image
    np.testing.assert_allclose(found.boxes_xyxy, [[180, 324, 220, 444], [600, 184, 640, 304]])
    np.testing.assert_allclose(found.objectness, [0.9, 0.5], atol=1e-7)
    np.testing.assert_allclose(found.scores, [0.72, 0.3], atol=1e-7)
    assert found.class_ids.tolist() == [1, 2]


def test_halves_never_make_more_than_certainty():
    found = decode_chosen(
        np.array([[0, 0, 9, 9]], np.float16),
        np.array([0.5], np.float16),
        np.array([[0.4998, 0, 0]], np.float16),
        SAME_SIZE,
        score_threshold=0.25,
    )

    assert found.objectness.tolist() == [1]
