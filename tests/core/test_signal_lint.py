import copy
import re

import pytest

from autolights.core import find_config, load_signals
from autolights.core.config import parse_config, read_yaml
from autolights.core.signal_lint import lint_signals
from autolights.core.signals import SignalSet

VALUES = read_yaml(find_config("signals/autolights_13"))


@pytest.mark.parametrize("name", ["autolights_13", "three_lamp", "three_lamp_flashing"])
def test_shipped_descriptions_are_clean(name: str) -> None:
    assert lint_signals(load_signals(f"signals/{name}")) == []


def lamp(center: list[float]) -> dict:
    return {"color": "green", "shape": "ball", "center": center, "movements": ["through"], "meaning": "go"}


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        pytest.param("3.lamps.blue", lamp([0.5, 0.95]), r"3.lamps.blue: no class lights it", id="unused-lamp"),
        pytest.param("5dh.states.5dh-yellow.lit", ["red"], "5dh-yellow.lit: shows the same as '5dh-red'", id="twins"),
        pytest.param("4.flashing", [], "4-off.lit: a dark class that no flashing pair has", id="dark-without-pair"),
        pytest.param("3.states.3-red.mirror", None, "3-red.mirror: is null, but .* shows '3-red'", id="no-mirror"),
        pytest.param("3.states.3-red.mirror", "3-green", "is '3-green', but .* shows '3-red'", id="wrong-mirror"),
        pytest.param("4.states.4-rleft.mirror", "4-rleft", "'4-rleft', but no class lights the lamps", id="arrow"),
        pytest.param(
            "3.states.3-yellow.mean_s", 9, "3-yellow.mean_s: a steady yellow lasts 3 to 6 s", id="long-yellow"
        ),
        pytest.param("3.states.3-yellow.min_s", 0, "3-yellow.min_s: a steady yellow has a least", id="short-yellow"),
        pytest.param(
            "5dh.states.5dh-green.next", {"5dh-red": 1, "5dh-yellow": 1}, "'5dh-red' stops through without", id="abrupt"
        ),
        pytest.param(
            "3.states.3-red.next", {"3-yellow": 1, "3-green": 1}, "yellow for through right after", id="order"
        ),
    ],
)
def test_oddities_are_named_by_field(path: str, value: object, message: str) -> None:
    values = copy.deepcopy(VALUES)
    *parents, last = path.split(".")
    here = values["types"]
    for parent in parents:
        here = here[parent]
    here[last] = value
    found = lint_signals(parse_config(values, SignalSet, source="signals.yaml"))
    assert re.search(message, "\n".join(found))
