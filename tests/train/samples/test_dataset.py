import shutil

import cv2
import numpy as np
import pytest

from autolights.core.errors import DataError
from autolights.data import load_image_dataset
from autolights.train.config import TrainConfig
from autolights.train.samples.dataset import TrainingSamples, Visit

CLASSES = ["ball", "arrow", "other arrow"]
MIRRORS = np.array([0, -1, -1])
STILL = {"rotate_deg": 0, "scale": 0, "translate": 0, "jitter": 0, "blur": 0}


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Six images with a bright light each, class 0 or 1 by turns."""
    root = tmp_path_factory.mktemp("images")
    for part in ("images/train", "labels/train"):
        (root / part).mkdir(parents=True)
    rng = np.random.default_rng(3)
    for i in range(6):
        image = rng.integers(0, 60, (80, 120, 3), dtype=np.uint8)
        image[30:60, 20 + 10 * i : 30 + 10 * i] = 255
        cv2.imwrite(str(root / f"images/train/{i}.png"), image)
        (root / f"labels/train/{i}.txt").write_text(f"{i % 2} {(25 + 10 * i) / 120} {45 / 80} {10 / 120} {30 / 80}")
    return load_image_dataset(root, "train", classes=CLASSES)


def config(images, **settings):
    return TrainConfig(data=str(images.root), **{"batch": 4, "workers": 0, "image_size": 96, **settings})


def samples_of(images, **settings):
    return TrainingSamples(images, MIRRORS, config(images, **settings))


def draw(samples, epoch, position, index):
    """A sample's picture and labels."""
    width, height = samples.canvases_wh[index].tolist()
    canvas = np.zeros((height, width, 3), np.uint8)
    return canvas, samples.draw(Visit(epoch, position, index, (width, height)), canvas)


@pytest.mark.parametrize(
    "settings",
    [{"augment": {"mosaic": 0.0}}, {"augment": {"mosaic": 1.0}}, {"crops": {"size": 64}}],
    ids=["whole", "mosaic", "crops"],
)
def test_labels_lie_on_lights(images, settings):
    settings = {**settings, "augment": {**settings.get("augment", {}), "rotate_deg": 0, "jitter": 0, "blur": 0}}
    samples = samples_of(images, **settings)
    side_px = 64 if "crops" in settings else 96

    seen = 0
    for position in range(30):
        picture, labels = draw(samples, 1, position, position % 6)
        assert picture.shape == (side_px, side_px, 3)
        for _, cx, cy, width, height in labels:
            left, top = round((cx - width / 2) * side_px) + 1, round((cy - height / 2) * side_px) + 1
            right, bottom = round((cx + width / 2) * side_px) - 1, round((cy + height / 2) * side_px) - 1
            inside = picture[top:bottom, left:right]
            if inside.size:
                assert inside.mean() > 200
                seen += 1
    assert seen > 15


def test_arrows_are_never_mirrored(images):
    """The lights of images 0 and 1 lie left of the middle; only the ball's may be found on the right."""
    samples = samples_of(images, augment={**STILL, "flip": 1.0})

    ball, arrow = (draw(samples, 1, 0, index)[1][0] for index in (0, 1))

    assert ball[1] == pytest.approx(1 - 25 / 120, abs=1e-6)
    assert arrow[1] == pytest.approx(35 / 120, abs=1e-6)


def test_arrows_with_a_mirror_class_take_it(images):
    settings = config(images, augment={**STILL, "flip": 1.0})

    picture, labels = draw(TrainingSamples(images, np.array([0, 2, 1]), settings), 1, 0, 1)

    assert labels[0, 0] == 2
    assert labels[0, 1] == pytest.approx(1 - 35 / 120, abs=1e-6)
    assert picture[48, round((1 - 35 / 120) * 96)].min() > 200


def test_what_is_its_own_mirror_image_may_turn_over(images):
    settings = config(images, augment={**STILL, "flip": 0, "flip_vertical": 1.0})
    samples = TrainingSamples(images, np.array([0, 2, 1]), settings)

    (picture, ball), (_, arrow) = (draw(samples, 1, 0, index) for index in (0, 1))
    _, still = draw(samples_of(images, augment={**STILL, "flip": 0}), 1, 0, 0)

    assert ball[0, 2] == pytest.approx(1 - still[0, 2], abs=1e-6)
    assert ball[0, 2] != pytest.approx(still[0, 2])
    assert picture[round(ball[0, 2] * 96), round(ball[0, 1] * 96)].min() > 200
    assert arrow[0, 2] == pytest.approx(still[0, 2], abs=1e-6)


@pytest.mark.parametrize(
    ("settings", "sides"),
    [({"image_size": 96}, (8, 24)), ({"crops": {"size": 64, "scale": (0.5, 2.0)}}, (10, 30))],
    ids=["whole", "crops"],
)
def test_sides_are_those_that_the_network_sees(images, settings, sides):
    np.testing.assert_allclose(samples_of(images, **settings).sides_px(), np.tile(sides, (6, 1)))


def test_rectangular_samples_keep_the_shape_of_the_image(images):
    samples = samples_of(images, rectangular=True, augment={**STILL, "flip": 0, "mosaic": 1.0})

    picture, labels = draw(samples, 1, 0, 2)

    assert picture.shape == (64, 96, 3)  # 96 x 64 px exactly: two thirds
    np.testing.assert_allclose(labels, [[0, 45 / 120, 45 / 80, 10 / 120, 30 / 80]])


def test_images_that_do_not_decode_are_left_out(images, tmp_path):
    shutil.copytree(images.root, tmp_path, dirs_exist_ok=True)
    (tmp_path / "images/train/1.png").write_bytes(b"not a picture")
    broken = load_image_dataset(tmp_path, "train", classes=CLASSES)

    samples = TrainingSamples(broken, MIRRORS, config(broken, bad_images=0.2))

    assert [path.stem for path in samples.images.image_paths] == ["0", "2", "3", "4", "5"]
    _, labels = draw(samples, 1, 0, 1)
    assert labels[0, 0] == 0  # of image 2
    with pytest.raises(DataError, match=r"1 of 6 images cannot be used \(.*1\.png: not an image.*bad_images=0\.1 is"):
        TrainingSamples(broken, MIRRORS, config(broken, bad_images=0.1))


def test_a_sample_depends_on_its_visit_alone(images):
    first, second = samples_of(images), samples_of(images, cache_mb=0)
    draw(first, 1, 5, 2)

    (picture, labels), (again, labels_again) = (draw(samples, 1, 7, 3) for samples in (first, second))

    assert (picture == again).all()
    assert (labels == labels_again).all()
    assert (picture != draw(first, 2, 7, 3)[0]).any()
