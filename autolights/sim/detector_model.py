"""A detector without images: what it says of lights whose truth is known, with errors as real detectors make them.

Errors hang together over time and between cameras. Behind each light and camera stand uniform numbers that are redrawn
at the ticks of a Poisson process; an error is a small number. So at any instant the chance of an error is exactly the
one asked for, whatever the state, the size or the frame rate, and an error lasts as long as its number.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from pydantic import Field

from autolights.core import Config, ConfusionMatrix, Detections, FloatArray, IntArray, SignalSet
from autolights.core.arrays import BoolArray
from autolights.core.boxes import area, clip
from autolights.core.errors import UsageError

_GRID_S = 0.01  # the numbers are drawn on this grid, so that all frame rates and cameras see the same errors
_HIDDEN_FROM, _HIDDEN_TO = 0.25, 0.75  # share of a box from which it is missed more often, and always
_FLOOR = 0.012  # a sigmoid that means nothing


class DetectorModelConfig(Config):
    """How good the detector is, and how its errors hang together.

    Attributes:
        persistence_s: Mean time for which one wrong class is seen.
        camera_correlation: Of the errors (and of the misses) that two cameras make on one light at one instant.
        error_scale: All class errors of the confusion rates times this.
        miss_rate: Share of large, plain lights that are missed.
        small_height_px: Lights of this height are always missed; the share falls with the square of the height.
        miss_persistence_s: Mean time for which a rare miss lasts.
        edge_sigma_px: Standard deviation of a box's edges, drawn anew in each image.
        edge_sigma_share: The same in heights of the box; both add up as variances.
        edge_persistent_share: Share of the variance that lasts as long as a class error does.
        false_alarms_per_s: New false alarms in each camera, anywhere in the image.
        lookalike_share: Share of the time in which a look-alike is taken for a light.
        min_score: Detections below it are not given.
    """

    persistence_s: float = Field(default=0.4, gt=0)
    camera_correlation: float = Field(default=0.5, ge=0, le=1)
    error_scale: float = Field(default=1.0, ge=0)
    miss_rate: float = Field(default=0.02, ge=0, lt=1)
    small_height_px: float = Field(default=5.0, ge=0)
    miss_persistence_s: float = Field(default=0.3, gt=0)
    edge_sigma_px: float = Field(default=0.8, ge=0)
    edge_sigma_share: float = Field(default=0.02, ge=0)
    edge_persistent_share: float = Field(default=0.5, ge=0, le=1)
    false_alarms_per_s: float = Field(default=0.05, ge=0)
    lookalike_share: float = Field(default=0.5, ge=0, le=1)
    min_score: float = Field(default=0.1, ge=0, lt=1)


@dataclass(frozen=True, eq=False)
class LightViews:
    """What one camera has before it, frame by frame: n lights, then k things that look like lights.

    Attributes:
        times_s: (t,) seconds since the start, ascending.
        size_wh: Of the image.
        boxes_xyxy: (t, n + k, 4) pixels, amodal; NaN where the camera cannot see it.
        class_ids: (t, n + k) what is lit, or what it looks like.
        hidden: (t, n + k) share of the box that something hides.
        is_light: (n + k,) whether it is one.
    """

    times_s: FloatArray
    size_wh: tuple[int, int]
    boxes_xyxy: FloatArray
    class_ids: IntArray
    hidden: FloatArray
    is_light: BoolArray


@dataclass(frozen=True, eq=False)
class ModelledFrame:
    """One image's detections and where they come from.

    Attributes:
        detections: In random order, as far as anybody can tell.
        sources: (m,) column of `LightViews` behind each detection; -1 for an alarm of nothing.
    """

    detections: Detections
    sources: IntArray


class DetectorModel:
    """The errors of one drive: those that the cameras share, and those of each camera.

    Args:
        signals: Types and classes.
        rates: (C, C) P(seen as | lit class, detected); rows sum to 1. Other types' classes may be seen.
        config: The rest.
        count: Of lights and look-alikes.
        duration_s: Of the drive.
        seed: Same seed, same errors, at any frame rate.
    """

    def __init__(
        self,
        signals: SignalSet,
        rates: FloatArray,
        config: DetectorModelConfig,
        *,
        count: int,
        duration_s: float,
        seed: tuple[int, ...],
    ) -> None:
        self._signals = signals
        self._config = config
        self._rates = scale_errors(rates, config.error_scale)
        self._count = count
        self._duration_s = duration_s
        self._seed = seed
        self._shared = self._draw(np.random.default_rng([*seed, 0]))

    def detect(self, views: LightViews, *, camera: int) -> list[ModelledFrame]:
        """Detections in each frame of a camera; `camera` counts from 0 and has its own random numbers."""
        rng = np.random.default_rng([*self._seed, 1, camera])
        own, shared = self._draw(rng), self._shared
        seen, quality = self._seen(views, own, shared)
        frames, columns = np.nonzero(seen)
        class_probs = self._class_probs(views, own, shared, frames, columns, rng)
        boxes = self._boxes(views, own, frames, columns, rng)
        objectness = quality[frames, columns] * np.where(views.is_light[columns], 1.0, 0.85)
        alarms = self._alarms(views, rng)
        frames = np.concatenate([frames, alarms[0]])
        columns = np.concatenate([columns, np.full(len(alarms[0]), -1)])
        everything = Detections(
            np.concatenate([boxes, alarms[1]]),
            np.concatenate([objectness, alarms[2]]),
            np.concatenate([class_probs, alarms[3]]),
        )
        kept = (everything.scores >= self._config.min_score) & (area(everything.boxes_xyxy) > 0)
        order = np.lexsort([rng.random(len(frames)), frames])
        order = order[kept[order]]
        starts = np.searchsorted(frames[order], np.arange(len(views.times_s) + 1))
        return [ModelledFrame(everything[order[a:b]], columns[order[a:b]]) for a, b in pairwise(starts.tolist())]

    def _draw(self, rng: np.random.Generator) -> "_Chances":
        config, shape = self._config, (int(np.ceil(self._duration_s / _GRID_S)) + 1, self._count)
        # A run of errors goes on where its number is redrawn and is small again, hence a little shorter than asked.
        typical = 1 - float(np.diag(self._rates).mean())
        class_ticks = _ticks(shape, config.persistence_s * (1 - typical), rng)
        miss_ticks = _ticks(shape, config.miss_persistence_s * (1 - config.miss_rate), rng)
        error, pick, doubt = (_hold(class_ticks, rng.random(shape)) for _ in range(3))
        edges = _hold(class_ticks, rng.normal(size=shape)), _hold(miss_ticks, rng.normal(size=shape))
        return _Chances(error, pick, doubt, _hold(miss_ticks, rng.random(shape)), *edges)

    def _seen(self, views: LightViews, own: "_Chances", shared: "_Chances") -> tuple[BoolArray, FloatArray]:
        """(t, n + k) which are detected, and the objectness of those."""
        config, rows = self._config, _grid_rows(views.times_s)
        height = views.boxes_xyxy[..., 3] - views.boxes_xyxy[..., 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            inside = area(clip(np.nan_to_num(views.boxes_xyxy), views.size_wh)) / area(np.nan_to_num(views.boxes_xyxy))
            small = np.clip((config.small_height_px / height) ** 2, 0, 1)
        hidden = 1 - (1 - views.hidden) * np.nan_to_num(inside)
        covered = np.clip((hidden - _HIDDEN_FROM) / (_HIDDEN_TO - _HIDDEN_FROM), 0, 1)
        found = (1 - config.miss_rate) * (1 - np.nan_to_num(small, nan=1.0)) * (1 - covered)
        found = np.where(views.is_light, found, found * config.lookalike_share)
        missed = 1 - found
        both, alone = split_chance(missed, config.camera_correlation)
        in_both, in_one = shared.miss[rows], own.miss[rows]
        seen = (in_both >= both) & (in_one >= alone)
        # What was nearly missed has a low score.
        with np.errstate(divide="ignore", invalid="ignore"):
            margin = np.minimum((in_both - both) / (1 - both), (in_one - alone) / (1 - alone))
        quality = 0.2 + 0.77 * (1 - (1 - np.clip(np.nan_to_num(margin), 0, 1)) ** 8)
        return seen, quality

    def _class_probs(
        self,
        views: LightViews,
        own: "_Chances",
        shared: "_Chances",
        frames: IntArray,
        columns: IntArray,
        rng: np.random.Generator,
    ) -> FloatArray:
        """(m, C) sigmoids of the detected ones: the wrong class leads in an error, the truth follows it."""
        rows = _grid_rows(views.times_s)[frames]
        truth = views.class_ids[frames, columns]
        wrong_rate = 1 - np.diag(self._rates)[truth]
        both, alone = split_chance(wrong_rate, self._config.camera_correlation)
        in_both, in_one = shared.error[rows, columns], own.error[rows, columns]
        wrong_in_both = in_both < both
        wrong = wrong_in_both | (in_one < alone)
        pick = np.where(wrong_in_both, shared.pick[rows, columns], own.pick[rows, columns])
        doubt = np.where(wrong_in_both, shared.doubt[rows, columns], own.doubt[rows, columns])
        other = self._other_class(truth, pick)
        with np.errstate(divide="ignore", invalid="ignore"):
            margin = np.minimum((in_both - both) / (1 - both), (in_one - alone) / (1 - alone))
        # Sure where no error is near; in an error between half sure and sure.
        lead = np.where(wrong, 0.5 + 0.42 * doubt, 0.55 + 0.43 * (1 - (1 - np.clip(np.nan_to_num(margin), 0, 1)) ** 10))
        # Above one half, so that no noise turns the order round and the rates stay those asked for.
        lead = np.clip(lead + rng.normal(0, 0.015, len(lead)), 0.51, 0.995)
        runner_up = (1 - lead) * rng.uniform(0.4, 0.95, len(lead))
        probs = rng.uniform(0, 2 * _FLOOR, (len(truth), len(self._signals.classes)))
        every = np.arange(len(truth))
        probs[every, np.where(wrong, truth, other)] = runner_up
        probs[every, np.where(wrong, other, truth)] = lead
        return probs

    def _other_class(self, truth: IntArray, chance: FloatArray) -> IntArray:
        """The class that is mistaken for the truth, by its share of the errors."""
        errors = self._rates * (1 - np.eye(len(self._rates)))
        total = errors.sum(axis=1, keepdims=True)
        # A class that is never mistaken has a neighbour in doubt all the same.
        cumulated = np.cumsum(np.where(total > 0, errors / np.where(total > 0, total, 1), 1 / len(errors)), axis=1)
        other = (chance[:, None] >= cumulated[truth]).sum(axis=1).clip(max=len(errors) - 1)
        return np.asarray(np.where(other == truth, (truth + 1) % len(errors), other))

    def _boxes(
        self, views: LightViews, own: "_Chances", frames: IntArray, columns: IntArray, rng: np.random.Generator
    ) -> FloatArray:
        config, rows = self._config, _grid_rows(views.times_s)[frames]
        boxes = views.boxes_xyxy[frames, columns]
        sigma = np.hypot(config.edge_sigma_px, config.edge_sigma_share * (boxes[:, 3] - boxes[:, 1]))
        sigma = sigma * (1 + 2 * views.hidden[frames, columns])
        lasting, fresh = np.sqrt(config.edge_persistent_share), np.sqrt(1 - config.edge_persistent_share)
        noise = fresh * rng.normal(size=boxes.shape)
        # The part that lasts shifts and stretches upright: opposite edges move together or apart.
        shift, stretch = own.shift[rows, columns], own.stretch[rows, columns]
        noise += lasting * np.stack([shift, (shift + stretch) / np.sqrt(2), shift, (shift - stretch) / np.sqrt(2)], 1)
        return clip(boxes + sigma[:, None] * noise, views.size_wh)

    def _alarms(
        self, views: LightViews, rng: np.random.Generator
    ) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """Alarms of nothing: frame, box, objectness and class vector of each sight."""
        config, classes = self._config, self._signals.classes
        count = rng.poisson(config.false_alarms_per_s * self._duration_s)
        starts_s = rng.uniform(0, self._duration_s, count)
        ends_s = starts_s + rng.exponential(config.persistence_s, count)
        width, height = views.size_wh
        heights = rng.uniform(14, 60, count)
        class_ids = rng.integers(len(classes), size=count)
        sizes = self._signals.sizes_m(self._signals.type_of[classes[i]] for i in class_ids)
        centres = np.stack([rng.uniform(40, width - 40, count), rng.uniform(40, 0.6 * height, count)], axis=1)
        halves = np.stack([heights * sizes[:, 0] / sizes[:, 1], heights], axis=1) / 2
        lead = rng.uniform(0.3, 0.9, count)
        frames, which = np.nonzero((views.times_s[:, None] >= starts_s) & (views.times_s[:, None] < ends_s))
        boxes = np.concatenate([centres - halves, centres + halves], axis=1)[which]
        boxes = boxes + rng.normal(0, config.edge_sigma_px, boxes.shape)
        probs = rng.uniform(0, 2 * _FLOOR, (len(which), len(classes)))
        probs[np.arange(len(which)), class_ids[which]] = lead[which]
        return frames, clip(boxes, views.size_wh), rng.uniform(0.3, 0.9, count)[which], probs


@dataclass(frozen=True, eq=False)
class _Chances:
    """(g, n + k) uniform numbers (the last two: standard normal) on the grid, each held until it is redrawn."""

    error: FloatArray
    pick: FloatArray
    doubt: FloatArray
    miss: FloatArray
    shift: FloatArray
    stretch: FloatArray


def split_chance(chance: FloatArray, correlation: float) -> tuple[FloatArray, FloatArray]:
    """Chances of an event that both cameras share and of each camera's own, which together make correlated events.

    With independent events of chance s (shared) and o (own), a camera has one with chance 1 − (1 − s)(1 − o) = e, both
    have one with chance s + (1 − s) o² = e² + ρ e (1 − e): solved for s and o.

    Args:
        chance: e, any shape, in [0, 1].
        correlation: ρ in [0, 1].

    Returns:
        s and o.
    """
    remaining = 1 - chance + correlation * chance
    shared = np.divide(correlation * chance, remaining, out=np.ones_like(chance), where=remaining > 0)
    return shared, np.where(shared < 1, chance * (1 - correlation), 0.0)


def confusion_rates(table: Mapping[str, Mapping[str, float]], signals: SignalSet) -> FloatArray:
    """(C, C) P(seen as | class, detected) from the errors of each class; what is left over is right.

    Raises:
        UsageError: If a class is unknown, or its errors are negative or reach 1.
    """
    rates = np.zeros((len(signals.classes), len(signals.classes)))
    for truth, errors in table.items():
        for seen, rate in errors.items():
            if truth not in signals.class_ids or seen not in signals.class_ids:
                raise UsageError(f"confusion rates: '{truth}' or '{seen}' is no class of '{signals.name}'")
            rates[signals.class_ids[truth], signals.class_ids[seen]] = rate
    np.fill_diagonal(rates, 0)
    wrong = rates.sum(axis=1)
    if (rates < 0).any() or (wrong >= 1).any():
        raise UsageError(f"confusion rates of a class must not be negative and sum to less than 1, got {wrong.max()}")
    return np.asarray(rates + np.diag(1 - wrong))


def scale_errors(rates: FloatArray, scale: float) -> FloatArray:
    """All errors of (C, C) rates times `scale`; no class is wrong more often than in 9 of 10 cases."""
    errors = rates * (1 - np.eye(len(rates))) * scale
    wrong = errors.sum(axis=1, keepdims=True)
    errors = errors * np.minimum(1, 0.9 / np.maximum(wrong, 1e-12))
    return np.asarray(errors + np.diag(1 - errors.sum(axis=1)))


def perturb_errors(rates: FloatArray, spread: float, rng: np.random.Generator) -> FloatArray:
    """Another detector of the same quality: each error of (C, C) rates times a log-normal factor of mean 1."""
    factors = np.exp(rng.normal(-(spread**2) / 2, spread, rates.shape))
    errors = rates * (1 - np.eye(len(rates))) * factors
    return np.asarray(errors + np.diag(1 - errors.sum(axis=1)))


def expected_confusion(
    rates: FloatArray, signals: SignalSet, *, per_class: int, miss_rate: float, score_threshold: float
) -> ConfusionMatrix:
    """The confusion matrix that a validation set with `per_class` lights of each class would give on average."""
    size = len(signals.classes)
    counts = np.zeros((size + 1, size + 1), dtype=np.int64)
    counts[:size, :size] = np.rint(per_class * (1 - miss_rate) * rates)
    counts[:size, size] = round(per_class * miss_rate)
    return ConfusionMatrix(signals.classes, counts, score_threshold=score_threshold, iou_threshold=0.5)


def _ticks(shape: tuple[int, int], mean_s: float, rng: np.random.Generator) -> IntArray:
    """(g, n) row of the latest redraw at each instant of the grid."""
    redrawn = rng.random(shape) < 1 - np.exp(-_GRID_S / mean_s)
    return np.asarray(np.maximum.accumulate(np.where(redrawn, np.arange(shape[0])[:, None], 0), axis=0))


def _hold(ticks: IntArray, draws: FloatArray) -> FloatArray:
    return np.take_along_axis(draws, ticks, axis=0)


def _grid_rows(times_s: FloatArray) -> IntArray:
    return np.floor(np.maximum(times_s, 0) / _GRID_S + 1e-9).astype(np.int64)
