"""The hidden Markov model of one type of light: parameters, checks and files. The filter itself is in `track`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from autolights.core.arrays import FloatArray, as_float_array
from autolights.core.errors import DataError
from autolights.core.json_files import read_json_object, write_json

_ARRAYS = ("initial", "rates", "transition", "observation", "evidence", "miss_probs", "counts")


@dataclass(frozen=True)
class Certainty:
    """What a detector's confidence is worth: levels of it, and how often each occurs where it is right and wrong.

    Attributes:
        thresholds: (L − 1) ascending: the share of the calibrated class vector that the best class must have for the
            second, third, … level.
        if_right: (L) P(level | it sees the true class), from the least sure to the surest.
        if_wrong: (L) P(level | it sees another class). Equal to the former, being sure says nothing.
        second_if_wrong: P(the true class comes second | it sees another class); 0 where nobody counted.

    Raises:
        ValueError: If the levels do not fit together, or the probabilities are none.
    """

    thresholds: tuple[float, ...] = ()
    if_right: tuple[float, ...] = (1.0,)
    if_wrong: tuple[float, ...] = (1.0,)
    second_if_wrong: float = 0.0

    def __post_init__(self) -> None:
        if list(self.thresholds) != sorted(set(self.thresholds)) or not all(0 < t < 1 for t in self.thresholds):
            raise ValueError(f"certainty.thresholds must ascend within (0, 1), got {list(self.thresholds)}")
        for name in ("if_right", "if_wrong"):
            probs = getattr(self, name)
            if len(probs) != self.levels or not all(0 <= p <= 1 for p in probs) or abs(sum(probs) - 1) > 1e-3:
                raise ValueError(
                    f"certainty.{name} must hold {self.levels} probabilities that sum to 1, one more than thresholds, "
                    f"got {list(probs)}"
                )
        if not 0 <= self.second_if_wrong <= 1:
            raise ValueError(f"certainty.second_if_wrong must lie in [0, 1], got {self.second_if_wrong}")

    @property
    def levels(self) -> int:
        """How many levels are told apart."""
        return len(self.thresholds) + 1

    def to_json(self) -> dict[str, Any]:
        """As JSON-ready values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in vars(self).items()}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Read what `to_json` gave, or the two levels ("sure" or not) that older files hold.

        Raises:
            KeyError, TypeError, ValueError: If it is anything else.
        """
        if "threshold" in values:
            right, wrong = float(values["sure_if_right"]), float(values["sure_if_wrong"])
            return cls((float(values["threshold"]),), (1 - right, right), (1 - wrong, wrong))
        columns = {name: tuple(float(v) for v in values[name]) for name in ("thresholds", "if_right", "if_wrong")}
        return cls(**columns, second_if_wrong=float(values.get("second_if_wrong", 0.0)))


@dataclass(frozen=True, eq=False)
class HmmParameters:
    """λ = {A, B, π} of one type (Wu et al. 2023, Sec. III-D), with Q behind A and C derived from B.

    Attributes:
        type: The type of light, e.g. ``"4"``.
        states: k class names; hidden and observed states are the same.
        initial: (k,) π.
        rates: (k, k) generator Q per second: rows sum to 0, off-diagonal entries are not negative; A(Δt) = expm(Q Δt).
        nominal_dt_s: The frame time for which `transition` is given.
        transition: (k, k) A at `nominal_dt_s`: `[i, j]` = P(q_t = j | q_{t-1} = i), rows sum to 1.
        observation: (k, k) B: `[i, j]` = P(o = j | q = i), rows sum to 1.
        evidence: (k, k) C: `[j, k]` = P(q = j | o = k), columns sum to 1.
        miss_probs: (k,) P(no detection of this type | state).
        counts: (k, k) the block of the confusion matrix behind B, pseudocount not included.
        provenance: Where the numbers come from: prior, pseudocount, score threshold, calibration, hand tuning.
        temperature: A class vector is raised to the power of 1 / temperature before C, so that x means what it says.
        certainty: When it is sure, and what that is worth.

    Raises:
        ValueError: If a shape or a sum is wrong.
    """

    type: str
    states: tuple[str, ...]
    initial: FloatArray
    rates: FloatArray
    nominal_dt_s: float
    transition: FloatArray
    observation: FloatArray
    evidence: FloatArray
    miss_probs: FloatArray
    counts: FloatArray
    provenance: dict[str, Any]
    temperature: float = 1.0
    certainty: Certainty = Certainty()

    def __post_init__(self) -> None:
        k = len(self.states)
        for name in _ARRAYS:
            shape = (k,) if name in ("initial", "miss_probs") else (k, k)
            array = as_float_array(getattr(self, name), shape, f"{name}['{self.type}']")
            object.__setattr__(self, name, array)
            if name != "rates" and (array < 0).any():
                raise ValueError(f"{name}['{self.type}'] must not be negative, got {array.min()}")
        _check_sums(self.initial[None], 1, f"initial['{self.type}']")
        _check_sums(self.rates, 0, f"rates['{self.type}'] rows")
        _check_sums(self.transition, 1, f"transition['{self.type}'] rows")
        _check_sums(self.observation, 1, f"observation['{self.type}'] rows")
        _check_sums(self.evidence.T, 1, f"evidence['{self.type}'] columns")
        off_diagonal = self.rates - np.diag(np.diag(self.rates))
        if (off_diagonal < 0).any():
            raise ValueError(f"rates['{self.type}'] must not be negative off the diagonal, got {off_diagonal.min()}")
        if (self.miss_probs > 1).any():
            raise ValueError(f"miss_probs['{self.type}'] must lie in [0, 1], got {self.miss_probs.max()}")
        if not self.nominal_dt_s > 0:
            raise ValueError(f"nominal_dt_s['{self.type}'] must be positive, got {self.nominal_dt_s}")
        if not 0 < self.temperature < np.inf:
            raise ValueError(f"temperature['{self.type}'] must be positive and finite, got {self.temperature}")

    def to_json(self) -> dict[str, Any]:
        """The parameters as JSON-ready values."""
        arrays = {name: getattr(self, name).tolist() for name in _ARRAYS}
        rest = {"type": self.type, "states": list(self.states), "nominal_dt_s": self.nominal_dt_s}
        confidence = {"temperature": self.temperature, "certainty": self.certainty.to_json()}
        return {**rest, **arrays, **confidence, "provenance": self.provenance}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Read what `to_json` gave; raises `DataError` on anything else."""
        try:
            arrays = {name: np.asarray(values[name], dtype=np.float64) for name in _ARRAYS}
            return cls(
                type=str(values["type"]),
                states=tuple(values["states"]),
                nominal_dt_s=float(values["nominal_dt_s"]),
                provenance=dict(values["provenance"]),
                temperature=float(values["temperature"]),
                certainty=Certainty.from_json(values["certainty"]),
                **arrays,
            )
        except KeyError as error:
            raise DataError(f"HMM parameters: field {error} is missing") from error
        except (TypeError, ValueError) as error:
            raise DataError(f"HMM parameters: {error}") from error


def save_hmm(path: Path, hmm: dict[str, HmmParameters]) -> None:
    """Write one HMM per type as JSON."""
    write_json(path, {name: parameters.to_json() for name, parameters in hmm.items()})


def load_hmm(path: Path) -> dict[str, HmmParameters]:
    """Read what `save_hmm` wrote.

    Raises:
        DataError: If the file is missing, is no JSON, or a matrix is not stochastic; the text names file and type.
    """
    values = read_json_object(path)
    try:
        return {str(name): HmmParameters.from_json(entry) for name, entry in values.items()}
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def _check_sums(rows: FloatArray, total: float, name: str) -> None:
    sums = rows.sum(axis=1)
    if not np.allclose(sums, total, atol=1e-6):
        raise ValueError(f"{name} must sum to {total}, got {np.round(sums, 6).tolist()}")
