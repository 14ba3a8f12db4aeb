import numpy as np
import pytest

from autolights.infer import Detector

ROWS = [[32, 16, 10, 20, 0.9, 0.8, 0.1], [10, 16, 8, 10, 0.9, 0.1, 0.4]]


def image(width, height):
    return np.zeros((height, width, 3), dtype=np.uint8)


def test_boxes_are_in_pixels_of_each_image(constant_model):
    detector = Detector(*constant_model(ROWS), threads=1)

    same, double, upright = detector.batch([image(64, 32), image(128, 64), image(32, 64)])

    np.testing.assert_allclose(same.boxes_xyxy, [[27, 6, 37, 26], [6, 11, 14, 21]])
    np.testing.assert_allclose(double.boxes_xyxy, 2 * same.boxes_xyxy)
    # 32 x 64 becomes 16 x 32 in the middle: 24 grey columns at the left, in which the second box lies.
    np.testing.assert_allclose(upright.boxes_xyxy, [[6, 12, 26, 52]])


def test_threshold_of_the_model_may_be_replaced(constant_model):
    model = constant_model(ROWS, score_threshold=0.5)

    assert len(Detector(*model)(image(64, 32))) == 1
    assert len(Detector(*model, score_threshold=0.3)(image(64, 32))) == 2


@pytest.mark.parametrize(
    ("bad_image", "message"),
    [
        pytest.param(image(8, 8).astype(np.float32), "must be uint8 with values 0 to 255, got float32", id="floats"),
        pytest.param(image(8, 8)[..., 0], r"must be \(height, width, 3\) in BGR order, got \(8, 8\)", id="grey"),
        pytest.param(np.zeros((8, 8, 4), np.uint8), r"got \(8, 8, 4\)", id="alpha"),
        pytest.param(image(0, 8), r"got \(8, 0, 3\)", id="empty"),
    ],
)
def test_what_is_no_image_is_refused(constant_model, bad_image, message):
    with pytest.raises(ValueError, match=message):
        Detector(*constant_model(ROWS))(bad_image)
