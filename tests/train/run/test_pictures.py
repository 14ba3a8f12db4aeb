"""What people are shown of a run."""

import cv2
import torch

from autolights.train.run.engine import train
from autolights.train.run.pictures import draw_batch
from autolights.train.samples.loader import Batch


def test_the_picture_of_a_batch_shows_each_sample_with_its_labels():
    images = torch.zeros(5, 32, 64, 3, dtype=torch.uint8)
    batch = Batch(images, torch.tensor([[1, 0, 0.5, 0.5, 0.5, 0.5]]), (0, 1, 2, 3, 4))

    picture = draw_batch(batch, ["red"])

    assert picture.shape == (64, 256, 3)
    assert picture[8, 64 + 16 : 64 + 49].all(axis=0)[1:].all()
    assert not picture[:, :64].any()
    assert not picture[32:].any()


def test_a_run_leaves_pictures_of_a_batch_and_of_its_best_epoch(tiny, tmp_path):
    train(tiny(epochs=1), tmp_path)

    for name in ("batch.jpg", "predictions.jpg", "pr_curves.png"):
        assert cv2.imread(str(tmp_path / name)) is not None, name
