import math
from itertools import pairwise
from pathlib import Path

import pytest
from pydantic import Field

from autolights.core import Config, find_config, load_config, parse_config, save_config
from autolights.core.config import read_yaml
from autolights.core.errors import ConfigError


class Optimizer(Config):
    rate: float = Field(default=0.008, gt=0)
    name: str = "sgd"


class Stage(Config):
    epochs: int = 1


class Training(Config):
    epochs: int = 10
    optimizer: Optimizer = Optimizer()
    stages: dict[str, Stage] = Field(default_factory=dict)
    warm_up: Optimizer | None = None
    mode: str = "off"


@pytest.fixture
def file(tmp_path):
    def write(text: str) -> Path:
        path = tmp_path / "train.yaml"
        path.write_text(text)
        return path

    return write


def test_values_of_the_file_over_defaults_overrides_over_both(file):
    config = load_config(
        file("epochs: 3\noptimizer: {rate: 0.1}\n"), Training, ["optimizer.rate=8e-3", "warm_up.name=adam"]
    )

    assert config == Training(epochs=3, optimizer=Optimizer(rate=0.008), warm_up=Optimizer(name="adam"))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("8e-3", 0.008),
        ("1e6", 1e6),
        ("-.5", -0.5),
        (".inf", math.inf),
        ("12", 12),
        ("off", "off"),
        ("no", "no"),
        ("Yes", "Yes"),
        ("true", True),
        ("FALSE", False),
        ("2023-05-01", "2023-05-01"),
        ("1.2.3", "1.2.3"),
        ("null", None),
        ("3-red", "3-red"),
    ],
)
def test_yaml_means_what_people_mean(file, text, value):
    read = read_yaml(file(f"key: {text}"))["key"]

    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize(
    ("text", "overrides", "message"),
    [
        pytest.param("epoch: 3", [], r"train\.yaml: unknown key 'epoch'; did you mean 'epochs'\?", id="unknown"),
        pytest.param("zebra: 3", [], r"unknown key 'zebra'$", id="nothing-alike"),
        pytest.param("optimizer: {rat: 1}", [], r"unknown key 'rat' in optimizer; did you mean 'rate'", id="nested"),
        pytest.param("warm_up: {rat: 1}", [], r"unknown key 'rat' in warm_up; did you mean 'rate'", id="optional"),
        pytest.param("stages: {a: {epoch: 1}}", [], r"'epoch' in stages.a; did you mean 'epochs'", id="dict"),
        pytest.param("epochs: many", [], r"'epochs': .* valid integer.*, got 'many'", id="type"),
        pytest.param("optimizer: {rate: -1}", [], r"'rate' in optimizer: .* greater than 0, got -1", id="range"),
        pytest.param("epochs: 1\nepochs: 2", [], r"not YAML: key 'epochs' is repeated", id="repeated"),
        pytest.param("- 1", [], r"must hold keys and values, got list", id="list"),
        pytest.param("a: [", [], r"train\.yaml: not YAML", id="no-yaml"),
        pytest.param("", [], r"must hold keys and values, got NoneType", id="empty"),
        pytest.param("epochs: 1", ["epochs"], r"override 'epochs' must read key\.sub=value", id="override-shape"),
        pytest.param("epochs: 1", ["epoch=2"], r"unknown key 'epoch'; did you mean 'epochs'", id="override-key"),
        pytest.param("epochs: 1", ["epochs=[1"], r"override 'epochs=\[1': the value is not YAML", id="override-yaml"),
    ],
)
def test_mistakes_are_named(file, text, overrides, message):
    with pytest.raises(ConfigError, match=message):
        load_config(file(text), Training, overrides)


def test_missing_key():
    class Strict(Config):
        folder: str

    with pytest.raises(ConfigError, match="here: key 'folder' is missing"):
        parse_config({}, Strict, source="here")


def test_missing_file_lists_what_is_shipped():
    with pytest.raises(ConfigError, match=r"signals/paper: no such file, .* shipped: .*signals/autolights_13"):
        load_config("signals/paper", Training)


@pytest.mark.parametrize("name", ["signals/autolights_13", "configs/signals/autolights_13.yaml"])
def test_shipped_configurations_go_by_name(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    assert find_config(name).name == "autolights_13.yaml"


def test_a_saved_configuration_reads_back(tmp_path):
    config = Training(epochs=4, optimizer=Optimizer(rate=1e-5, name="off"), stages={"1": Stage()})

    save_config(config, tmp_path / "config.yaml")

    assert load_config(tmp_path / "config.yaml", Training) == config


def test_overrides_leave_the_given_values_alone():
    values = {"optimizer": {"rate": 0.1}}

    parse_config(values, Training, ["optimizer.rate=0.2"], source="test")

    assert values == {"optimizer": {"rate": 0.1}}


def test_aliases_are_refused(tmp_path: Path) -> None:
    laughs = "a: &a [x, x]\n" + "\n".join(f"{b}: &{b} [*{a}, *{a}]" for a, b in pairwise("abcdefghi"))
    (tmp_path / "laughs.yaml").write_text(laughs)

    with pytest.raises(ConfigError, match=r"laughs\.yaml: not YAML: an alias"):
        read_yaml(tmp_path / "laughs.yaml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        pytest.param("[" * 20_000, "nested too deeply", id="deep"),
        pytest.param("x" * (4 * 2**20 + 1), "more than the 4,194,304", id="large"),
    ],
)
def test_absurd_files_are_refused_in_words(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "absurd.yaml").write_text(text)

    with pytest.raises(ConfigError, match=rf"absurd\.yaml: .*{message}"):
        read_yaml(tmp_path / "absurd.yaml")
