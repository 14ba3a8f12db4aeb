"""Hand tuning of A, B and π, which the paper calls experimental tuning: a file that names what it changes."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from pydantic import Field

from autolights.core import Config, FloatArray, SignalSet, parse_config
from autolights.core.errors import ConfigError


class TypeOverrides(Config):
    """Hand tuning of one type; class names are the keys.

    Attributes:
        rates: From → to → transitions per second: replaces single ones of the signal description.
        observation: Truth → seen → probability: replaces whole rows; classes that are not named get 0.
        initial: Probability of each state at a track's birth; states that are not named get 0.
    """

    rates: dict[str, dict[str, float]] = Field(default_factory=dict)
    observation: dict[str, dict[str, float]] = Field(default_factory=dict)
    initial: dict[str, float] | None = None

    def tune_rates(self, rates: FloatArray, states: tuple[str, ...]) -> FloatArray:
        """(k, k) generator with the named transitions replaced; its rows sum to 0 again."""
        tuned = rates.copy()
        np.fill_diagonal(tuned, 0.0)
        for origin, row in self.rates.items():
            for target, rate in row.items():
                tuned[states.index(origin), states.index(target)] = rate
        return tuned - np.diag(tuned.sum(axis=1))

    def tune_observation(self, observation: FloatArray, states: tuple[str, ...]) -> FloatArray:
        """(k, k) B with the named rows replaced."""
        tuned = observation.copy()
        for name, row in self.observation.items():
            tuned[states.index(name)] = _vector(states, row)
        return tuned

    def tune_initial(self, initial: FloatArray, states: tuple[str, ...]) -> FloatArray:
        """(k,) π, replaced if it is given."""
        return initial if self.initial is None else _vector(states, self.initial)


class _Overrides(Config):
    types: dict[str, TypeOverrides]


def parse_overrides(overrides: Mapping[Any, Any], signals: SignalSet) -> dict[str, TypeOverrides]:
    """Check plain values, type → fields of `TypeOverrides`, against the signal description.

    Raises:
        ConfigError: If a type, a class or a field is unknown, a rate negative, or a row does not sum to 1.
    """
    by_type = {str(type_name): fields for type_name, fields in overrides.items()}  # YAML reads `4:` as a number
    tuned = parse_config({"types": by_type}, _Overrides, source="overrides").types
    for type_name, entry in tuned.items():
        if type_name not in signals.types:
            raise ConfigError(f"overrides: unknown type '{type_name}'; there are: {', '.join(signals.types)}")
        states = signals.states_of(type_name)
        for field, rows in (("rates", entry.rates), ("observation", entry.observation)):
            _refuse_unknown([*rows, *(name for row in rows.values() for name in row)], states, f"{type_name}.{field}")
        for name, row in entry.rates.items():
            if name in row or min(row.values(), default=0.0) < 0:
                raise ConfigError(
                    f"overrides: {type_name}.rates.{name} must hold rates of at least 0 to other states, got {row}"
                )
        for name, row in entry.observation.items():
            _check_distribution(row, f"{type_name}.observation.{name}")
        if entry.initial is not None:
            _refuse_unknown(entry.initial, states, f"{type_name}.initial")
            _check_distribution(entry.initial, f"{type_name}.initial")
    return tuned


def _vector(states: tuple[str, ...], values: dict[str, float]) -> FloatArray:
    return np.array([values.get(name, 0.0) for name in states])


def _refuse_unknown(names: Iterable[str], states: tuple[str, ...], where: str) -> None:
    unknown = sorted(set(names) - set(states))
    if unknown:
        raise ConfigError(f"overrides: unknown class '{unknown[0]}' in {where}; there are: {', '.join(states)}")


def _check_distribution(values: dict[str, float], where: str) -> None:
    total = sum(values.values())
    if min(values.values(), default=0.0) < 0 or not np.isclose(total, 1, atol=1e-6):
        raise ConfigError(f"overrides: {where} must hold probabilities that sum to 1, got {values}")
