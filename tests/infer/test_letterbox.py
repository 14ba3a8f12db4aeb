import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autolights.infer.letterbox import GREY, InputBuffer, Letterbox, rectangle_for


def noise(width, height, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def letterboxed(image, input_wh, buffer=None):
    out = np.full((3, input_wh[1], input_wh[0]), np.nan, dtype=np.float32)
    (buffer or InputBuffer(input_wh)).fill(image, out)
    return out


@pytest.mark.parametrize(
    ("image_wh", "long_side", "expected"),
    [
        pytest.param((1280, 800), 640, (640, 416), id="rounded-up"),
        pytest.param((1280, 800), 960, (960, 608), id="600-to-608"),
        pytest.param((800, 1280), 640, (416, 640), id="upright"),
        pytest.param((640, 640), 320, (320, 320), id="square"),
        pytest.param((160, 96), 320, (320, 192), id="enlarged"),
        pytest.param((2000, 3), 640, (640, 32), id="a-line"),
    ],
)
def test_rectangle(image_wh, long_side, expected):
    assert rectangle_for(image_wh, long_side) == expected


@pytest.mark.parametrize(
    ("image_wh", "input_wh", "scaled_wh", "offset_xy"),
    [
        pytest.param((1280, 800), (640, 416), (640, 400), (0, 8), id="grey-above-and-below"),
        pytest.param((1280, 800), (640, 640), (640, 400), (0, 120), id="square-input"),
        pytest.param((400, 800), (640, 416), (208, 416), (216, 0), id="grey-at-the-sides"),
        pytest.param((640, 416), (640, 416), (640, 416), (0, 0), id="as-it-is"),
        pytest.param((9999, 1), (64, 32), (64, 1), (0, 15), id="never-less-than-a-pixel"),
    ],
)
def test_place_in_the_input(image_wh, input_wh, scaled_wh, offset_xy):
    letterbox = Letterbox(image_wh, input_wh)

    assert (letterbox.scaled_wh, letterbox.offset_xy) == (scaled_wh, offset_xy)


@pytest.mark.parametrize("image_wh", [(1280, 800), (300, 500), (96, 64), (97, 41)])
def test_input_is_the_scaled_image_on_grey_as_rgb_planes(image_wh):
    image, input_wh = noise(*image_wh), (96, 64)
    letterbox = Letterbox(image_wh, input_wh)
    (left, top), (width, height) = letterbox.offset_xy, letterbox.scaled_wh
    expected = np.full((64, 96, 3), GREY, dtype=np.uint8)
    expected[top : top + height, left : left + width] = cv2.resize(image, (width, height))
    before = image.copy()

    out = letterboxed(image, input_wh)

    np.testing.assert_allclose(out, expected[..., ::-1].transpose(2, 0, 1) / 255, atol=1e-7)
    np.testing.assert_array_equal(image, before)


def test_an_image_leaves_no_trace_in_the_next_ones_input():
    buffer = InputBuffer((96, 64))
    letterboxed(noise(90, 30), (96, 64), buffer)
    upright = noise(30, 90, seed=1)

    out = letterboxed(upright, (96, 64), buffer)

    np.testing.assert_array_equal(out, letterboxed(upright, (96, 64)))


def test_half_input():
    image, out = noise(90, 30), np.full((3, 64, 96), np.nan, dtype=np.float16)

    InputBuffer((8, 8)).fill(image, out)

    np.testing.assert_array_equal(out, letterboxed(image, (96, 64)).astype(np.float16))


def test_part_of_an_image():
    image = noise(300, 200)
    letterbox = Letterbox((90, 20), (96, 64), origin_xy=(150, 40), enlarge=False)
    out = np.full((3, 64, 96), np.nan, dtype=np.float32)

    InputBuffer((96, 64)).fill(image, out, letterbox)

    # 3 grey columns at both sides, 22 rows above and below; nothing is scaled
    np.testing.assert_array_equal(out[:, 22:42, 3:93], image[40:60, 150:240, ::-1].transpose(2, 0, 1) / np.float32(255))
    assert (out[:, :22] == np.float32(GREY) / 255).all()
    back = letterbox.boxes_to_image(np.array([[3.0, 22, 93, 42], [0, 0, 13, 27]]))
    assert back.tolist() == [[150, 40, 240, 60], [150, 40, 160, 45]]


sides = st.integers(8, 3000)
fractions = st.floats(0, 1)


@given(sides, sides, st.tuples(fractions, fractions, fractions, fractions))
def test_boxes_return_to_the_image(width, height, box):
    letterbox = Letterbox((width, height), (640, 416))
    low, high = np.minimum(box[:2], box[2:]), np.maximum(box[:2], box[2:])
    fraction_box = np.concatenate([low, high])[None]
    in_input = fraction_box * np.tile(letterbox.scaled_wh, 2) + np.tile(letterbox.offset_xy, 2)

    back = letterbox.boxes_to_image(in_input)

    np.testing.assert_allclose(back, fraction_box * np.tile((width, height), 2), atol=1e-9)


def test_boxes_are_cut_at_the_images_edge():
    box = Letterbox((1280, 800), (640, 416)).boxes_to_image(np.array([[-5.0, 0, 645, 420]]))

    assert box.tolist() == [[0, 0, 1280, 800]]
