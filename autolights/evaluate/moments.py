"""Moments in which tracking saves the day: frames where the proposed pipeline is right and detection alone is not."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from autolights.core import FloatArray, LightEstimate, SignalSet
from autolights.core.estimates import Variant
from autolights.core.light_box import light_corners, project_corners
from autolights.core.transforms import invert_rigid
from autolights.data import EstimateSet
from autolights.evaluate.errors_by_cause import causes
from autolights.evaluate.outcomes import LightOutcome, RunOutcomes

APART_S = 2.0
ASPECT = 16 / 9
MIN_CROP_WIDTH_PX = 200.0
_SHOWN_BEFORE = 0.75  # what is taken off the worth of a light and cause that an earlier moment showed


@dataclass(frozen=True)
class Mark:
    """A box to draw, in pixels of the original image.

    Attributes:
        box_xyxy: Left, top, right, bottom.
        class_name: What is reported; None for a light that is not reported.
        label: What to write beside it.
        right: Whether it is what the truth says; None where no labelled light belongs to it.
    """

    box_xyxy: tuple[float, float, float, float]
    class_name: str | None
    label: str
    right: bool | None


@dataclass(frozen=True, eq=False)
class Moment:
    """One camera frame, cropped around the lights that matter, with what two variants say.

    Attributes:
        run: The run that it is from.
        camera: Of the frame.
        stamp_ns: Of the frame.
        crop_xyxy: Part of the image to show, whole pixels.
        od: Marks of detection alone.
        proposed: Marks of the proposed pipeline.
        causes: Why detection alone is wrong, one for each light that is rescued.
        rescued: Truth ids of these lights.
    """

    run: RunOutcomes
    camera: str
    stamp_ns: int
    crop_xyxy: tuple[int, int, int, int]
    od: tuple[Mark, ...]
    proposed: tuple[Mark, ...]
    causes: tuple[str, ...]
    rescued: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Candidate:
    run: RunOutcomes
    frame: tuple[str, int]
    od: dict[str, LightOutcome]
    proposed: dict[str, LightOutcome]
    cause: dict[str, str]  # of the rescued lights, by truth id
    harmed: int


def saved_moments(runs: Iterable[RunOutcomes], signals: SignalSet, count: int = 4) -> list[Moment]:
    """Choose frames in which tracking helps on the most lights, from different episodes.

    Frames of one drive lie at least two seconds apart, and a light that is rescued again for the same reason is worth
    a quarter.
    """
    candidates = [candidate for run in runs for candidate in _candidates(run)]
    chosen: list[_Candidate] = []
    shown: set[tuple[str, str, str]] = set()
    while candidates and len(chosen) < count:
        best = max(candidates, key=lambda candidate: _worth(candidate, shown))
        if _worth(best, shown)[0] <= 0:
            break
        chosen.append(best)
        shown |= {(best.run.drive.name, light, cause) for light, cause in best.cause.items()}
        candidates = [c for c in candidates if not _same_episode(c, best)]
    return [_moment(candidate, signals) for candidate in chosen]


def _candidates(run: RunOutcomes) -> Iterator[_Candidate]:
    if "od" not in run.variants or "full" not in run.variants:
        return
    od_rows = run.variants["od"].outcomes
    why = dict(zip(map(id, od_rows), causes(od_rows), strict=True))
    od, proposed = _by_frame(od_rows), _by_frame(run.variants["full"].outcomes)
    for frame, od_lights in od.items():
        full_lights = proposed[frame]
        cause = {
            light: why[id(row)] or ""
            for light, row in od_lights.items()
            if full_lights[light].correct and not row.correct
        }
        harmed = sum(row.correct and not full_lights[light].correct for light, row in od_lights.items())
        if cause:
            yield _Candidate(run, frame, od_lights, full_lights, cause, harmed)


def _by_frame(rows: Iterable[LightOutcome]) -> dict[tuple[str, int], dict[str, LightOutcome]]:
    frames: dict[tuple[str, int], dict[str, LightOutcome]] = {}
    for row in rows:
        frames.setdefault((row.camera, row.stamp_ns), {})[row.truth.truth_id] = row
    return frames


def _worth(candidate: _Candidate, shown: set[tuple[str, str, str]]) -> tuple[float, float]:
    """Lights rescued less lights harmed; of equals the frame in which they are largest."""
    repeated = sum((candidate.run.drive.name, light, cause) in shown for light, cause in candidate.cause.items())
    worth = len(candidate.cause) - _SHOWN_BEFORE * repeated - candidate.harmed
    heights = [_height(candidate.od[light]) for light in candidate.cause]
    return (worth, sum(heights) / len(heights)) if worth > 0 else (0.0, 0.0)


def _height(row: LightOutcome) -> float:
    return row.truth.box_xyxy[3] - row.truth.box_xyxy[1]


def _same_episode(a: _Candidate, b: _Candidate) -> bool:
    return a.run is b.run and abs(a.frame[1] - b.frame[1]) < APART_S * 1e9


def _moment(candidate: _Candidate, signals: SignalSet) -> Moment:
    camera, stamp_ns = candidate.frame
    size_wh = candidate.run.drive.cameras[camera].size_wh
    boxes = np.array([candidate.od[light].truth.box_xyxy for light in candidate.cause])
    return Moment(
        run=candidate.run,
        camera=camera,
        stamp_ns=stamp_ns,
        crop_xyxy=_crop(boxes, size_wh),
        od=_marks(candidate, "od", candidate.od, signals),
        proposed=_marks(candidate, "full", candidate.proposed, signals),
        causes=tuple(candidate.cause.values()),
        rescued=tuple(candidate.cause),
    )


def _crop(boxes: FloatArray, size_wh: tuple[int, int]) -> tuple[int, int, int, int]:
    """A window of fixed shape around the boxes, with air for labels, inside the image."""
    width, height = size_wh
    tallest = float((boxes[:, 3] - boxes[:, 1]).max())
    spread_w, spread_h = boxes[:, 2].max() - boxes[:, 0].min(), boxes[:, 3].max() - boxes[:, 1].min()
    crop_w = max(spread_w + 4 * tallest, ASPECT * (spread_h + 2 * tallest), MIN_CROP_WIDTH_PX)
    crop_w = min(crop_w, width, ASPECT * height)
    crop_h = crop_w / ASPECT
    centre_x, centre_y = (boxes[:, 0].min() + boxes[:, 2].max()) / 2, (boxes[:, 1].min() + boxes[:, 3].max()) / 2
    left = float(np.clip(centre_x - crop_w / 2, 0, width - crop_w))
    top = float(np.clip(centre_y - crop_h / 2, 0, height - crop_h))
    return int(left), int(top), int(left + crop_w), int(top + crop_h)


def _marks(
    candidate: _Candidate, variant: Variant, rows: dict[str, LightOutcome], signals: SignalSet
) -> tuple[Mark, ...]:
    """One mark for each labelled light, reported or missed, and one for each other report in this frame."""
    marks = []
    for row in rows.values():
        if row.reported_class is None or row.estimate is None:
            marks.append(Mark(row.truth.box_xyxy, None, "withheld" if row.withheld else "missed", False))
        else:
            box = estimate_box(row.estimate, candidate.run, candidate.frame, signals) or row.truth.box_xyxy
            marks.append(Mark(box, row.reported_class, _label(row.estimate, variant), row.correct))
    matched = {id(row.estimate) for row in rows.values() if row.estimate is not None}
    for estimate in estimates_in(candidate.run.estimates, variant, candidate.frame):
        own_box = _seen_box(estimate, candidate.frame)
        if id(estimate) not in matched and not estimate.withheld and own_box is not None:
            marks.append(Mark(own_box, estimate.class_name, _label(estimate, variant), None))
    return tuple(marks)


def _label(estimate: LightEstimate, variant: Variant) -> str:
    name = f"#{estimate.track_id} {estimate.class_name}" if variant == "full" else estimate.class_name
    return f"{name} flashing" if estimate.flashing else name


def estimates_in(sets: Sequence[EstimateSet], variant: Variant, frame: tuple[str, int]) -> tuple[LightEstimate, ...]:
    """What a variant said about the set that holds this (camera, stamp_ns)."""
    for entry in sets:
        if entry.variant == variant and frame in entry.frames:
            return entry.lights
    return ()


def estimate_box(
    estimate: LightEstimate, run: RunOutcomes, frame: tuple[str, int], signals: SignalSet
) -> tuple[float, float, float, float] | None:
    """Where to draw a report in an image: its detection's box, else its position as the camera sees it.

    A light that the map does not hold is taken to face the vehicle. None if it is not in front of the camera.
    """
    own_box = _seen_box(estimate, frame)
    if own_box is not None:
        return own_box
    camera = run.drive.cameras[frame[0]]
    pose = run.poses.at(frame[1])
    lights = run.drive.lights
    if estimate.map_id in lights.ids:
        heading_deg = float(lights.headings_deg[lights.ids.index(estimate.map_id)])
    else:
        east, north, _ = pose.position - estimate.position
        heading_deg = float(np.degrees(np.arctan2(east, north)))
    corners = light_corners(estimate.position[None], np.array([heading_deg]), signals.sizes_m([estimate.type]))
    cam_from_utm = camera.cam_from_ins @ invert_rigid(pose.utm_from_ins)
    left, top, right, bottom = project_corners(corners, camera, cam_from_utm)[0].tolist()
    return None if np.isnan(left) else (left, top, right, bottom)


def _seen_box(estimate: LightEstimate, frame: tuple[str, int]) -> tuple[float, float, float, float] | None:
    for view in estimate.views:
        if (view.camera, view.stamp_ns) == frame:
            return view.box_xyxy
    return None
