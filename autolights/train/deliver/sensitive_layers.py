"""Which layers of a network must stay in float: those that do most harm in 8 bits, as many as the accuracy asks for."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from autolights.core import Detections
from autolights.core.boxes import iou_matrix, match_boxes
from autolights.core.errors import AccuracyError
from autolights.core.progress import say, track
from autolights.train.measure.metrics import DetectionMetrics

# Above this share of multiplications in float there is no more to gain.
MAX_FLOAT_SHARE = 0.5
_SAME_LIGHT_IOU = 0.5


@dataclass(frozen=True)
class LayerChoice:
    """What stays in float, and why.

    Attributes:
        float_layers: Names, most harmful first.
        metrics: Of the model in which the others are in 8 bits.
        harm: Of each layer, if it alone is quantised: see `disagreement`; empty if all may be in 8 bits.
        steps: AP50 for each number of layers in float that was tried.
    """

    float_layers: tuple[str, ...]
    metrics: DetectionMetrics
    harm: dict[str, float] = field(default_factory=dict)
    steps: dict[int, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """For the model's description."""
        return {
            "float_layers": list(self.float_layers),
            "harm_of_layer": {name: round(harm, 5) for name, harm in self.harm.items()},
            "ap50_by_float_layers": {str(count): round(ap50, 5) for count, ap50 in self.steps.items()},
        }


def choose_float_layers(
    costs: Mapping[str, float],
    evaluate: Callable[[Collection[str]], DetectionMetrics],
    measure_harm: Callable[[str], float],
    *,
    float_ap50: float,
    max_drop: float,
) -> LayerChoice:
    """Find few layers without which the others may be in 8 bits.

    If the whole network loses more than half of `max_drop` in 8 bits, each layer's harm is measured by itself, and the
    worst are left in float: one, two, three, five, eight, ... until the loss is at most that half, so that the
    result does not sit on the edge. If that cannot be had, the fewest that keep `max_drop` are taken.

    Args:
        costs: Share of the network's multiplications of each layer.
        evaluate: Measures the model with the given layers in float, all others in 8 bits.
        measure_harm: Measures the model with the given layer in 8 bits, all others in float.
        float_ap50: AP50 of the float model on the same images.
        max_drop: Largest loss of AP50, in [0, 1].

    Raises:
        AccuracyError: If more than `max_drop` is lost even with half of the network in float.
    """
    metrics = evaluate(())
    steps = {0: metrics.ap50}
    chosen = LayerChoice((), metrics, steps=steps)
    if float_ap50 - metrics.ap50 <= max_drop / 2:
        return chosen
    say(f"in 8 bits throughout AP50 falls from {float_ap50:.3f} to {metrics.ap50:.3f}: looking for sensitive layers")
    harm = {name: measure_harm(name) for name in track(costs, description="layers", total=len(costs), unit="layers")}
    by_harm = sorted(costs, key=lambda name: -harm[name])
    count, following = 1, 2
    while sum(costs[name] for name in by_harm[:count]) <= MAX_FLOAT_SHARE:
        kept = tuple(by_harm[:count])
        metrics = evaluate(kept)
        steps[count] = metrics.ap50
        say(f"with {', '.join(kept)} in float: AP50 {metrics.ap50:.3f}")
        # Fewer layers in float win over a smaller loss once `max_drop` is kept, but not over half of it.
        if float_ap50 - metrics.ap50 <= max_drop / 2:
            return LayerChoice(kept, metrics, harm, steps)
        if float_ap50 - chosen.metrics.ap50 > max_drop:
            chosen = LayerChoice(kept, metrics, harm, steps)
        count, following = following, count + following
    if float_ap50 - chosen.metrics.ap50 > max_drop:
        best = max(steps, key=lambda tried: steps[tried])
        raise AccuracyError(
            f"in 8 bits AP50 falls from {float_ap50:.4f} to {steps[best]:.4f}, even with the {best} most sensitive of "
            f"{len(costs)} layers in float; allowed is a loss of {max_drop:g}. Calibrate on more images or by another "
            "method, or allow more; nothing was written"
        )
    return LayerChoice(chosen.float_layers, chosen.metrics, harm, steps)


def disagreement(wanted: Sequence[Detections], got: Sequence[Detections]) -> float:
    """How much two models differ in what they see, from 0 (the same) to 1 (nothing in common).

    A soft version of the Dice coefficient: lights of the same class count with their overlap and the lower of their
    scores, against the scores of all lights.

    Args:
        wanted: One entry per image.
        got: One entry per image.
    """
    common = total = 0.0
    for ours, theirs in zip(wanted, got, strict=True):
        a, b = match_boxes(ours.boxes_xyxy, theirs.boxes_xyxy, iou_threshold=_SAME_LIGHT_IOU)
        same = ours.class_ids[a] == theirs.class_ids[b]
        a, b = a[same], b[same]
        overlaps = iou_matrix(ours.boxes_xyxy, theirs.boxes_xyxy)[a, b]
        scores = [min(pair) for pair in zip(ours.scores[a], theirs.scores[b], strict=True)]
        common += float(sum(overlaps * scores))
        total += float(ours.scores.sum() + theirs.scores.sum())
    return 1 - 2 * common / total if total else 0.0
