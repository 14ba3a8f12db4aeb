import cv2
import numpy as np
import pytest

from autolights.infer.letterbox import GREY
from autolights.train.config import AugmentConfig, CropConfig
from autolights.train.samples.placement import (
    Placement,
    draw_placed,
    place_crop,
    place_mosaic,
    place_whole,
    visible_part,
)

STILL = AugmentConfig(rotate_deg=0, scale=0, translate=0)
WHITE = 255


def image_with_light(size_wh, box_xyxy):
    """Black, with one white light."""
    image = np.zeros((size_wh[1], size_wh[0], 3), np.uint8)
    left, top, right, bottom = box_xyxy
    image[top:bottom, left:right] = WHITE
    return image


def drawn(placement, image, side_px):
    canvas = np.empty((side_px, side_px, 3), np.uint8)
    draw_placed([(image, placement)], canvas)
    return canvas


def extent_of_white(canvas):
    rows, columns = np.nonzero(canvas[..., 0] > 185)
    return [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]


def test_a_whole_image_is_letterboxed():
    placement = place_whole((80, 40), (160, 160), STILL, np.random.default_rng(0))
    canvas = drawn(placement, image_with_light((80, 40), (10, 10, 20, 30)), 160)

    np.testing.assert_allclose(placement.boxes(np.array([[10, 10, 20, 30]])), [[20, 60, 40, 100]])
    assert extent_of_white(canvas) == pytest.approx([20, 60, 40, 100], abs=1)
    assert (canvas[:39] == GREY).all()
    assert (canvas[121:] == GREY).all()


def test_a_whole_image_fills_a_canvas_of_its_shape():
    placement = place_whole((300, 190), (320, 224), STILL, np.random.default_rng(0))

    corners = placement.boxes(np.array([[0, 0, 300, 190.0]]))[0]
    scale = 320 / 300
    np.testing.assert_allclose(corners, [0, 112 - 95 * scale, 320, 112 + 95 * scale])


@pytest.mark.parametrize("rotate_deg", [0, 40])
@pytest.mark.parametrize("scale", [0.3, 1.0, 2.6])
def test_drawing_what_meets_draws_as_drawing_everything(scale, rotate_deg):
    """Against one call over the whole canvas, in three channels; edges aside, which OpenCV smears over the outline."""
    covered = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        image = rng.integers(0, 256, (70, 90, 3), dtype=np.uint8)
        placement = Placement.turned_about(
            rng.uniform(0, 80, 2),
            rng.uniform(-90, 180, 2),
            scale=scale,
            rotation_deg=rng.uniform(-rotate_deg, rotate_deg),
        )
        matrix = placement.canvas_from_image.copy()
        matrix[:, 2] += 0.5 * matrix[:, :2].sum(axis=1) - 0.5
        expected = np.full((96, 96, 3), GREY, np.uint8)
        cv2.warpAffine(image, matrix, (96, 96), dst=expected, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT)

        difference = np.abs(drawn(placement, image, 96).astype(int) - expected).max(axis=2)

        centres = np.stack(np.meshgrid(np.arange(96), np.arange(96)), axis=-1) + 0.5
        in_image = (centres - placement.canvas_from_image[:, 2]) @ np.linalg.inv(placement.canvas_from_image[:, :2]).T
        inside = (np.abs(in_image - (45, 35)) < (44, 34)).all(axis=2)
        outside = (np.abs(in_image - (45, 35)) > (46, 36)).any(axis=2)
        assert difference[inside | outside].max(initial=0) <= 1
        covered += inside.sum()
    assert covered > 500


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_placement_draws_the_mirrored_canvas(axis):
    placement = Placement.turned_about(np.array([40, 20]), np.array([70.5, 64]), scale=1.3, rotation_deg=7)
    image = image_with_light((80, 40), (10, 10, 20, 30))

    mirrored = drawn(placement.mirrored(128, axis), image, 128)

    difference = np.abs(np.flip(mirrored, 1 - axis).astype(int) - drawn(placement, image, 128))
    assert difference.max() <= 2


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("rotate_deg", [0, 10])
def test_labels_stay_on_what_they_label(seed, rotate_deg):
    box = (300, 120, 330, 200)
    image, boxes = image_with_light((640, 400), box), np.array([box], dtype=float)
    rng = np.random.default_rng(seed)
    config = AugmentConfig(rotate_deg=rotate_deg, translate=0.05)
    crops = CropConfig(size=192, scale=(0.6, 1.1), light_share=1.0)

    for placement in (
        place_whole((640, 400), (192, 192), config, rng),
        place_crop((640, 400), boxes, crops, rotate_deg, rng),
    ):
        moved = placement.boxes(boxes)
        clipped, kept, _ = visible_part(moved, (192, 192), config)
        if kept[0]:
            extent = extent_of_white(drawn(placement, image, 192))
            assert extent == pytest.approx(clipped[0].tolist(), abs=2.5)


@pytest.mark.parametrize("seed", range(20))
def test_a_crop_around_a_light_holds_it_and_stays_inside_the_image(seed):
    boxes = np.array([[3.0, 5, 25, 70], [600, 300, 630, 390]])
    crops = CropConfig(size=192, scale=(0.5, 1.2), light_share=1.0)
    placement = place_crop((640, 400), boxes, crops, 0.0, np.random.default_rng(seed))

    moved = placement.boxes(boxes)
    assert any((box[:2] >= -1e-6).all() and (box[2:] <= 192 + 1e-6).all() for box in moved)
    assert not (drawn(placement, np.zeros((400, 640, 3), np.uint8), 192)[1:-1, 1:-1] > 0).any()
    scale = placement.canvas_from_image[0, 0]
    assert 0.5 <= scale <= 1.2


def test_crops_of_images_without_lights_or_smaller_than_the_crop():
    crops = CropConfig(size=192, scale=(1.0, 1.0))
    rng = np.random.default_rng(1)

    whole = drawn(place_crop((64, 48), np.empty((0, 4)), crops, 0.0, rng), np.zeros((48, 64, 3), np.uint8), 192)

    assert (whole[:48, :64][1:-1, 1:-1] == 0).all()
    assert (whole[50:] == GREY).all()


@pytest.mark.parametrize("seed", range(6))
def test_four_images_meet_in_a_mosaic(seed):
    rng = np.random.default_rng(seed)
    config = AugmentConfig(rotate_deg=0, scale=0.5, translate=0.1)
    placements = place_mosaic([(64, 64), (64, 48), (32, 64), (64, 64)], 128, config, rng)

    corners = [
        placement.canvas_from_image[:, :2] @ corner + placement.canvas_from_image[:, 2]
        for placement, corner in zip(placements, [(64, 64), (0, 48), (32, 0), (0, 0)], strict=True)
    ]

    np.testing.assert_allclose(corners, np.tile(corners[0], (4, 1)), atol=1e-9)
    box = np.array([[8.0, 8, 40, 40]])
    clipped, kept, _ = visible_part(placements[3].boxes(box), (128, 128), config)
    if kept[0]:
        extent = extent_of_white(drawn(placements[3], image_with_light((64, 64), (8, 8, 40, 40)), 128))
        assert extent == pytest.approx(clipped[0].tolist(), abs=2.5)


def test_labels_that_are_hardly_seen_are_dropped():
    boxes = np.array([[-4.0, 0, 6, 10], [-6, 0, 4, 10], [5, 5, 6.5, 30], [200, 0, 210, 10]])

    clipped, kept, seen = visible_part(boxes, (100, 100), AugmentConfig(min_visible=0.5, min_side_px=2))

    assert kept.tolist() == [True, False, False, False]
    assert seen.tolist() == [True, True, True, False]
    assert clipped[0].tolist() == [0, 0, 6, 10]
