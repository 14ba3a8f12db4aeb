import cv2
import numpy as np
import pytest

from autolights.data import load_image_dataset
from autolights.train.config import TrainConfig
from autolights.train.dataset import TrainingSamples, Visit

MIRRORS = np.array([0, -1])


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
    return load_image_dataset(root, "train", classes=["ball", "arrow"])


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
    samples = samples_of(images, augment={"rotate_deg": 0, "scale": 0, "translate": 0, "flip": 1.0})

    ball, arrow = (draw(samples, 1, 0, index)[1][0] for index in (0, 1))

    assert ball[1] == pytest.approx(1 - 25 / 120, abs=1e-6)
    assert arrow[1] == pytest.approx(35 / 120, abs=1e-6)


def test_a_sample_depends_on_its_visit_alone(images):
    first, second = samples_of(images), samples_of(images, cache_mb=0)
    draw(first, 1, 5, 2)

    (picture, labels), (again, labels_again) = (draw(samples, 1, 7, 3) for samples in (first, second))

    assert (picture == again).all()
    assert (labels == labels_again).all()
    assert (picture != draw(first, 2, 7, 3)[0]).any()
