import numpy as np
import pytest

from autolights.core import CameraFrame
from autolights.track.misses import behind_mask

SIZE_WH = (1280, 800)
BOXES = np.array([[100.0, 100, 120, 160], [1200, 700, 1300, 900], [-50, -50, -10, -10], [600.4, 300.2, 600.6, 300.4]])


@pytest.mark.parametrize("shape", [(800, 1280), (400, 640), (100, 160)])
def test_a_mask_of_any_resolution_hides_what_is_behind_it(shape: tuple[int, int]) -> None:
    mask = np.zeros(shape, dtype=bool)
    assert not behind_mask(BOXES, mask, SIZE_WH).any()
    mask[:] = True
    assert behind_mask(BOXES, mask, SIZE_WH).tolist() == [True, True, False, True], "nothing is told beyond the image"
    mask[:] = False
    mask[: shape[0] // 2, : shape[1] // 2] = True
    assert behind_mask(BOXES, mask, SIZE_WH).tolist() == [True, False, False, True]


@pytest.mark.parametrize(("rows", "hidden"), [(14, False), (16, True)])
def test_a_quarter_of_a_light_is_enough_to_be_missed(rows: int, hidden: bool) -> None:
    mask = np.zeros((800, 1280), dtype=bool)
    mask[100 : 100 + rows] = True  # of 60
    assert behind_mask(BOXES[:1], mask, SIZE_WH).tolist() == [hidden]


def test_a_coarse_cell_counts_as_far_as_the_light_lies_in_it() -> None:
    mask = np.zeros((100, 160), dtype=bool)  # cells of 8 px
    mask[:, 10] = True  # from 80 to 88 px
    boxes = np.array([[68.4, 100, 80.4, 140], [76.0, 100, 88.0, 140], [79.0, 100, 82.0, 140]])
    assert behind_mask(boxes, mask, SIZE_WH).tolist() == [False, True, True]
    fine = mask.repeat(8, axis=0).repeat(8, axis=1)
    assert behind_mask(boxes, fine, SIZE_WH).tolist() == [False, True, True]


@pytest.mark.parametrize("mask", [np.zeros((8, 8)), np.zeros((8, 8, 1), dtype=bool), np.zeros((0, 8), dtype=bool)])
def test_what_is_no_mask_is_refused(mask: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"occlusion must be \(h, w\) of bool, got"):
        CameraFrame("front", 0, np.zeros((8, 8, 3), np.uint8), mask)
