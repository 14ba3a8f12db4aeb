"""How a detector errs on a drive: rates, how long errors last, how they correlate: of a real one and of the model."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from autolights.core import FloatArray
from autolights.core.arrays import BoolArray
from autolights.evaluate.in_view import lights_in_view
from autolights.evaluate.outcomes import OCCLUDED_ABOVE
from autolights.suite.drives import SuiteDrive

_BANDS_PX = ((8.0, 16.0), (16.0, 32.0), (32.0, 64.0), (64.0, 1e9))
_SAME_SET_NS = 20_000_000


@dataclass(frozen=True, eq=False)
class DetectorErrors:
    """Figures of visible lights in view.

    Attributes:
        seen: Lights that were detected, over all camera frames.
        class_error: Share of these that got a wrong class (the lit one is right).
        missed: Height band → share of the lights that were not detected.
        error_s: Mean length of a run of class errors, seconds.
        miss_s: Mean length of a run of misses.
        error_correlation: Of class errors between two cameras that both detect the light; NaN without such lights.
        miss_correlation: Of misses between two cameras.
        edge_px: Standard deviation of the boxes' edges.
        edge_share: The same in heights of the box.
        right_scores: 10th, 50th and 90th percentile of the scores of right detections.
        wrong_scores: The same of those with a wrong class.
    """

    seen: int
    class_error: float
    missed: dict[str, float]
    error_s: float
    miss_s: float
    error_correlation: float
    miss_correlation: float
    edge_px: float
    edge_share: float
    right_scores: tuple[float, ...]
    wrong_scores: tuple[float, ...]


@dataclass(frozen=True)
class _Look:
    """One light in one camera frame."""

    stamp_ns: int
    height_px: float
    found: bool
    wrong: bool
    score: float
    edge_px: float


def detector_errors(drives: Iterable[SuiteDrive], *, min_score: float = 0.25) -> DetectorErrors:
    """Count a detector's errors over drives; detections below `min_score` are none."""
    looks: dict[tuple[str, str, str], list[_Look]] = defaultdict(list)
    for drive in drives:
        _collect(drive, min_score, looks)
    every = [look for of_light in looks.values() for look in of_light]
    found = [look for look in every if look.found]
    wrong = np.array([look.wrong for look in found])
    scores = np.array([look.score for look in found])
    edges = np.array([look.edge_px for look in found])
    heights = np.array([look.height_px for look in found])
    return DetectorErrors(
        seen=len(found),
        class_error=float(wrong.mean()) if len(wrong) else float("nan"),
        missed={
            f"{low:.0f}-{high:.0f} px" if high < 1e9 else f"{low:.0f} px and more": _share(
                [not look.found for look in every if low <= look.height_px < high]
            )
            for low, high in _BANDS_PX
        },
        error_s=_mean_run_s([[(look.stamp_ns, look.wrong) for look in of if look.found] for of in looks.values()]),
        miss_s=_mean_run_s([[(look.stamp_ns, not look.found) for look in of] for of in looks.values()]),
        error_correlation=_correlation([(a.wrong, b.wrong) for a, b in _pairs(looks) if a.found and b.found]),
        miss_correlation=_correlation([(not a.found, not b.found) for a, b in _pairs(looks)]),
        edge_px=float(np.sqrt(np.mean(edges**2))) if len(edges) else float("nan"),
        edge_share=float(np.sqrt(np.mean((edges / heights) ** 2))) if len(edges) else float("nan"),
        right_scores=_deciles(scores[~wrong]) if len(wrong) else (),
        wrong_scores=_deciles(scores[wrong]) if len(wrong) else (),
    )


def _collect(drive: SuiteDrive, min_score: float, looks: dict[tuple[str, str, str], list[_Look]]) -> None:
    poses = drive.true_drive.pose_buffer()
    for (camera, stamp_ns), frame in sorted(drive.truth.items(), key=lambda item: item[0][1]):
        found = drive.detections[camera, stamp_ns]
        rows = {
            source: row
            for row, source in enumerate(drive.sources[camera, stamp_ns])
            if source is not None and found.scores[row] >= min_score
        }
        class_ids = found.class_ids
        for light in lights_in_view(frame.lights, drive.true_drive.cameras[camera], poses.at(stamp_ns)):
            if light.occlusion > OCCLUDED_ABOVE:
                continue
            row = rows.get(light.truth_id)
            box = np.array(light.box_xyxy)
            off = 0.0 if row is None else float(np.sqrt(np.mean((found.boxes_xyxy[row] - box) ** 2)))
            seen_as = "" if row is None else drive.signals.classes[int(class_ids[row])]
            looks[drive.name, camera, light.truth_id].append(
                _Look(
                    stamp_ns=stamp_ns,
                    height_px=float(box[3] - box[1]),
                    found=row is not None,
                    wrong=row is not None and seen_as != light.lit_class,
                    score=0.0 if row is None else float(found.scores[row]),
                    edge_px=off,
                )
            )


def _pairs(looks: dict[tuple[str, str, str], list[_Look]]) -> list[tuple[_Look, _Look]]:
    """Looks of two cameras at one light within one set."""
    pairs = []
    cameras = sorted({camera for _, camera, _ in looks})
    for (drive, camera, light), of_first in looks.items():
        for other in cameras[cameras.index(camera) + 1 :]:
            of_second = looks.get((drive, other, light), [])
            stamps = np.array([look.stamp_ns for look in of_second])
            for look in of_first:
                near = np.flatnonzero(np.abs(stamps - look.stamp_ns) < _SAME_SET_NS)
                pairs += [(look, of_second[i]) for i in near[:1].tolist()]
    return pairs


def _mean_run_s(timelines: Iterable[Sequence[tuple[int, bool]]]) -> float:
    """Mean length of the runs of True that begin and end in view, from its first stamp to the first after it."""
    lengths = []
    for timeline in timelines:
        start = 0
        for value, group in groupby(flag for _, flag in timeline):
            end = start + sum(1 for _ in group)
            if value and start > 0 and end < len(timeline):
                lengths.append((timeline[end][0] - timeline[start][0]) / 1e9)
            start = end
    return float(np.mean(lengths)) if lengths else float("nan")


def _correlation(pairs: Sequence[tuple[bool, bool]]) -> float:
    values: BoolArray = np.array(pairs, dtype=bool).reshape(-1, 2)
    if not len(values) or (values == values[0]).all(axis=0).any():
        return float("nan")  # nothing varies
    first, second = values.astype(np.float64).T
    return float(np.mean((first - first.mean()) * (second - second.mean())) / (first.std() * second.std()))


def _share(flags: Sequence[bool]) -> float:
    return float(np.mean(flags)) if flags else float("nan")


def _deciles(values: FloatArray) -> tuple[float, ...]:
    return tuple(np.percentile(values, [10, 50, 90]).round(2).tolist()) if len(values) else ()
