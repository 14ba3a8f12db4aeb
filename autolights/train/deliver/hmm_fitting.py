"""From a detector's confusion matrix to the hidden Markov models that know its errors.

Per type of light: the signal description gives the rates Q, and with them A = expm(Q Δt) and π; the confusion matrix
gives the observation matrix B and, with a prior over states, the evidence matrix C.

References:
    Wu et al. 2023, Sec. III-D. The paper normalises the columns of the confusion matrix; that mixes the data set's
    class balance into C, so here it is an option (`prior="empirical"`) and a uniform prior the default.
"""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import scipy.linalg

from autolights.core import Certainty, ConfusionMatrix, FloatArray, HmmParameters, SignalSet
from autolights.core.errors import UsageError
from autolights.train.deliver.hmm_overrides import TypeOverrides, parse_overrides

Prior = Literal["uniform", "empirical"]


def fit_hmm(
    confusion: ConfusionMatrix,
    signals: SignalSet,
    *,
    nominal_dt_s: float = 0.1,
    pseudocount: float = 1.0,
    prior: Prior = "uniform",
    overrides: Mapping[str, Any] | None = None,
) -> dict[str, HmmParameters]:
    """Fit one HMM per type of light.

    Of each type the block of its own classes is used; what was taken for another type, or for background, says how
    often a state is missed. The matrix must come from images that neither trained the detector nor test the pipeline.

    Args:
        confusion: Counts with background.
        signals: Its classes are those of the matrix.
        nominal_dt_s: Frame time for which A is written down.
        pseudocount: Added to each cell of a block, and to "missed" and "detected".
        prior: Over states, behind C: uniform, or the share of each state in the counts.
        overrides: Type → fields of `TypeOverrides`, as read from a YAML file.

    Returns:
        Type → parameters.

    Raises:
        UsageError: If the classes differ, or a state was never seen and there is no pseudocount.
        ConfigError: If an override names what does not exist or is no probability.
    """
    if confusion.classes != signals.classes:
        raise UsageError(
            f"the confusion matrix knows the classes {list(confusion.classes)}, "
            f"the signal description '{signals.name}' {list(signals.classes)}"
        )
    tuned = parse_overrides(overrides or {}, signals)
    return {
        type_name: _fit_type(
            type_name, confusion, signals, nominal_dt_s, pseudocount, prior, tuned.get(type_name, TypeOverrides())
        )
        for type_name in signals.types
    }


def _fit_type(
    type_name: str,
    confusion: ConfusionMatrix,
    signals: SignalSet,
    nominal_dt_s: float,
    pseudocount: float,
    prior: Prior,
    tuned: TypeOverrides,
) -> HmmParameters:
    states = signals.states_of(type_name)
    ids = [signals.class_ids[name] for name in states]
    counts = confusion.counts[np.ix_(ids, ids)]
    seen = counts.sum(axis=1)
    missed = confusion.counts[ids].sum(axis=1) - seen

    smoothed = counts + pseudocount
    if not smoothed.sum(axis=1).all():
        absent = states[int(np.argmin(smoothed.sum(axis=1)))]
        raise UsageError(
            f"'{absent}' was never detected as type '{type_name}', so nothing is known about it; "
            "use a pseudocount above 0 or a larger validation set"
        )
    observation = tuned.tune_observation(_normalise_rows(smoothed), states)
    state_prior = np.ones(len(states)) if prior == "uniform" else smoothed.sum(axis=1)
    rates = tuned.tune_rates(signals.rates(type_name), states)
    calibration = confusion.calibration
    return HmmParameters(
        type=type_name,
        states=states,
        initial=tuned.tune_initial(stationary_distribution(rates), states),
        rates=rates,
        nominal_dt_s=nominal_dt_s,
        transition=_normalise_rows(scipy.linalg.expm(rates * nominal_dt_s).clip(min=0)),
        observation=observation,
        evidence=_evidence(observation, state_prior),
        miss_probs=(missed + pseudocount) / (missed + seen + 2 * pseudocount),
        counts=counts.astype(np.float64),
        provenance={
            "signals": signals.name,
            "prior": prior,
            "pseudocount": pseudocount,
            "missed_counts": missed.tolist(),
            "score_threshold": confusion.score_threshold,
            "iou_threshold": confusion.iou_threshold,
            "calibration": None if calibration is None else calibration.to_json(),
            **({"counted_with": confusion.counted_with.to_json()} if confusion.counted_with else {}),
            "overrides": tuned.model_dump(mode="json", exclude_defaults=True),
        },
        temperature=1.0 if calibration is None else calibration.temperature,
        certainty=Certainty() if calibration is None else calibration.certainty,
    )


def stationary_distribution(rates: FloatArray) -> FloatArray:
    """The (k,) distribution that a (k, k) generator leaves as it is: π Q = 0, sum 1.

    Of several such distributions the one of smallest norm is returned.
    """
    k = len(rates)
    equations = np.vstack([rates.T, np.ones((1, k))])
    solution = np.linalg.lstsq(equations, np.append(np.zeros(k), 1.0), rcond=None)[0].clip(min=0)
    return np.asarray(solution / solution.sum())


def _evidence(observation: FloatArray, state_prior: FloatArray) -> FloatArray:
    """Bayes: C[j, k] = P(q = j | o = k) ∝ P(o = k | q = j) P(q = j). What no state ever looks like says nothing."""
    joint = state_prior[:, None] * observation
    never = joint.sum(axis=0) == 0
    joint = np.where(never, state_prior[:, None], joint)
    return np.asarray(joint / joint.sum(axis=0))


def _normalise_rows(matrix: FloatArray) -> FloatArray:
    return np.asarray(matrix / matrix.sum(axis=1, keepdims=True))
