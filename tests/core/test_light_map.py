import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autolights.core import TrafficLightMap
from autolights.core.errors import MapError


def lights(positions, **columns):
    positions = np.asarray(positions, dtype=float).reshape(-1, 3)
    n = len(positions)
    given_columns = {
        "ids": tuple(f"light-{i}" for i in range(n)),
        "types": ("3",) * n,
        "headings_deg": np.zeros(n),
        "sizes_m": np.tile([0.36, 1.07, 0.3], (n, 1)),
        **columns,
    }
    return TrafficLightMap(positions=positions, **given_columns)


@given(st.integers(0, 2**32 - 1), st.integers(0, 30), st.floats(0, 60))
def test_range_query_against_all_distances(seed, n, radius_m):
    random = np.random.default_rng(seed)
    positions, here = random.uniform(-50, 50, (n, 3)), random.uniform(-50, 50, 3)

    found = lights(positions).within(here, radius_m)

    np.testing.assert_array_equal(found, np.flatnonzero(np.linalg.norm(positions - here, axis=1) <= radius_m))


def test_rows():
    town = lights([[1, 2, 3], [4, 5, 6]], intersections=("a", "b"))

    taken = town.take(np.array([1]))
    assert (taken.ids, taken.intersections, taken.groups) == (("light-1",), ("b",), ("",))
    assert (taken.positions.tolist(), taken.sizes_m.tolist()) == ([[4, 5, 6]], [[0.36, 1.07, 0.3]])
    assert len(town.take(np.array([], dtype=int))) == 0


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        pytest.param({"ids": ("a", "a")}, "light ids must be unique, got 'a' more than once", id="ids"),
        pytest.param({"types": ("3",)}, "a map of 2 lights needs 2 types, got 1", id="types"),
        pytest.param({"headings_deg": [0.0]}, r"headings_deg must have shape \(2\), got \(1,\)", id="headings"),
        pytest.param({"sizes_m": np.full((2, 3), np.nan)}, "sizes_m must be finite, got 6 NaN", id="nan"),
        pytest.param({"groups": ("g",)}, "a map of 2 lights needs 2 groups, got 1", id="groups"),
    ],
)
def test_columns_must_fit(columns, message):
    with pytest.raises(MapError, match=message):
        lights([[0, 0, 0], [1, 1, 1]], **columns)
