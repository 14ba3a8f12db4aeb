"""What a detector's class probabilities are worth, as measured on validation images."""

from dataclasses import asdict, dataclass
from typing import Any, Self

from autolights.core.errors import DataError
from autolights.core.hmm import Certainty


@dataclass(frozen=True)
class Calibration:
    """How to read a class vector, and what that was fitted on.

    Attributes:
        temperature: A class vector is raised to the power of 1 / temperature and normalised; 1 leaves it as it is.
        certainty: How sure the detector is, and how often, right or wrong.
        matched: Detections of labelled lights behind the fit.
        wrong: Of these, how many had another class than the label.
        nll: Mean negative log probability of the true class, before and after.
        expected_error: Expected calibration error (15 bins), before and after.
    """

    temperature: float
    certainty: Certainty
    matched: int
    wrong: int
    nll: tuple[float, float]
    expected_error: tuple[float, float]

    def to_json(self) -> dict[str, Any]:
        """As JSON-ready values."""
        pairs = {"nll": list(self.nll), "expected_error": list(self.expected_error)}
        return {**asdict(self), "certainty": self.certainty.to_json(), **pairs}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Read what `to_json` gave; raises `DataError` on anything else."""
        try:
            nll, expected_error = values["nll"], values["expected_error"]
            return cls(
                temperature=float(values["temperature"]),
                certainty=Certainty.from_json(values["certainty"]),
                matched=int(values["matched"]),
                wrong=int(values["wrong"]),
                nll=(float(nll[0]), float(nll[1])),
                expected_error=(float(expected_error[0]), float(expected_error[1])),
            )
        except KeyError as error:
            raise DataError(f"calibration: field {error} is missing") from error
        except (TypeError, ValueError, IndexError) as error:
            raise DataError(f"calibration: {error}") from error
