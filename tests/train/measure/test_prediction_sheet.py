import cv2
import numpy as np
import pytest

from autolights.data.image_dataset import ImageDataset
from autolights.train.measure.prediction_sheet import prediction_sheet, save_sheet
from autolights.train.measure.predictions import Labels, Predictions
from autolights.train.measure.validate import DatasetDetections

RIGHT, OTHER_CLASS, MISSED, FALSE_ALARM = (74, 222, 128), (255, 178, 36), (255, 80, 80), (255, 90, 222)  # RGB
GREY = 120
NOTHING = Labels(np.empty((0, 4)), np.empty(0, dtype=np.int64)), ()
LEGEND_PX = 34


def detections_of(folder, images, size_wh=(200, 100)):
    """From (labels, detections as (box, class, score)) of each grey image."""
    paths = tuple(folder / f"{i}.png" for i in range(len(images)))
    for path in paths:
        cv2.imwrite(str(path), np.full((size_wh[1], size_wh[0], 3), GREY, dtype=np.uint8))
    none = tuple(np.empty((0, 4)) for _ in images)
    dataset = ImageDataset(folder, ("red", "green"), paths, tuple(np.empty(0, dtype=np.int64) for _ in images), none)
    reported = tuple(
        Predictions(
            np.array([box for box, _, _ in seen], dtype=float).reshape(-1, 4),
            np.array([class_id for _, class_id, _ in seen], dtype=np.int64),
            np.array([score for _, _, score in seen], dtype=float),
        )
        for _, seen in images
    )
    labels = tuple(truth for truth, _ in images)
    return DatasetDetections(dataset, tuple(range(len(images))), labels, reported, reported, score_threshold=0.25)


def colors_in(picture):
    body = picture[LEGEND_PX:].reshape(-1, 3)
    return {color for color in (RIGHT, OTHER_CLASS, MISSED, FALSE_ALARM) if (body == color).all(axis=1).any()}


@pytest.mark.parametrize(
    ("seen", "left", "right"),
    [
        pytest.param([([50, 20, 70, 60], 0, 0.9)], {RIGHT}, {RIGHT}, id="right"),
        pytest.param([([50, 20, 70, 60], 1, 0.9)], {OTHER_CLASS}, {OTHER_CLASS}, id="other-class"),
        pytest.param([], {MISSED}, set(), id="missed"),
        pytest.param([([50, 20, 70, 60], 0, 0.2)], {MISSED}, set(), id="below-the-threshold"),
        pytest.param(
            [([50, 20, 70, 60], 0, 0.9), ([120, 20, 140, 60], 0, 0.9)], {RIGHT}, {RIGHT, FALSE_ALARM}, id="false-alarm"
        ),
    ],
)
def test_colours_tell_what_happened(tmp_path, seen, left, right):
    truth = Labels(np.array([[50.0, 20, 70, 60]]), np.zeros(1, dtype=np.int64))

    sheet = prediction_sheet(detections_of(tmp_path, [(truth, seen)]))

    middle = sheet.shape[1] // 2
    assert (colors_in(sheet[:, :middle]), colors_in(sheet[:, middle:])) == (left, right)


def test_small_lights_are_enlarged(tmp_path):
    truth = Labels(np.array([[1000.0, 500, 1010, 520]]), np.zeros(1, dtype=np.int64))

    sheet = prediction_sheet(detections_of(tmp_path, [(truth, [])], size_wh=(2000, 1000)))

    framed = np.nonzero((sheet[LEGEND_PX:] == MISSED).all(axis=2))[0]
    assert np.ptp(framed) >= 20 * 600 / 2000 * 4  # a quarter of the image fills the panel


def test_images_with_labels_are_shown_two_in_a_row(tmp_path):
    truth = Labels(np.array([[50.0, 20, 70, 60]]), np.zeros(1, dtype=np.int64))
    images = [NOTHING, (truth, []), NOTHING, (truth, []), (truth, [])]

    sheet = prediction_sheet(detections_of(tmp_path, images), count=8)

    assert sheet.shape == (LEGEND_PX + 2 * 308, 4 * 608, 3)
    assert (sheet[-300:, -1200:] == 255).all()  # three images, the fourth place is empty


def test_without_any_label_the_images_themselves_are_shown(tmp_path):
    sheet = prediction_sheet(detections_of(tmp_path, [NOTHING, NOTHING]))

    assert sheet.shape == (LEGEND_PX + 308, 4 * 608, 3)
    assert (sheet[LEGEND_PX + 100, 300] == GREY).all()


def test_the_file_holds_the_sheet(tmp_path):
    detections = detections_of(tmp_path, [(Labels(np.array([[50.0, 20, 70, 60]]), np.zeros(1, dtype=np.int64)), [])])

    save_sheet(detections, tmp_path / "predictions.png")

    read = cv2.imread(str(tmp_path / "predictions.png"))
    np.testing.assert_array_equal(read[..., ::-1], prediction_sheet(detections))
