"""The public nano on real photos: it computes what its own program computes, and finds what is labelled."""

from pathlib import Path

import cv2
import pytest
import torch

from autolights.train.network.model import YoloV5
from autolights.train.network.weights import load_checkpoint

SHARED = Path(__file__).parents[3].parent / "shared"
PUBLIC = SHARED / "weights/yolov5n.pt"
TRAFFIC_LIGHT = 9


@pytest.fixture(scope="module")
def nano() -> YoloV5:
    if not PUBLIC.is_file():
        pytest.skip("the public checkpoint yolov5n.pt is not here")
    return load_checkpoint(PUBLIC)


def find_photo(folder: str, version: str) -> Path:
    """By the beginning of the hash in its name."""
    paths = list((SHARED / "data" / folder / "train/images").glob(f"*.rf.{version}*.jpg"))
    if len(paths) != 1:
        pytest.skip(f"the public photo set {folder} is not here")
    return paths[0]


def run(model: YoloV5, path: Path) -> tuple[torch.Tensor, int]:
    """The raw rows, and the side of the square photo."""
    image = torch.from_numpy(cv2.imread(str(path))[:, :, ::-1].copy()).permute(2, 0, 1)[None] / 255
    with torch.inference_mode():
        return model(image)[0], image.shape[2]


def test_it_says_what_it_says_elsewhere(nano):
    """Golden: the raw output of PyPI's yolov5 7.0.14 with the same file and photo, printed from its own network."""
    raw, _ = run(nano, find_photo("cinta_v2", "3ae134bd"))

    assert (sum(p.numel() for p in nano.parameters()), len(raw)) == (1_872_157, 10_647)
    best = raw[(raw[:, 4] * raw[:, 5 + TRAFFIC_LIGHT]).argmax()]
    torch.testing.assert_close(best[:4], torch.tensor([180.1161, 219.8706, 125.3256, 253.0302]), atol=1e-3, rtol=0)
    torch.testing.assert_close(best[[4, 5 + TRAFFIC_LIGHT]], torch.tensor([0.794959, 0.998132]), atol=1e-5, rtol=0)
    assert raw[:, 4].sum().item() == pytest.approx(11.79153, abs=1e-3)


@pytest.mark.parametrize(
    ("folder", "versions"),
    [
        pytest.param("cinta_v2", ["7125cbb1", "4e785b50", "951504b9"], id="housings"),
        pytest.param("traffic_light_kr", ["588ec612", "0f1629e0", "69d7a6f4"], id="bulbs"),
    ],
)
def test_it_finds_labelled_lights(nano, folder, versions):
    """Each label's centre lies in a box that it calls a traffic light."""
    assert nano.classes[TRAFFIC_LIGHT] == "traffic light"
    for version in versions:
        path = find_photo(folder, version)
        lines = (path.parents[1] / "labels" / f"{path.stem}.txt").read_text().splitlines()
        centres = torch.tensor([[float(value) for value in line.split()[1:3]] for line in lines])
        raw, side_px = run(nano, path)

        lights = raw[raw[:, 4] * raw[:, 5 + TRAFFIC_LIGHT] > 0.25]
        distances = (centres[:, None] * side_px - lights[None, :, :2]).abs()
        found = (distances < lights[None, :, 2:4] / 2).all(dim=2).any(dim=1)
        assert len(found) > 0
        assert found.all(), f"{path.name}: {found.tolist()}"
