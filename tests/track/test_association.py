from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from autolights.core import Detections
from autolights.track import ProjectedLights, associate, association_cost
from autolights.track.projection import ANY_TYPE

PRICE = 100.0


def cheapest_by_enumeration(cost: np.ndarray, price: float) -> float:
    """Total cost of the best of all partial pairings; of n lights and m detections min(n, m) pairs could be made."""
    n, m = cost.shape
    best = np.inf
    for k in range(min(n, m) + 1):
        for rows in combinations(range(n), k):
            for columns in permutations(range(m), k):
                best = min(best, cost[list(rows), list(columns)].sum() + price * (min(n, m) - k))
    return best


@given(
    st.tuples(st.integers(0, 4), st.integers(0, 4)).flatmap(
        lambda shape: arrays(float, shape, elements=st.sampled_from([0, 1, 20, 49, 60, 99, 100, 101, 150, np.inf]))
    )
)
@settings(max_examples=150, deadline=None)
def test_pairing_is_the_cheapest_of_all(cost: np.ndarray) -> None:
    before = cost.copy()
    found = associate(cost, unmatched_cost=PRICE)
    rows, columns = found.matches[:, 0], found.matches[:, 1]
    assert np.isfinite(cost[rows, columns]).all()
    total = cost[rows, columns].sum() + PRICE * (min(cost.shape) - len(rows))
    assert total == cheapest_by_enumeration(cost, PRICE)
    assert sorted([*rows, *found.unmatched_lights]) == list(range(cost.shape[0]))
    assert sorted([*columns, *found.unmatched_detections]) == list(range(cost.shape[1]))
    np.testing.assert_array_equal(cost, before)


@pytest.mark.parametrize(
    ("cost", "matches"),
    [
        pytest.param([[1, 9], [8, np.inf]], [[0, 1], [1, 0]], id="two-pairs-beat-the-best-pair"),
        pytest.param([[1, 99], [98, np.inf]], [[0, 0]], id="one-right-pair-beats-two-wrong-ones"),
        pytest.param([[np.inf, np.inf]], [], id="all-forbidden"),
        pytest.param([[100.0]], [], id="as-dear-as-leaving-both"),
    ],
)
def test_price_of_leaving_both(cost: list[list[float]], matches: list[list[int]]) -> None:
    assert associate(np.array(cost, dtype=float), unmatched_cost=PRICE).matches.tolist() == matches


def lights(boxes: list[list[float]], types: list[str]) -> ProjectedLights:
    n = len(boxes)
    return ProjectedLights(
        np.arange(n), np.array(types, dtype=np.str_), np.reshape(boxes, (n, 4)), np.full(n, 30.0), np.ones(n, bool)
    )


def seen(boxes: list[list[float]], class_ids: list[int]) -> Detections:
    return Detections(np.reshape(boxes, (len(boxes), 4)), np.ones(len(boxes)), np.eye(2)[class_ids].reshape(-1, 2))


def test_cost_is_the_distance_of_centre_height_and_width() -> None:
    # centres (15, 30) and (18, 34), sizes 10 x 20 and 10 x 32: differences 3, 4, 12, 0.
    cost = association_cost(
        lights([[10, 20, 20, 40]], ["a"]), seen([[13, 18, 23, 50]], [0]), np.array(["a", "b"]), max_distance_px=14
    )
    np.testing.assert_allclose(cost, [[13.0]])


@pytest.mark.parametrize(
    ("light_type", "class_id", "max_px", "max_heights", "finite"),
    [
        pytest.param("a", 0, 13, None, True, id="at-the-threshold"),
        pytest.param("a", 0, 12.9, None, False, id="beyond-the-threshold"),
        pytest.param("a", 1, 100, None, False, id="other-type"),
        pytest.param(ANY_TYPE, 1, 100, None, True, id="type-still-open"),
        pytest.param("a", 0, 100, 0.65, True, id="within-heights"),
        pytest.param("a", 0, 100, 0.64, False, id="beyond-heights"),
    ],
)
def test_forbidden_pairs(
    light_type: str, class_id: int, max_px: float, max_heights: float | None, finite: bool
) -> None:
    cost = association_cost(
        lights([[10, 20, 20, 40]], [light_type]),
        seen([[13, 18, 23, 50]], [class_id]),
        np.array(["a", "b"]),
        max_distance_px=max_px,
        max_distance_heights=max_heights,
    )
    assert np.isfinite(cost).tolist() == [[finite]]


def test_nothing_with_nothing_costs_nothing() -> None:
    types = np.array(["a", "b"])
    assert association_cost(lights([], []), seen([], []), types, max_distance_px=9).shape == (0, 0)
    assert association_cost(lights([], []), seen([[0, 0, 1, 1]], [0]), types, max_distance_px=9).shape == (0, 1)
