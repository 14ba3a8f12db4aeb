from itertools import product

import numpy as np
import pytest

from autolights.core.atomic import sha256
from autolights.core.errors import BundleError, UsageError
from autolights.infer import Detector, Execution

ROWS = [[32, 16, 10, 20, 0.9, 0.8, 0.1], [10, 16, 8, 10, 0.9, 0.1, 0.4]]
FORMS = [
    pytest.param({"head": head, "half_io": half, "dynamic_batch": batch, "dynamic_size": size}, id=f"{head}{i}")
    for i, (head, half, batch, size) in enumerate(product(("raw", "end2end"), *[(False, True)] * 3))
]


def image(width, height):
    return np.zeros((height, width, 3), dtype=np.uint8)


def spot_image(width, height, spots):
    """Black, with squares of 4 px: (left, top, BGR)."""
    picture = image(width, height)
    for left, top, color in spots:
        picture[top : top + 4, left : left + 4] = color
    return picture


RED, GREEN, DIM_RED = (20, 30, 250), (30, 240, 20), (0, 0, 160)


def test_boxes_are_in_pixels_of_each_image(constant_model):
    detector = Detector(*constant_model(ROWS), Execution(threads=1))

    same, double, upright = detector.batch([image(64, 32), image(128, 64), image(32, 64)])

    np.testing.assert_allclose(same.boxes_xyxy, [[27, 6, 37, 26], [6, 11, 14, 21]])
    np.testing.assert_allclose(double.boxes_xyxy, 2 * same.boxes_xyxy)
    # 32 x 64 becomes 16 x 32 in the middle: 24 grey columns at the left, in which the second box lies.
    np.testing.assert_allclose(upright.boxes_xyxy, [[6, 12, 26, 52]])


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_a_model_says_the_same(spot_model, form):
    detector = Detector(*spot_model(size_wh=(192, 96), **form, score_threshold=0.5), Execution(threads=1))

    narrow, wide = detector.batch(
        [spot_image(192, 96, [(8, 16, RED), (50, 2, GREEN)]), spot_image(384, 192, [(96, 32, GREEN)])]
    )

    np.testing.assert_allclose(narrow.boxes_xyxy, [[8, 16, 16, 24], [48, 0, 56, 8]])
    np.testing.assert_allclose(narrow.class_probs, np.array([[250, 30], [20, 240]]) / 255, atol=1e-3)
    np.testing.assert_allclose(narrow.objectness, np.array([250, 240]) / 255, atol=1e-3)
    np.testing.assert_allclose(wide.boxes_xyxy, [[96, 32, 112, 48]])  # a cell of the input is 16 px of this image
    assert wide.class_ids.tolist() == [1]


def test_lights_that_a_regions_edge_cuts_are_left_out(spot_model):
    detector = Detector(*spot_model(score_threshold=0.5))
    # The region grows to 64 x 32 from (96, 48): a spot at its edge, one inside, one at the image's own edge.
    picture = spot_image(160, 80, [(96, 64, RED), (120, 60, GREEN), (156, 76, RED)])

    found = detector(picture, region=(96, 48, 160, 80))

    assert found.boxes_xyxy.tolist() == [[152, 72, 160, 80], [120, 56, 128, 64]]


def test_threshold_of_the_model_may_be_replaced(constant_model):
    model = constant_model(ROWS, score_threshold=0.5)

    assert len(Detector(*model)(image(64, 32))) == 1
    assert len(Detector(*model, score_threshold=0.3)(image(64, 32))) == 2


def test_suppression_is_that_of_the_description(constant_model):
    beside = [[32, 16, 10, 20, 0.9, 0.8, 0.1], [35, 16, 10, 20, 0.8, 0.8, 0.1]]  # IoU 7 / 13

    assert len(Detector(*constant_model(beside))(image(64, 32))) == 1
    assert len(Detector(*constant_model(beside, nms_iou_threshold=0.6))(image(64, 32))) == 2
    assert len(Detector(*constant_model(beside, nms_iou_threshold=0.6, max_detections=1))(image(64, 32))) == 1


def test_free_size_takes_the_smallest_rectangle(spot_model, monkeypatch):
    detector = Detector(*spot_model(size_wh=(64, 64), dynamic_size=True))
    shapes = record_inputs(monkeypatch, detector)

    detector.batch([image(128, 64), image(64, 120), image(640, 100)])

    assert shapes == [(1, 3, 32, 64), (1, 3, 64, 64), (1, 3, 32, 64)]


def record_inputs(monkeypatch, detector):
    session, shapes = detector._single._session, []

    def run(blob, run=session.run):
        shapes.append(blob.shape)
        return run(blob)

    monkeypatch.setattr(session, "run", run)
    return shapes


def test_on_a_gpu_images_of_one_input_size_share_a_call(spot_model, monkeypatch):
    detector = Detector(*spot_model(size_wh=(64, 64), dynamic_batch=True, dynamic_size=True))
    images = [spot_image(64, 32, [(8 * i, 8, RED)]) for i in range(3)]
    images.insert(1, spot_image(32, 64, [(16, 40, GREEN)]))
    one_by_one = detector.batch(images)
    monkeypatch.setattr(detector._single, "on_gpu", True)
    shapes = record_inputs(monkeypatch, detector)

    together = detector.batch(images)

    assert shapes == [(3, 3, 32, 64), (1, 3, 64, 32)]
    for a, b in zip(one_by_one, together, strict=True):
        assert len(a) == 1
        np.testing.assert_array_equal(a.boxes_xyxy, b.boxes_xyxy)
        np.testing.assert_array_equal(a.class_probs, b.class_probs)


def test_streams_give_what_one_after_the_other_gives(spot_model):
    model = spot_model(score_threshold=0.5)
    random = np.random.default_rng(0)
    images = [spot_image(64, 32, [(int(random.integers(0, 60)), 8, RED)]) for _ in range(40)]

    expected = Detector(*model, Execution(threads=1)).batch(images)
    streams = Detector(*model, Execution(threads=2, streams=2))

    for found, wanted in zip(streams.batch(images), expected, strict=True):
        np.testing.assert_array_equal(found.boxes_xyxy, wanted.boxes_xyxy)
    np.testing.assert_array_equal(streams(images[0]).boxes_xyxy, expected[0].boxes_xyxy)


def test_region_keeps_the_resolution(spot_model):
    small = spot_image(1280, 640, [(900, 200, RED)])  # 4 px: a fifth of a pixel of the whole image's input
    detector = Detector(*spot_model(score_threshold=0.5))

    whole, inside = detector.batch([small, small], regions=[None, (880, 190, 930, 214)])

    assert len(whole) == 0
    assert_surrounds(inside, 900, 200)


def test_region_of_a_model_of_free_size(spot_model, monkeypatch):
    detector = Detector(*spot_model(size_wh=(640, 640), dynamic_size=True, score_threshold=0.5))
    shapes = record_inputs(monkeypatch, detector)

    found = detector(spot_image(1280, 640, [(904, 200, GREEN)]), region=(850.5, 180, 960, 231))

    assert shapes == [(1, 3, 64, 128)]
    assert_surrounds(found, 904, 200)


def assert_surrounds(found, left, top):
    """Boxes of 8 px, as at full resolution, that together hold a spot of 4 px and reach no farther than they must."""
    np.testing.assert_array_equal(found.boxes_xyxy[:, 2:] - found.boxes_xyxy[:, :2], np.full((len(found), 2), 8))
    low, high = found.boxes_xyxy[:, :2].min(axis=0), found.boxes_xyxy[:, 2:].max(axis=0)
    assert (low <= [left, top]).all()
    assert (high >= [left + 4, top + 4]).all()
    assert (high - low <= 16).all()


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
    detector = Detector(*constant_model(ROWS))

    with pytest.raises(ValueError, match=message):
        detector(bad_image)
    with pytest.raises(ValueError, match=message):
        detector.batch([image(64, 32), bad_image])


def test_head_without_class_vectors_is_refused(constant_model):
    with pytest.raises(UsageError, match=r"'efficient-nms' .* no class vectors; export with --head raw or"):
        Detector(*constant_model(ROWS, head="efficient-nms"))


def test_no_model_is_run_that_was_exchanged_after_its_hash_was_taken(constant_model):
    path, info = constant_model(ROWS)
    detector = Detector(path, info, Execution(threads=2, streams=2), sha256=sha256(path))
    assert len(detector.batch([image(64, 32)] * 2)) == 2
    path.write_bytes(path.read_bytes() + b" ")

    with pytest.raises(BundleError, match=r"\.onnx: its SHA-256 differs"):
        detector(image(64, 32))  # a single image opens a session with all threads
