"""YAML files into frozen models: strict, with dotted overrides and errors that name file, key and value."""

import difflib
import re
from collections.abc import Sequence
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from autolights.core.atomic import write_text
from autolights.core.errors import ConfigError


class Config(BaseModel):
    """Base of all configuration: unknown keys are errors, values cannot be changed after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


ConfigT = TypeVar("ConfigT", bound=BaseModel)

_MAX_YAML_BYTES = 4 * 2**20


def load_config(path: Path | str, model: type[ConfigT], overrides: Sequence[str] = ()) -> ConfigT:
    """Read a YAML file into a model.

    Args:
        path: The file, or the name of a shipped one without its ending, e.g. ``train/demo``.
        model: A frozen pydantic model that forbids unknown keys.
        overrides: ``key.sub=value`` texts, applied in order; values are read as YAML.

    Raises:
        ConfigError: If the file is missing or no YAML, or a key or value is wrong; the text names file, key and value.
    """
    file = find_config(path)
    values = read_yaml(file)
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: must hold keys and values, got {type(values).__name__}")
    return parse_config(values, model, overrides, source=str(path))


def parse_config(
    values: dict[str, Any], model: type[ConfigT], overrides: Sequence[str] = (), *, source: str
) -> ConfigT:
    """Validate plain values; `source` is what errors call them. See `load_config`."""
    for override in overrides:
        values = _overridden(values, override)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise ConfigError(f"{source}: " + "; ".join(_explain(problem, model) for problem in error.errors())) from error


def save_config(config: BaseModel, path: Path, *, comment: str = "") -> None:
    """Write a resolved configuration as YAML that `load_config` reads back, under a one-line comment if given."""
    # Going through JSON, no two parts are the same object, for which YAML would write an alias.
    text = yaml.safe_dump(config.model_dump(mode="json", exclude_none=False), sort_keys=False)
    write_text(path, f"# {comment}\n{text}" if comment else text)


def find_config(path: Path | str) -> Path:
    """The path itself if it exists, else the shipped configuration of that name.

    Raises:
        ConfigError: If there is neither; the text lists what is shipped.
    """
    if Path(path).is_file():
        return Path(path)
    folder = _shipped_folder()
    name = str(path).removeprefix("configs/").removesuffix(".yaml")
    candidate = folder / f"{name}.yaml"
    if candidate.is_file():
        return candidate
    shipped = sorted(str(file.relative_to(folder).with_suffix("")) for file in folder.glob("*/*.yaml"))
    raise ConfigError(f"{path}: no such file, and no shipped configuration of that name; shipped: {', '.join(shipped)}")


def read_yaml(path: Path) -> Any:
    """Read one YAML document safely: ``8e-3`` is a number, ``off`` a word; a repeated key and an alias are errors.

    Raises:
        ConfigError: If the file cannot be read, is absurdly large, or is no YAML.
    """
    try:
        size = path.stat().st_size
        if size > _MAX_YAML_BYTES:
            raise ConfigError(f"{path}: has {size:,} bytes, more than the {_MAX_YAML_BYTES:,} that are read")
        return yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)  # noqa: S506  (a SafeLoader)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deeply") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not YAML: {' '.join(str(error).split())}") from error


class _Loader(yaml.SafeLoader):
    """YAML 1.2's idea of booleans and floats, which is what people mean."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        # A handful of aliases of aliases is a document of billions of values.
        if self.check_event(yaml.AliasEvent):
            raise yaml.composer.ComposerError(None, None, "an alias (*name) is not read; repeat the value itself")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} is repeated", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


_Loader.yaml_implicit_resolvers = {
    first: [
        (tag, pattern) for tag, pattern in resolvers if tag.rpartition(":")[2] not in ("bool", "float", "timestamp")
    ]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:(?:\d+\.\d*|\.\d+)(?:[eE][-+]?\d+)?|\d+[eE][-+]?\d+|\.inf|\.Inf|\.INF|\.nan|\.NaN|\.NAN)$"),
    list("-+0123456789."),
)


def _shipped_folder() -> Path:
    package = Path(__file__).resolve().parents[1]
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def _overridden(values: dict[str, Any], override: str) -> dict[str, Any]:
    key, equals, text = override.partition("=")
    if not equals or not key:
        raise ConfigError(f"override {override!r} must read key.sub=value")
    try:
        value = yaml.load(text, Loader=_Loader)  # noqa: S506  (a SafeLoader)
    except yaml.YAMLError as error:
        raise ConfigError(f"override {override!r}: the value is not YAML") from error
    root = dict(values)
    here = root
    *parents, last = key.split(".")
    for parent in parents:
        child = here.get(parent)
        here[parent] = dict(child) if isinstance(child, dict) else {}
        here = here[parent]
    here[last] = value
    return root


def _explain(problem: Any, model: type[BaseModel]) -> str:
    *parents, last = (str(part) for part in problem["loc"]) if problem["loc"] else ("",)
    where = f" in {'.'.join(parents)}" if parents else ""
    if problem["type"] == "extra_forbidden":
        close = difflib.get_close_matches(last, _fields_at(model, parents), n=1)
        return f"unknown key '{last}'{where}" + (f"; did you mean '{close[0]}'?" if close else "")
    if problem["type"] == "missing":
        return f"key '{last}'{where} is missing"
    message = str(problem["msg"]).removeprefix("Value error, ")
    return f"'{last}'{where}: {message}, got {_short(problem['input'])}" if last else message


def _fields_at(model: type[BaseModel], parents: Sequence[str]) -> list[str]:
    """Keys that are allowed below `parents`; none where no model describes them."""
    kinds: list[Any] = [model]
    for parent in parents:
        kinds = [inner for kind in kinds for inner in _kinds_below(kind, parent)]
    return [name for kind in kinds if _is_model(kind) for name in kind.model_fields]


def _kinds_below(kind: Any, key: str) -> list[Any]:
    """What may stand under `key`: a model's field, or the element of a ``dict[str, X]`` or ``tuple[X, ...]``."""
    if _is_model(kind):
        inner = [kind.model_fields[key].annotation] if key in kind.model_fields else []
    else:
        inner = [argument for argument in get_args(kind) if argument is not Ellipsis][-1:]
    return [choice for one in inner for choice in (get_args(one) if isinstance(one, UnionType) else (one,))]


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
