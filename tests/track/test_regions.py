import numpy as np
import pytest

from autolights.core import parse_config
from autolights.core.errors import ConfigError
from autolights.track import RegionConfig, region_of_interest

SIZE_WH = (1000, 600)
NONE = np.empty((0, 4))
TWO = np.array([[400.0, 200, 410, 230], [700, 150, 720, 210]])


def around(**settings):
    return RegionConfig(**{"margin_px": 20, "margin_heights": 0.5, **settings})


@pytest.mark.parametrize(
    ("config", "known", "region"),
    [
        pytest.param(around(), TWO, (365, 100, 770, 265), id="around-both"),
        pytest.param(around(), TWO[:1], (365, 165, 445, 265), id="around-one"),
        pytest.param(around(), NONE, None, id="nothing-known-is-everything"),
        pytest.param(around(), np.subtract(TWO, [405, 0, 405, 0]), (0, 100, 365, 265), id="cut-at-the-edge"),
        pytest.param(around(), TWO + 5000, None, id="out-of-sight"),
        pytest.param(around(kind="fixed", box=(0, 0.1, 1, 0.5)), NONE, (0, 60, 1000, 300), id="band"),
        pytest.param(around(kind="fixed", box=(0, 0.3, 1, 0.5)), TWO, (0, 100, 1000, 300), id="band-and-the-known"),
    ],
)
def test_by_hand(config, known, region):
    before = known.copy()

    assert region_of_interest(config, known, SIZE_WH) == region

    np.testing.assert_array_equal(known, before)


@pytest.mark.parametrize("box", [[0, 0.5, 1, 0.5], [0, 0, 1, 1.5], [0.9, 0, 0.1, 1]])
def test_band_that_is_none(box):
    with pytest.raises(ConfigError, match=r"pipeline: .*box must be left, top, right, bottom as fractions from 0 to 1"):
        parse_config({"kind": "fixed", "box": box}, RegionConfig, source="pipeline")
