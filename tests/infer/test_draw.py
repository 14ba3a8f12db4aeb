import numpy as np
import pytest

from autolights.core import Detections, load_signals
from autolights.infer.draw import COLORS_BGR, DARK_BGR, draw_detections, state_color

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


def test_nothing_to_draw():
    np.testing.assert_array_equal(draw_detections(street(), detections(), SIGNALS), street())
