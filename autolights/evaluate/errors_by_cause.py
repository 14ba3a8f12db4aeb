"""Where the errors are: each wrong row has one cause, the first that applies."""

from collections import Counter
from collections.abc import Sequence

from autolights.evaluate.outcomes import LightOutcome

AFTER_CHANGE_S = 0.5

CAUSES: dict[str, str] = {
    "occluded": "more than half of the light is hidden",
    "flashing": "the light flashes",
    "birth": "the light is new in view: nothing has been reported about it yet",
    "transition": f"the state changed less than {AFTER_CHANGE_S} s ago",
    "missed": "in plain view, not reported",
    "wrong class": "in plain view, reported as another state",
}


def causes(outcomes: Sequence[LightOutcome]) -> list[str | None]:
    """The cause of each row's error, None where the report is right; keys of `CAUSES`, the first that applies."""
    found: dict[int, str] = {}
    # Cameras together: a light that one camera has introduced is not new to the other.
    reported: set[tuple[str, str]] = set()
    last_class: dict[tuple[str, str], str] = {}
    changed_ns: dict[tuple[str, str], int] = {}
    order = sorted(range(len(outcomes)), key=lambda i: outcomes[i].stamp_ns)
    for i in order:
        row = outcomes[i]
        light = (row.drive, row.truth.truth_id)
        if last_class.get(light, row.truth.class_name) != row.truth.class_name:
            changed_ns[light] = row.stamp_ns
        last_class[light] = row.truth.class_name
        if row.reported_class is not None:
            reported.add(light)
        if row.correct:
            continue
        since_change_s = (row.stamp_ns - changed_ns[light]) / 1e9 if light in changed_ns else float("inf")
        if not row.visible:
            found[i] = "occluded"
        elif row.truth.flashing:
            found[i] = "flashing"
        elif light not in reported:
            found[i] = "birth"
        elif since_change_s < AFTER_CHANGE_S:
            found[i] = "transition"
        else:
            found[i] = "missed" if row.reported_class is None else "wrong class"
    return [found.get(i) for i in range(len(outcomes))]


def count_causes(outcomes: Sequence[LightOutcome]) -> dict[str, int]:
    """Number of errors of each cause, in the order of `CAUSES`."""
    counts = Counter(causes(outcomes))
    return {name: counts[name] for name in CAUSES}
