import numpy as np
import pytest

from autolights.track.linking import link_across_cameras

VEHICLE = np.array([100.0, 100.0, 0.0])


@pytest.mark.parametrize(
    ("offset", "linked"),
    [
        pytest.param([5.0, 0.0, 0.0], {0: 0}, id="depth-is-rough"),
        pytest.param([0.0, 0.4, 0.0], {0: 0}, id="direction-agrees"),
        pytest.param([0.0, 1.5, 0.0], {}, id="the-neighbour-is-another-light"),
        pytest.param([12.0, 0.0, 0.0], {}, id="the-next-junction"),
    ],
)
def test_two_cameras_mean_the_same_light(offset: list[float], linked: dict[int, int]) -> None:
    known = VEHICLE + np.array([[40.0, 0.0, 0.0]])
    assert link_across_cameras(known, known + offset, VEHICLE) == linked


def test_nothing_to_link() -> None:
    assert link_across_cameras(np.empty((0, 3)), VEHICLE + np.ones((2, 3)), VEHICLE) == {}
