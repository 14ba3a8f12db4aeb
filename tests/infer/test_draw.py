import cv2
import numpy as np
import pytest

from autolights.core import Detections, load_signals
from autolights.core.boxes import iou_matrix
from autolights.infer.draw import COLORS_BGR, DARK_BGR, _draw_leader, draw_detections, state_color

SIGNALS = load_signals()


def detections(*boxes, class_name="3-red"):
    probs = np.zeros((len(boxes), len(SIGNALS.classes)))
    probs[:, SIGNALS.class_ids[class_name]] = 0.9
    return Detections(np.array(boxes, dtype=float).reshape(-1, 4), np.ones(len(boxes)), probs)


def street(width=1280, height=800):
    return np.full((height, width, 3), 90, dtype=np.uint8)


@pytest.mark.parametrize(
    ("class_name", "color"),
    [
        pytest.param("3-red", COLORS_BGR["red"], id="ball"),
        pytest.param("4-yleft2", COLORS_BGR["yellow"], id="arrow"),
        pytest.param("5dh-red-gleft", COLORS_BGR["green"], id="the-arrow-that-permits"),
        pytest.param("4-off", DARK_BGR, id="dark"),
    ],
)
def test_color_of_a_state(class_name, color):
    assert state_color(class_name, SIGNALS) == color


def test_frame_in_the_states_color_around_an_untouched_light():
    image = street()
    image[200:260, 600:620] = 7

    picture = draw_detections(image, detections([600, 200, 620, 260], class_name="3-green"), SIGNALS)

    assert (picture[200:260, 600:620] == 7).all()
    np.testing.assert_allclose(picture[230, 598], COLORS_BGR["green"], atol=2)
    assert (image[230, 598] == 90).all()


@pytest.mark.parametrize("corner", [(2, 2), (1258, 2), (2, 738), (1258, 738)])
def test_text_stays_in_the_picture_and_off_the_light(corner):
    image = street()
    left, top = corner
    image[top : top + 60, left : left + 20] = 7

    picture = draw_detections(image, detections([left, top, left + 20, top + 60]), SIGNALS)

    assert (picture[top : top + 60, left : left + 20] == 7).all()
    assert (picture == 25).all(axis=2).sum() > 500  # the plate behind the text is whole


def test_texts_of_neighbours_cover_neither_lights_nor_each_other():
    boxes = [[600, 200, 620, 260], [640, 200, 660, 260], [680, 205, 700, 265]]
    image = street()
    for left, top, right, bottom in boxes:
        image[top:bottom, left:right] = 7

    picture = draw_detections(image, detections(*boxes), SIGNALS)

    for left, top, right, bottom in boxes:
        assert (picture[top:bottom, left:right] == 7).all()
    single = (draw_detections(street(), detections(boxes[0]), SIGNALS) != 90).any(axis=2).sum()
    together = (draw_detections(street(), detections(*boxes), SIGNALS) != 90).any(axis=2).sum()
    assert together > 2.9 * single


@pytest.mark.parametrize("seed", range(5))
def test_texts_of_a_crowd_of_far_lights_keep_clear(monkeypatch, seed):
    rng = np.random.default_rng(seed)
    corners = np.array([(600 + 30 * column, 300 + 40 * row) for row in range(3) for column in range(5)])
    corners = corners + rng.integers(0, 8, corners.shape)
    boxes = np.concatenate([corners, corners + np.array([8, 20])], axis=1)
    plates = []
    rectangle = cv2.rectangle

    def recorded(picture, start, end, color, thickness):
        if thickness == cv2.FILLED:
            plates.append((*start, *end))
        return rectangle(picture, start, end, color, thickness)

    monkeypatch.setattr(cv2, "rectangle", recorded)
    image = rng.integers(0, 255, (800, 1280, 3), dtype=np.uint8)

    picture = draw_detections(image, detections(*boxes.tolist()), SIGNALS)

    for left, top, right, bottom in boxes:
        np.testing.assert_array_equal(picture[top:bottom, left:right], image[top:bottom, left:right])
    everything = np.array([*boxes, *plates], dtype=float)
    assert len(plates) == 15
    assert np.count_nonzero(np.triu(iou_matrix(everything, everything), 1)) == 0


def test_a_line_leads_to_a_text_that_is_far_from_its_light_only():
    box = np.array([600.0, 200, 620, 260])

    for top, drawn in ((174.0, False), (100.0, True)):
        picture = street()
        _draw_leader(picture, box, np.array([596.0, top, 680, top + 22]), COLORS_BGR["red"], 1)
        assert (picture != 90).any() == drawn
        np.testing.assert_array_equal(picture[203:], 90)  # it ends at the light


def test_nothing_to_draw():
    np.testing.assert_array_equal(draw_detections(street(), detections(), SIGNALS), street())
