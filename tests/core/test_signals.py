import copy

import numpy as np
import pytest

from autolights.core import find_config, load_signals
from autolights.core.config import parse_config, read_yaml
from autolights.core.errors import ConfigError
from autolights.core.signals import SignalSet

SIGNALS = load_signals()
VALUES = read_yaml(find_config("signals/autolights_13"))


FOREIGN_PAIR = {"on": "3-red", "off": "4-off", "reported": "4-off"}


def test_classes_are_the_papers():
    assert len(SIGNALS.classes) == 13
    assert SIGNALS.states_of("4") == ("4-gleft", "4-off", "4-rleft", "4-yleft1", "4-yleft2")
    assert all(SIGNALS.type_of[name] == name.partition("-")[0] for name in SIGNALS.classes)
    assert [SIGNALS.class_ids[name] for name in SIGNALS.classes] == list(range(13))


def test_mirror_images():
    own = {"3-green", "3-red", "3-yellow", "4-off", "5dh-red"}

    for i, mirror in enumerate(SIGNALS.mirror_ids()):
        assert mirror == (i if SIGNALS.classes[i] in own else None)


def test_a_flash_is_reported_under_one_name():
    assert SIGNALS.reported("4-off") == "4-yleft2"
    assert SIGNALS.reported("4-yleft2") == "4-yleft2"
    assert SIGNALS.reported("5dh-red") == "5dh-red"


@pytest.mark.parametrize(
    ("class_name", "meanings"),
    [
        ("3-yellow", {"through": "caution"}),
        ("4-off", {}),
        ("5dh-red", {"through": "stop", "left": "stop"}),
        ("5dh-red-gleft", {"through": "stop", "left": "go"}),
        ("5dh-red-yleft", {"through": "stop", "left": "caution"}),
        ("5dh-yellow", {"through": "caution", "left": "caution"}),
        ("5dh-green", {"through": "go"}),
    ],
)
def test_what_a_state_says(class_name, meanings):
    assert SIGNALS.meanings(class_name) == meanings


@pytest.mark.parametrize("type_name", list(SIGNALS.types))
def test_rates_follow_durations_and_successors(type_name):
    rates, states = SIGNALS.rates(type_name), SIGNALS.states_of(type_name)

    np.testing.assert_allclose(rates.sum(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(-1 / np.diag(rates), [SIGNALS.state(name).mean_s for name in states])
    for i, name in enumerate(states):
        legal = {states[j] for j in np.flatnonzero(rates[i] > 0)}
        assert legal == set(SIGNALS.state(name).next)


def test_rates_by_hand():
    rates, states = SIGNALS.rates("4"), SIGNALS.states_of("4")

    off, lit, green = states.index("4-off"), states.index("4-yleft2"), states.index("4-gleft")
    assert rates[off, lit] == pytest.approx(30 / 32 / 0.46)
    assert rates[off, green] == pytest.approx(1 / 32 / 0.46)


def test_sizes():
    assert SIGNALS.sizes_m(["5dh", "3"]).tolist() == [[0.8, 1.07, 0.3], [0.36, 1.07, 0.3]]
    assert SIGNALS.sizes_m([]).shape == (0, 3)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        pytest.param("3.states.3-red.lit", ["blue"], "'3-red' lights lamp 'blue', which type '3' lacks", id="lamp"),
        pytest.param("3.states.3-red.next", {"4-off": 1}, "'3-red' cannot be followed by '4-off'", id="other-type"),
        pytest.param("3.states.3-red.next", {"3-red": 1}, "'3-red' cannot be followed by '3-red'", id="itself"),
        pytest.param("3.states.3-red.next", {"3-green": 0}, "the weight of '3-green' must be positive", id="weight"),
        pytest.param("3.states.3-red.next", {}, "class '3-red' has no successor", id="trap"),
        pytest.param(
            "3.states.3-green.next", {"3-red": 1}, "type '3': class '3-yellow' can never follow", id="unreachable"
        ),
        pytest.param("3.states.3-red.mirror", "3-blue", "'3-red' of '3': unknown mirror class '3-blue'", id="mirror"),
        pytest.param("3.states.3-red.mean_s", 0, "greater than 0", id="duration"),
        pytest.param("4.flashing", [FOREIGN_PAIR], "flashing pair of type '4' names the unknown class", id="pair"),
        pytest.param("3.states.3-red.min_s", 60, "'3-red': its least duration min_s of 60 s is above", id="min"),
        pytest.param("4.flashing.0.off", "4-rleft", "the off state none, a flash needs a dark class", id="lit-off"),
        pytest.param("4.states.4-yleft2.lit", [], "the on state must light a lamp", id="dark-on"),
        pytest.param("4.flashing.0.reported", "4-rleft", "reported as '4-rleft', which is neither", id="reported"),
        pytest.param("4.flashing.0.period_s", [1.2, 1.0], "period_s must rise from above 0", id="period"),
        pytest.param("4.flashing.0.on_ratio", [0.5, 1.0], r"on_ratio must rise within \(0, 1\)", id="ratio"),
        pytest.param("4.states.4-yleft2.next", {"4-yleft1": 1}, "'4-off' can never follow|cannot alternate", id="alt"),
        pytest.param("3.lamps.red.movements", [], "at least 1 item", id="a-lamp-that-speaks-to-nobody"),
        pytest.param("3.hieght_m", 1, r"unknown key 'hieght_m' in types.3; did you mean 'height_m'", id="typo"),
    ],
)
def test_descriptions_that_cannot_be(path, value, message):
    values = copy.deepcopy(VALUES)
    *parents, last = path.split(".")
    here = values["types"]
    for parent in parents:
        here = here[int(parent) if parent.isdecimal() and isinstance(here, list) else parent]
    here[last] = value

    with pytest.raises(ConfigError, match=message):
        parse_config(values, SignalSet, source="signals.yaml")


def test_classes_without_a_state():
    with pytest.raises(ConfigError, match=r"only in one: \['6-red'\]"):
        parse_config({**VALUES, "classes": [*VALUES["classes"], "6-red"]}, SignalSet, source="signals.yaml")


def test_a_class_of_two_types():
    values = copy.deepcopy(VALUES)
    values["types"]["9"] = values["types"]["3"]

    with pytest.raises(ConfigError, match="class '3-green' belongs to types '3' and '9'"):
        parse_config(values, SignalSet, source="signals.yaml")
