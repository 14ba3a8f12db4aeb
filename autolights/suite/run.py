"""Pipelines over the drives of a scenario: estimates in memory, the time of each step, and what pairs with what."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from autolights.core import Detections, HmmParameters, ImageArray, LightEstimate, SignalSet
from autolights.core.calibration import Calibration
from autolights.data import EstimateSet
from autolights.evaluate.outcomes import RunOutcomes, hold_against_truth
from autolights.pipeline import LightPipeline, PipelineConfig
from autolights.sim.detector_model import DetectorModel, LightViews, expected_confusion
from autolights.suite.config import SuiteConfig
from autolights.suite.drives import SuiteDrive, known_rates
from autolights.track import associate, association_cost, project_lights
from autolights.train.deliver.hmm_fitting import fit_hmm
from autolights.train.measure.calibration import fit_calibration

_VALIDATION = 7  # its own stream of random numbers


@dataclass(frozen=True, eq=False)
class Pairing:
    """How often a detection was held for the light that it is.

    Attributes:
        right: Detections of a light, held for that very light.
        wrong: Detections that were held for another light than theirs, look-alikes included.
    """

    right: int = 0
    wrong: int = 0

    def __add__(self, other: "Pairing") -> "Pairing":
        return Pairing(self.right + other.right, self.wrong + other.wrong)

    @property
    def total(self) -> int:
        """Both."""
        return self.right + self.wrong


@dataclass(frozen=True, eq=False)
class DriveRun:
    """One pipeline over one drive.

    Attributes:
        drive: The drive.
        outcomes: Held against the truth; of one variant.
        step_ms: Time of each set, detection left out.
        pairing: Of the detections that the reports name.
        plain_pairing: What a plain association would make of the drive.
        skipped: Frames that the pipeline left out, by reason.
    """

    drive: SuiteDrive
    outcomes: RunOutcomes
    step_ms: tuple[float, ...]
    pairing: Pairing
    plain_pairing: Pairing
    skipped: Mapping[str, int]


class _NoDetector:
    """The detections are there already."""

    def batch(self, images_bgr: Sequence[ImageArray]) -> list[Detections]:
        raise AssertionError("the suite hands detections over itself")


def suite_hmm(suite: SuiteConfig, signals: SignalSet) -> dict[str, HmmParameters]:
    """The HMMs that a runtime gets: fitted on the validation set's confusion and confidence, not on the road's."""
    confusion = expected_confusion(
        known_rates(suite, signals),
        signals,
        per_class=suite.confusion_lights,
        miss_rate=suite.confusion_miss_rate,
        score_threshold=0.25,
    )
    confusion = replace(confusion, calibration=_validation_calibration(suite, signals))
    return fit_hmm(confusion, signals, pseudocount=suite.pseudocount)


def _validation_calibration(suite: SuiteConfig, signals: SignalSet) -> Calibration | None:
    """What the detector's confidence is worth on validation images: `confusion_lights` of each class, once each."""
    truth_ids = np.repeat(np.arange(len(signals.classes)), suite.confusion_lights)
    rates, seed = known_rates(suite, signals), (suite.seed, _VALIDATION)
    model = DetectorModel(signals, rates, suite.detector, count=len(truth_ids), duration_s=0.0, seed=seed)
    views = LightViews(
        times_s=np.zeros(1),
        size_wh=(1280, 800),
        boxes_xyxy=np.broadcast_to([600.0, 300.0, 620.0, 360.0], (1, len(truth_ids), 4)),
        class_ids=truth_ids[None],
        hidden=np.zeros((1, len(truth_ids))),
        is_light=np.ones(len(truth_ids), dtype=bool),
    )
    (frame,) = model.detect(views, camera=0)
    real = frame.sources >= 0
    return fit_calibration(frame.detections.class_probs[real], truth_ids[frame.sources[real]])


def run_pipelines(
    drive: SuiteDrive, hmm: Mapping[str, HmmParameters], configs: Mapping[str, PipelineConfig]
) -> dict[str, DriveRun]:
    """Let several pipelines say something to each set of frames, in the order of their arrival.

    They take turns on each set, so that whatever else the machine does slows all of them.
    """
    given, names = drive.drive, _map_names(drive)
    pipelines = {
        label: LightPipeline(
            _NoDetector(), hmm, drive.signals, given.cameras, given.lights, config, poses=given.pose_buffer()
        )
        for label, config in configs.items()
    }
    sets: dict[str, list[EstimateSet]] = {label: [] for label in configs}
    step_ms: dict[str, list[float]] = {label: [] for label in configs}
    pairing = dict.fromkeys(configs, Pairing())
    for frames in drive.sets:
        keys = tuple((frame.camera, frame.stamp_ns) for frame in frames)
        found = [drive.detections[key] for key in keys]
        sources = _sources_by_box(drive, keys)
        for label, pipeline in pipelines.items():
            start_ns = time.perf_counter_ns()
            lights = pipeline.step_detections(frames, found)
            step_ms[label].append((time.perf_counter_ns() - start_ns) / 1e6)
            variant = configs[label].variant
            sets[label].append(EstimateSet(max(stamp for _, stamp in keys), variant, keys, tuple(lights)))
            pairing[label] += _pairs_of_reports(lights, sources, names)
    plain = plain_pairing(drive)
    return {
        label: DriveRun(
            drive=drive,
            outcomes=hold_against_truth(drive.true_drive, drive.truth, sets[label], drive.signals, {}),
            step_ms=tuple(step_ms[label]),
            pairing=pairing[label],
            plain_pairing=plain,
            skipped=dict(pipeline.skipped),
        )
        for label, pipeline in pipelines.items()
    }


def plain_pairing(drive: SuiteDrive, *, max_distance_px: float = 80.0, score_threshold: float = 0.25) -> Pairing:
    """What a plain association makes of a drive: the paper's cost under one threshold in pixels, image by image."""
    given, names = drive.drive, _map_names(drive)
    poses = given.pose_buffer()
    class_types = np.array([drive.signals.type_of[name] for name in drive.signals.classes])
    pairing = Pairing()
    for (camera, stamp_ns), every in drive.detections.items():
        rows = np.flatnonzero(every.scores >= score_threshold)
        projected = project_lights(given.lights, given.cameras[camera], poses.at(stamp_ns))
        cost = association_cost(projected, every[rows], class_types, max_distance_px=max_distance_px)
        sources = drive.sources[camera, stamp_ns]
        for light, detection in associate(cost, unmatched_cost=max_distance_px).matches.tolist():
            map_id = given.lights.ids[int(projected.indices[light])]
            pairing += _judge(map_id, sources[int(rows[detection])], names)
    return pairing


_FrameKey: TypeAlias = tuple[str, int]
_Box: TypeAlias = tuple[float, ...]


def _sources_by_box(drive: SuiteDrive, keys: Sequence[_FrameKey]) -> dict[tuple[_FrameKey, _Box], str | None]:
    return {
        (key, tuple(box)): source
        for key in keys
        for box, source in zip(drive.detections[key].boxes_xyxy.tolist(), drive.sources[key], strict=True)
    }


def _pairs_of_reports(
    lights: Sequence[LightEstimate],
    sources: Mapping[tuple[_FrameKey, _Box], str | None],
    names: Mapping[str, str | None],
) -> Pairing:
    """Hold the boxes that reports of map lights name against the lights that these boxes show."""
    pairing = Pairing()
    for light in lights:
        for view in light.views:
            if light.map_id is not None and view.box_xyxy is not None:
                pairing += _judge(light.map_id, sources[(view.camera, view.stamp_ns), view.box_xyxy], names)
    return pairing


def _map_names(drive: SuiteDrive) -> dict[str, str | None]:
    return {light.truth_id: light.map_id for frame in drive.truth.values() for light in frame.lights}


def _judge(map_id: str, source: str | None, names: Mapping[str, str | None]) -> Pairing:
    right = source is not None and names.get(source) == map_id
    return Pairing(int(right), int(not right))
