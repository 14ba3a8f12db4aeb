from itertools import permutations

import numpy as np
import pytest

from autolights.core import LightEstimate
from autolights.data import TruthLight
from autolights.evaluate.matching import match_lights, match_seen_boxes


def _truth(position: list[float], map_id: str | None = None) -> TruthLight:
    return TruthLight(
        "A", map_id, "3", "3-red", "3-red", False, (0, 0, 1, 1), 0.0, False, np.array(position), heading_deg=0.0
    )


def _estimate(position: list[float], map_id: str | None = None, *, withheld: bool = False) -> LightEstimate:
    return LightEstimate(
        0, 1, map_id, "4", "4-off", 0.9, False, withheld, np.array(position), None, distance_m=1, last_seen_ns=0
    )


@pytest.mark.parametrize(
    ("truth", "reported", "expected"),
    [
        pytest.param([[0, 0, 10, 10]], [[0, 0, 10, 10]], {0: 0}, id="same"),
        pytest.param([[0, 0, 10, 10]], [[0, 0, 10, 20]], {0: 0}, id="half-overlap-is-enough"),
        pytest.param([[0, 0, 10, 10]], [[0, 0, 10, 20.1]], {}, id="less-is-not"),
        pytest.param([[0, 0, 10, 10]], [[1, 0, 11, 10], [0, 0, 10, 10]], {0: 1}, id="best-first"),
        pytest.param([[0, 0, 10, 10], [1, 0, 11, 10]], [[0, 0, 10, 10]], {0: 0}, id="each-report-once"),
        pytest.param([[0, 0, 10, 10], [1, 0, 11, 10]], [[1, 0, 11, 10], [0, 0, 10, 10]], {0: 1, 1: 0}, id="two"),
        pytest.param([], [[0, 0, 1, 1]], {}, id="no-truth"),
        pytest.param([[0, 0, 1, 1]], [], {}, id="no-report"),
    ],
)
def test_boxes(truth: list[list[float]], reported: list[list[float]], expected: dict[int, int]) -> None:
    got = match_seen_boxes(np.array(truth, float).reshape(-1, 4), np.array(reported, float).reshape(-1, 4))
    assert got == expected


@pytest.mark.parametrize(
    ("truth", "estimates", "expected"),
    [
        pytest.param([_truth([0, 0, 0], "a")], [_estimate([50, 0, 0], "a")], {0: 0}, id="a-name-beats-any-distance"),
        pytest.param([_truth([0, 0, 0], "a")], [_estimate([1, 0, 0], "b")], {}, id="another-light's-name"),
        pytest.param([_truth([0, 0, 0], "a")], [_estimate([1, 0, 0], "ghost")], {0: 0}, id="a-name-that-is-no-light's"),
        pytest.param([_truth([0, 0, 0])], [_estimate([2.9, 0, 0])], {0: 0}, id="within-three-metres"),
        pytest.param([_truth([0, 0, 0])], [_estimate([0, 0, 3.1])], {}, id="beyond-three-metres-in-space"),
        pytest.param(
            [_truth([0, 0, 0]), _truth([2, 0, 0])],
            [_estimate([1.9, 0, 0]), _estimate([4.5, 0, 0])],
            {0: 0, 1: 1},
            id="most-pairs-rather-than-nearest-first",
        ),
        pytest.param(
            [_truth([0, 0, 0])], [_estimate([0, 0, 0], withheld=True), _estimate([1, 0, 0])], {0: 1}, id="active-first"
        ),
        pytest.param([_truth([0, 0, 0])], [_estimate([0, 0, 0], withheld=True)], {0: 0}, id="withheld-still-matches"),
        pytest.param([], [_estimate([0, 0, 0])], {}, id="no-truth"),
    ],
)
def test_lights(truth: list[TruthLight], estimates: list[LightEstimate], expected: dict[int, int]) -> None:
    assert match_lights(truth, estimates, frozenset({"a", "b"})) == expected


@pytest.mark.parametrize("seed", range(20))
def test_positions_match_as_enumeration_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 5, 2)
    truth = [_truth(list(p)) for p in rng.uniform(0, 5, (n, 3))]
    estimates = [_estimate(list(p)) for p in rng.uniform(0, 5, (m, 3))]
    distance = np.linalg.norm([[t.position - e.position for e in estimates] for t in truth], axis=-1)
    best = (0, 0.0)
    columns = [*range(m), *[None] * n]
    for chosen in set(permutations(columns, int(n))):
        pairs = [(i, j) for i, j in enumerate(chosen) if j is not None]
        if all(distance[i, j] <= 3 for i, j in pairs):
            best = min(best, (-len(pairs), sum(distance[i, j] for i, j in pairs)))
    got = match_lights(truth, estimates, frozenset())
    assert (-len(got), sum(distance[i, j] for i, j in got.items())) == pytest.approx(best)
