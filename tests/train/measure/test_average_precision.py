import contextlib
import io
import math

import numpy as np
import pytest
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from autolights.train.measure.average_precision import average_precision
from autolights.train.measure.predictions import Labels, Predictions

CLASSES = ("3-red", "3-green", "4-off", "4-rleft")


def labels(*boxes, ids=None):
    return Labels(np.array(boxes, dtype=float).reshape(-1, 4), np.array(ids or [0] * len(boxes), dtype=np.int64))


def predictions(*boxes, scores, ids=None):
    return Predictions(
        np.array(boxes, dtype=float).reshape(-1, 4),
        np.array(ids or [0] * len(boxes), dtype=np.int64),
        np.array(scores, dtype=float),
    )


def random_images(seed, image_count=25):
    """Labels of all COCO sizes and detections that are shifted, doubled, misnamed, missing or made up."""
    random = np.random.default_rng(seed)
    truth, found = [], []
    for _ in range(image_count):
        n = int(random.integers(0, 7))
        sides = np.exp(random.uniform(np.log(8), np.log(150), (n, 2)))
        lows = random.uniform(0, 900, (n, 2))
        boxes, ids = np.hstack([lows, lows + sides]), random.integers(0, 3, n)  # class 3 never has truth
        truth.append(Labels(boxes, ids))
        source = random.integers(0, n, 3 * n) if n else np.empty(0, dtype=int)
        shifted = boxes[source] + random.normal(0, 0.05, (len(source), 4)) * np.tile(sides[source], 2)
        invented = random.uniform(0, 900, (130, 2))  # more than 100 of one class in some images
        seen_ids = np.where(random.random(len(source)) < 0.8, ids[source], random.integers(0, 4, len(source)))
        found.append(
            Predictions(
                np.vstack([shifted, np.hstack([invented, invented + 20])]),
                np.concatenate([seen_ids, np.zeros(130, dtype=int)]),
                np.round(random.random(len(source) + 130), 2),  # ties happen
            )
        )
    return truth, found


def by_pycocotools(truth, found):
    annotations, results = [], []
    for i, (image, seen) in enumerate(zip(truth, found, strict=True)):
        for (x0, y0, x1, y1), class_id in zip(image.boxes_xyxy, image.class_ids, strict=True):
            box = {"bbox": [x0, y0, x1 - x0, y1 - y0], "area": (x1 - x0) * (y1 - y0), "iscrowd": 0}
            annotations.append({"id": len(annotations) + 1, "image_id": i, "category_id": int(class_id), **box})
        for (x0, y0, x1, y1), class_id, score in zip(seen.boxes_xyxy, seen.class_ids, seen.scores, strict=True):
            results.append(
                {"image_id": i, "category_id": int(class_id), "bbox": [x0, y0, x1 - x0, y1 - y0], "score": score}
            )
    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO()
        coco.dataset = {
            "info": {},
            "images": [{"id": i} for i in range(len(truth))],
            "categories": [{"id": i} for i in range(len(CLASSES))],
            "annotations": annotations,
        }
        coco.createIndex()
        evaluation = COCOeval(coco, coco.loadRes(results), "bbox")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    return evaluation


@pytest.mark.parametrize("seed", [0, 1])
def test_agrees_with_pycocotools(seed):
    truth, found = random_images(seed)
    oracle = by_pycocotools(truth, found)

    result = average_precision(truth, found, CLASSES)

    figures = [result.ap, result.ap50, result.ap75, result.ap_s, result.ap_m]
    np.testing.assert_allclose(figures, oracle.stats[:5], atol=5e-5)
    assert 0.05 < result.ap < 0.95
    assert list(result.per_class_ap) == ["3-red", "3-green", "4-off"]
    precision = oracle.eval["precision"][:, :, :3, 0, 2]
    np.testing.assert_allclose(list(result.per_class_ap.values()), precision.mean(axis=(0, 1)), atol=5e-5)
    np.testing.assert_allclose(list(result.curves.values()), precision[0].T, atol=5e-5)
    assert np.mean(list(result.per_class_ap50.values())) == pytest.approx(result.ap50)


def test_perfect_predictions_score_one():
    boxes = [10, 10, 30, 50], [100, 100, 160, 180]

    result = average_precision([labels(*boxes)], [predictions(*boxes, scores=[0.9, 0.8])], CLASSES)

    assert (result.ap, result.ap50, result.ap75, result.ap_s, result.ap_m) == (1, 1, 1, 1, 1)
    assert result.per_class_ap == {"3-red": 1}


def test_size_ranges_are_those_of_the_labels_in_original_pixels():
    small, medium = [0, 0, 31, 31], [100, 100, 133, 133]

    result = average_precision([labels(small, medium)], [predictions(medium, scores=[0.9])], CLASSES)

    assert (result.ap_s, result.ap_m) == (0, 1)


def test_half_the_lights_found_first_scores_half_the_recalls():
    boxes = [0, 0, 20, 20], [100, 0, 120, 20]

    result = average_precision([labels(*boxes)], [predictions(boxes[0], scores=[0.5])], CLASSES)

    assert result.ap == pytest.approx(51 / 101)  # recalls 0, .01, ... .50 of COCO's 101 have precision 1


def test_no_prediction_scores_zero():
    result = average_precision([labels([0, 0, 20, 20])], [predictions(scores=[])], CLASSES)

    assert (result.ap, result.ap_s, result.per_class_ap) == (0, 0, {"3-red": 0})
    assert math.isnan(result.ap_m)


def test_without_truth_there_is_nothing_to_average():
    result = average_precision([labels()], [predictions([0, 0, 9, 9], scores=[0.9])], CLASSES)

    assert math.isnan(result.ap)
    assert result.per_class_ap == {}


def test_every_image_needs_predictions():
    with pytest.raises(ValueError, match="predictions must cover the 2 labelled images, got 1"):
        average_precision([labels(), labels()], [predictions(scores=[])], CLASSES)
