import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autolights.core import ModelInfo
from autolights.infer.letterbox import Letterbox
from autolights.infer.region import LEAST_SIDES, view_of
from autolights.train.deliver.heads import MIN_DYNAMIC_SIDE

FIXED = ModelInfo(classes=("red",), size_wh=(640, 416), opset=17)
FREE = FIXED.model_copy(update={"dynamic_size": True})
FREE_END2END = FREE.model_copy(update={"head": "end2end"})
FULL_HD = (1920, 1200)


@pytest.mark.parametrize(
    ("info", "region", "view"),
    [
        pytest.param(FIXED, None, Letterbox(FULL_HD, (640, 416)), id="whole"),
        pytest.param(FREE, None, Letterbox(FULL_HD, (640, 416)), id="whole-smallest-rectangle"),
        pytest.param(
            FIXED,
            (900, 500, 1100, 600),
            Letterbox((640, 416), (640, 416), (680, 342), enlarge=False),
            id="grows-to-the-input",
        ),
        pytest.param(
            FIXED, (-20, -5, 30, 40), Letterbox((640, 416), (640, 416), (0, 0), enlarge=False), id="at-the-edge"
        ),
        pytest.param(
            FIXED,
            (0, 100, 1920, 300),
            Letterbox((1920, 1200), (640, 416), (0, 0), enlarge=False),
            id="too-wide-for-the-input",
        ),
        pytest.param(
            FREE, (0, 100, 1920, 300), Letterbox((1920, 224), (1920, 224), (0, 88), enlarge=False), id="free-band"
        ),
        pytest.param(
            FREE, (0, 0, 1920, 1200), Letterbox(FULL_HD, (1920, 1216), (0, 0), enlarge=False), id="free-everything"
        ),
        pytest.param(FREE, (10, 10, 40, 30), Letterbox((32, 32), (32, 32), (9, 4), enlarge=False), id="free-and-small"),
        pytest.param(
            FREE_END2END, (10, 10, 40, 30), Letterbox((96, 96), (96, 96), (0, 0), enlarge=False), id="enough-to-choose"
        ),
    ],
)
def test_by_hand(info, region, view):
    assert view_of(FULL_HD, region, info) == view


def test_a_line_of_an_image_gives_an_end2end_head_enough_to_choose_from():
    assert view_of((2000, 3), None, FREE_END2END) == Letterbox((2000, 3), (640, 96))
    assert LEAST_SIDES["end2end"] == MIN_DYNAMIC_SIDE  # what the export proves its models for


@pytest.mark.parametrize("region", [(1920, 0, 2000, 50), (300, 300, 300, 400), (100, 100, 50, 200)])
def test_region_beside_the_image(region):
    with pytest.raises(ValueError, match="does not overlap the image of 1920 x 1200 px"):
        view_of(FULL_HD, region, FIXED)


@given(
    st.tuples(st.integers(8, 3000), st.integers(8, 3000)),
    st.tuples(*[st.floats(-0.2, 1.2)] * 2),
    st.tuples(*[st.floats(-0.2, 1.2)] * 2),
    st.booleans(),
)
def test_a_view_holds_its_region_and_stays_in_the_image(image_wh, xs, ys, free):
    (left, right), (top, bottom) = ([f * side for f in sorted(fs)] for fs, side in zip((xs, ys), image_wh, strict=True))
    try:
        view = view_of(image_wh, (left, top, right, bottom), FREE if free else FIXED)
    except ValueError:
        assert right <= 0 or bottom <= 0 or left >= image_wh[0] or top >= image_wh[1] or left == right or top == bottom
        return

    x, y = view.origin_xy
    assert 0 <= x <= max(math.floor(left), 0)
    assert 0 <= y <= max(math.floor(top), 0)
    assert min(math.ceil(right), image_wh[0]) <= x + view.image_wh[0] <= image_wh[0]
    assert min(math.ceil(bottom), image_wh[1]) <= y + view.image_wh[1] <= image_wh[1]
    assert not any(side % 32 for side in view.input_wh)
    if free:
        assert view.scaled_wh == view.image_wh
    else:
        assert view.scaled_wh[0] <= view.image_wh[0]
