from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import pytest
import torch
from torch import nn

from autolights.core.errors import DataError, UsageError
from autolights.data.image_dataset import ImageDataset
from autolights.infer.letterbox import Letterbox, rectangle_for
from autolights.train.measure.average_precision import average_precision
from autolights.train.measure.every_class import decode_every_class
from autolights.train.measure.predictions import Labels
from autolights.train.measure.validate import detect_dataset, evaluate_detector
from autolights.train.processes import Processes

CLASSES = ("3-red", "3-green", "3-yellow")
LONG_SIDE = 96


class KnowsTheAnswers(nn.Module):
    """Tells image i by its grey level 10 (i + 1) and answers with prepared rows in pixels of that image."""

    def __init__(self, dataset: ImageDataset, answers: dict[int, list[list[float]]]) -> None:
        super().__init__()
        self.dataset, self.answers = dataset, answers
        self.batch_sizes: list[tuple[int, ...]] = []

    def forward(self, images):
        assert not self.training
        self.batch_sizes.append(tuple(images.shape))
        raw = torch.zeros(len(images), 4, 5 + len(CLASSES))
        for image, rows in zip(images, raw, strict=True):
            height, width = image.shape[1:]
            i = round(float(image[0, height // 2, width // 2]) * 255 / 10) - 1
            size_wh = self.dataset.read(i).shape[1::-1]
            letterbox = Letterbox(size_wh, (width, height))
            scale, offset = letterbox.scaled_wh[0] / size_wh[0], np.array(letterbox.offset_xy)
            for row, (x0, y0, x1, y1, *rest) in zip(rows, self.answers.get(i, []), strict=False):
                centre = np.array([x0 + x1, y0 + y1]) / 2 * scale + offset
                row[:] = torch.tensor([*centre, (x1 - x0) * scale, (y1 - y0) * scale, *rest])
        return raw


def dataset_of(folder, sizes_wh, boxes, class_ids):
    """Grey images, with boxes in pixels."""
    paths = []
    for i, (width, height) in enumerate(sizes_wh):
        paths.append(folder / f"{i}.png")
        cv2.imwrite(str(paths[-1]), np.full((height, width, 3), 10 * (i + 1), dtype=np.uint8))
    fractions = []
    for (width, height), rows in zip(sizes_wh, boxes, strict=True):
        xyxy = np.array(rows, dtype=float).reshape(-1, 4) / [width, height, width, height]
        fractions.append(np.hstack([(xyxy[:, :2] + xyxy[:, 2:]) / 2, xyxy[:, 2:] - xyxy[:, :2]]))
    ids = tuple(np.array(row, dtype=np.int64) for row in class_ids)
    return ImageDataset(folder, CLASSES, tuple(paths), ids, tuple(fractions))


@pytest.fixture
def street(tmp_path):
    """Landscape, portrait, landscape; three lights and an empty image."""
    sizes = [(192, 120), (60, 90), (192, 120), (192, 120)]
    boxes = [[[20, 20, 30, 50], [100, 20, 110, 50]], [[10, 10, 20, 40]], [], [[50, 60, 61, 90]]]
    return dataset_of(tmp_path, sizes, boxes, [[0, 1], [2], [], [1]])


RIGHT = {
    0: [[20, 20, 30, 50, 0.9, 1, 0, 0], [100, 20, 110, 50, 0.9, 0, 1, 0]],
    1: [[10, 10, 20, 40, 0.9, 0, 0, 1]],
    3: [[50, 60, 61, 90, 0.9, 0, 1, 0]],
}


def test_a_detector_that_knows_everything(street):
    model = KnowsTheAnswers(street, RIGHT).train()

    metrics = evaluate_detector(model, street, long_side=LONG_SIDE, batch_size=2, progress=False)

    assert (metrics.ap, metrics.images, metrics.labels) == (1, 4, 4)
    assert metrics.confusion.counts.tolist() == [[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0]]
    assert model.training


def test_images_of_one_shape_pass_together(street):
    model = KnowsTheAnswers(street, RIGHT)

    evaluate_detector(model, street, long_side=LONG_SIDE, batch_size=2, progress=False)

    assert model.batch_sizes == [(2, 3, 64, 96), (1, 3, 96, 64), (1, 3, 64, 96)]


def test_confusion_is_counted_as_the_runtime_detects(street):
    answers = {
        # Washed out: both classes on one head. COCO's way gives two detections, the runtime one.
        0: [[20, 20, 30, 50, 0.9, 0.8, 0.7, 0], [100, 20, 110, 50, 0.9, 0, 0, 0.5]],
        1: [[10, 10, 20, 40, 0.2, 0, 0, 1]],  # too doubtful to be reported, but COCO counts it
        2: [[80, 10, 90, 40, 0.9, 1, 0, 0]],  # nothing there
        3: RIGHT[3],
    }

    metrics = evaluate_detector(KnowsTheAnswers(street, answers), street, long_side=LONG_SIDE, progress=False)

    assert metrics.confusion.counts.tolist() == [[1, 0, 0, 0], [0, 1, 1, 0], [0, 0, 0, 1], [1, 0, 0, 0]]
    assert (metrics.confusion.score_threshold, metrics.confusion.iou_threshold) == (0.25, 0.5)
    assert metrics.per_class_ap["3-yellow"] == pytest.approx(0.5)  # behind the misnamed green of image 0


def test_every_class_of_a_box_is_a_prediction_of_its_own():
    raw = torch.tensor([[30, 30, 10, 30, 1.0, 0.9, 0.8, 0.0], [31, 30, 10, 30, 1.0, 0.5, 0.85, 0.0]])

    found = decode_every_class(raw, Letterbox((96, 64), (96, 64)))

    assert list(zip(found.class_ids.tolist(), found.scores.round(2).tolist(), strict=True)) == [
        (0, pytest.approx(0.9)),
        (1, pytest.approx(0.85)),
    ]


def test_an_untrained_network_offers_no_more_than_coco_takes():
    raw = torch.rand(20_000, 8, generator=torch.Generator().manual_seed(0))
    raw[:, :4] *= torch.tensor([640, 416, 40, 40])

    found = decode_every_class(raw, Letterbox((640, 416), (640, 416)))

    assert len(found.scores) == 300
    assert found.scores[0] == pytest.approx(float((raw[:, 4:5] * raw[:, 5:]).max()))


def test_average_precision_survives_the_letterbox(street):
    model = KnowsTheAnswers(street, RIGHT)
    by_hand = []
    for i, size_wh in enumerate([(192, 120), (60, 90), (192, 120), (192, 120)]):
        input_wh = rectangle_for(size_wh, LONG_SIDE)
        image = torch.full((1, 3, input_wh[1], input_wh[0]), 10 * (i + 1) / 255)
        by_hand.append(decode_every_class(model.eval()(image)[0], Letterbox(size_wh, input_wh)))
    truth = [Labels(street.boxes_xyxy(i, (192, 120) if i != 1 else (60, 90)), street.class_ids[i]) for i in range(4)]

    assert average_precision(truth, by_hand, CLASSES).ap == 1


def test_no_images(street):
    nothing = replace(street, image_paths=(), class_ids=(), boxes_cxcywh=())
    with pytest.raises(UsageError, match="no images to validate on"):
        evaluate_detector(nn.Identity(), nothing, long_side=LONG_SIDE)


def test_network_of_other_classes(street):
    class OneClass(nn.Module):
        def forward(self, images):
            return torch.zeros(len(images), 4, 6)

    with pytest.raises(UsageError, match=r"the network knows 1 classes, the data of .* 3"):
        evaluate_detector(OneClass(), street, long_side=LONG_SIDE, progress=False)


def test_too_many_broken_images_are_named(street):
    street.image_paths[2].write_bytes(b"no image")

    with pytest.raises(
        DataError, match=r"1 of 4 validation images do not decode: .*2\.png; bad_images allows .* 0\.2;"
    ):
        evaluate_detector(KnowsTheAnswers(street, RIGHT), street, long_side=LONG_SIDE, bad_images=0.2, progress=False)


def test_some_broken_images_are_left_out_with_their_labels(street, capsys):
    street.image_paths[3].write_bytes(b"no image")

    metrics = evaluate_detector(
        KnowsTheAnswers(street, RIGHT), street, long_side=LONG_SIDE, bad_images=0.25, progress=False
    )

    assert (metrics.ap, metrics.images, metrics.labels, metrics.unreadable) == (1, 3, 3, ("3.png",))
    assert "3.png; left out" in capsys.readouterr().err


@dataclass(frozen=True)
class InTurn(Processes):
    """Run one after the other; the last one gathers what all have seen."""

    values: list[object] = field(default_factory=list)

    def gather(self, value):
        self.values.append(value)
        return list(self.values)


@pytest.mark.parametrize("size", [2, 3])
def test_several_processes_measure_what_one_does(street, size):
    street.image_paths[2].write_bytes(b"no image")
    model = KnowsTheAnswers(street, RIGHT | {3: [[50, 60, 61, 80, 0.2, 0, 1, 0]]})
    options = {"long_side": LONG_SIDE, "bad_images": 0.3, "progress": False}
    values: list[object] = []

    shares = [detect_dataset(model, street, processes=InTurn(rank, size, values), **options) for rank in range(size)]

    alone, together = detect_dataset(model, street, **options), shares[-1]
    assert shares[0].indices == ((0,) if size == 2 else (0, 3))  # 2 does not decode
    assert (together.indices, together.unreadable) == (alone.indices, alone.unreadable) == ((0, 1, 3), (2,))
    for a, b in zip(together.predictions, alone.predictions, strict=True):
        np.testing.assert_array_equal(a.boxes_xyxy, b.boxes_xyxy)
    assert together.metrics().to_json() == alone.metrics().to_json()
