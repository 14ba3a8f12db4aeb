"""What can be known of a light's state at all? The runtime beside an observer that knows the suite's own secrets.

One kind of light at a time, each alone in its signal group, before two cameras at 10 sets a second, in plain view; the
suite's detector model errs. Three filters see the same looks, and choose what to say by the same rule:

- the runtime's;
- one that knows the detector model exactly: what spoils both cameras, what spoils each, the rates on the road, the
  persistence, and how sure errors and truths are; but no more of the signals than the description says;
- one that also knows the simulator's programme: each phase's range of durations, flash rates and duty cycles.

The exact filter runs over (phase and time in it) × (what spoils both cameras, the first, the second); the spoilers are
taken as independent of the time in a phase, given the class that is shown.

Usage: python tools/ideal_states.py 4 [--lights 40] [--sets 1200] [--seed 2026] [--odds 1 3 9 30]
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from autolights.core import BoolArray, FloatArray, IntArray, SignalSet, load_config, load_signals
from autolights.pipeline import PipelineConfig
from autolights.sim.detector_model import DetectorModel, LightViews, ModelledFrame, scale_errors, split_chance
from autolights.sim.programme import FLASHING, PHASES, SHOWN, draw_programme
from autolights.suite import SuiteConfig
from autolights.suite.drives import road_rates
from autolights.suite.run import suite_hmm
from autolights.suite.scene import show
from autolights.track.config import TrackConfig
from autolights.track.hidden_chain import HiddenChain
from autolights.track.outcomes import Outcomes, choose
from autolights.track.states import Looks
from autolights.track.timed_states import TimedStates

_DT_S = 0.1
_SETTLE = 100  # sets that are not counted
_HEIGHT_PX = 40.0
_MIN_SCORE = 0.25
_DURATIONS_S = ((3.8, 4.8), (3.0, 3.3), (1.0, 1.0), (7.0, 8.5), (3.0, 3.6), (6.5, 8.0))  # sim.programme.draw_programme
_FLASHES = [(period_s, ratio) for period_s in (1.0, 1.1, 1.2) for ratio in (0.54, 0.62)]
_LOW, _HIGH, _HIGHEST = 0.8, 0.92, 0.935  # leading probability: levels of an error end at 0.92, noise goes beyond
_SLIP = 1e-4  # noise may carry a look over the border between two levels


@dataclass(frozen=True, eq=False)
class Said:
    """What a filter says, set by set: (t, n) class ids, −1 where withheld, and whether the light flashes."""

    class_ids: IntArray
    flashing: BoolArray


@dataclass(frozen=True, eq=False)
class Road:
    """n lights over t sets: what is lit, what is to be said, and two cameras' detections."""

    suite: SuiteConfig
    signals: SignalSet
    kind: str
    rates: FloatArray
    reported: IntArray
    flashing: BoolArray
    cameras: tuple[list[ModelledFrame], ...]

    @classmethod
    def simulate(cls, kind: str, count: int, sets: int, seed: int) -> "Road":
        """Each light has a programme of its own."""
        suite, signals = load_config("suite/default", SuiteConfig, [f"seed={seed}"]), load_signals()
        rng, times_s = np.random.default_rng([seed, 99]), np.arange(sets) * _DT_S + 1e-4
        shown = [
            show(draw_programme(float(rng.uniform(0, 26)), rng), kind, times_s, signals, "ordinary")
            for _ in range(count)
        ]
        lit, reported, flashing = (np.stack(column, axis=1) for column in zip(*shown, strict=True))
        rates = road_rates(suite, signals)
        duration_s = sets * _DT_S + 1
        model = DetectorModel(signals, rates, suite.detector, count=count, duration_s=duration_s, seed=(seed, 77))
        box = np.array([600.0, 300.0, 620.0, 300.0 + _HEIGHT_PX])
        boxes, hidden = np.broadcast_to(box, (sets, count, 4)), np.zeros((sets, count))
        views = LightViews(times_s, (1280, 800), boxes, lit, hidden, np.ones(count, dtype=bool))
        cameras = tuple(model.detect(views, camera=camera) for camera in (0, 1))
        return cls(suite, signals, kind, scale_errors(rates, suite.detector.error_scale), reported, flashing, cameras)

    def looks(self, number: int) -> Iterator[tuple[IntArray, FloatArray]]:
        """For each camera the lights that it found in a set, and their class vectors."""
        for frames in self.cameras:
            frame = frames[number]
            rows = np.flatnonzero((frame.sources >= 0) & (frame.detections.scores >= _MIN_SCORE))
            yield frame.sources[rows], frame.detections.class_probs[rows]


def runtime(road: Road, config: TrackConfig) -> Said:
    """What the runtime says."""
    sets, count = road.reported.shape
    signals, kind = road.signals, list(road.signals.types).index(road.kind)
    own = np.array([signals.type_of[name] == road.kind for name in signals.classes])
    states = TimedStates(signals, suite_hmm(road.suite, signals), config)
    states.append(np.full(count, kind), np.full(count, -1))
    class_ids, flashing = np.empty((sets, count), dtype=np.int64), np.empty((sets, count), dtype=bool)
    for number in range(sets):
        states.let_time_pass(round((1 + number * _DT_S) * 1e9))
        rows, class_probs = (np.concatenate(column) for column in zip(*road.looks(number), strict=True))
        telling = own[class_probs.argmax(axis=1)]
        heights = np.full(int(telling.sum()), _HEIGHT_PX)
        states.take_in(Looks(rows[telling], class_probs[telling], heights, np.empty(0, dtype=np.int64)))
        states.end_set(np.ones(count, dtype=bool), np.zeros(count, dtype=bool))
        reports = states.report()
        class_ids[number] = np.where(reports.doubtful, -1, reports.class_ids)
        flashing[number] = reports.flashing
    return Said(class_ids, flashing)


@dataclass(frozen=True, eq=False)
class Timing:
    """(K, K) transitions over 0.1 s between hidden states, their distribution, class, and which are of a flash."""

    change: FloatArray
    initial: FloatArray
    class_of: IntArray
    flashes: BoolArray


def programme_timing(kind: str, names: Sequence[str], signals: SignalSet) -> Timing:
    """All that there is to know of the simulator's programmes."""
    blocks = [
        (phase, flash)
        for phase, name in enumerate(PHASES)
        for flash in (_FLASHES if SHOWN[kind][name] == FLASHING else [None])
    ]
    sizes = [int(np.ceil(_DURATIONS_S[phase][1] / _DT_S - 1e-9)) for phase, _ in blocks]
    first = np.cumsum([0, *sizes])
    change, class_of, flashes = np.zeros((first[-1], first[-1])), [], []
    for block, (phase, flash) in enumerate(blocks):
        low_s, high_s = _DURATIONS_S[phase]
        following = [b for b, (other, _) in enumerate(blocks) if other == (phase + 1) % len(PHASES)]
        ages_s = np.arange(sizes[block] + 1) * _DT_S
        over = np.clip((ages_s - low_s) / max(high_s - low_s, 1e-6), 0, 1)
        over[-1] = 1.0
        for age, (before, after) in enumerate(pairwise(over)):
            state, ends = first[block] + age, (after - before) / max(1 - before, 1e-9)
            change[state, first[following]] += ends / len(following)
            if ends < 1:
                change[state, state + 1] += 1 - ends
            name = SHOWN[kind][PHASES[phase]]
            if flash is not None:
                pair = signals.types[kind].flashing[0]
                name = pair.on if (age + 0.5) * _DT_S % flash[0] < flash[0] * flash[1] else pair.off
            class_of.append(names.index(name))
            flashes.append(flash is not None)
    initial = np.full(len(change), 1 / len(change))
    for _ in range(4000):
        initial = initial @ change
    return Timing(change, initial, np.array(class_of), np.array(flashes))


def described_timing(chain: HiddenChain) -> Timing:
    """What the signal description says, as the runtime reads it."""
    flashes = np.array([chain.phases[phase].pair is not None for phase in chain.phase_of])
    return Timing(chain.over(round(1000 * _DT_S))[0], chain.initial, chain.class_of, flashes)


class KnowingFilter:
    """The forward algorithm where all about the detector model is known.

    Three spoilers stand behind the looks of two cameras at a light: one of both, one of each. A spoiler makes one wrong
    class be seen, at one of two levels of confidence, or another type, or it lowers the confidence in the right one to
    one of three levels. It lasts, and is then drawn anew from what the class that is shown allows.

    Args:
        road: Its rates and detector settings.
        names: k classes of the kind.
        timing: Of the signals.
    """

    def __init__(self, road: Road, names: Sequence[str], timing: Timing) -> None:
        self._timing, self._k = timing, len(names)
        self._ids = np.array([road.signals.class_ids[name] for name in names])
        k, config, count = self._k, road.suite.detector, road.reported.shape[1]
        self._errors = 2 * k + 1
        size = self._errors + 3
        low, high = (1 - (1 - (lead - 0.55) / 0.43) ** 0.1 for lead in (_LOW, _HIGH))
        draws = np.zeros((2, k, size))
        for c, class_id in enumerate(self._ids):
            wrong = road.rates[class_id].copy()
            wrong[class_id] = 0.0
            chances = split_chance(wrong.sum(keepdims=True), config.camera_correlation)
            for draw, (chance,) in zip(draws[:, c], chances, strict=True):
                shares = chance * wrong[self._ids] / wrong.sum()
                draw[0 : 2 * k : 2] = shares * (_LOW - 0.5) / 0.42
                draw[1 : 2 * k : 2] = shares * (0.92 - _LOW) / 0.42
                draw[2 * k] = chance - shares.sum()
                draw[self._errors :] = (1 - chance) * np.array([low, high - low, 1 - high])
        self._draws = (draws[0], draws[1], draws[1])
        typical = 1 - float(np.diag(road.rates).mean())
        self._stays = float(np.exp(-_DT_S / (config.persistence_s * (1 - typical))))
        # What a camera shows where both are spoilt by a and it alone by b: an error first, else the poorer level.
        a, b = np.indices((size, size))
        self._shows = np.where(a < self._errors, a, np.where(b < self._errors, b, np.minimum(a, b)))
        self._states = np.tile(timing.initial, (count, 1))
        joint = np.einsum("ca,cb,cd->cabd", *self._draws)
        self._spoilt = np.broadcast_to(joint, (count, *joint.shape)).astype(np.float32)

    def step(self, looks: Iterator[tuple[IntArray, FloatArray]]) -> FloatArray:
        """(n, K) belief in the hidden states after 0.1 s and one look of each camera."""
        timing, k = self._timing, self._k
        is_class = np.eye(k)[timing.class_of]
        moved = np.stack([(self._states * is_class[:, c]) @ timing.change for c in range(k)], axis=1)
        between = moved @ is_class  # (n, k before, k after)
        origin = between / np.maximum(between.sum(axis=1, keepdims=True), 1e-20)
        shape = self._spoilt.shape
        spoilt = np.matmul(origin.transpose(0, 2, 1).astype(np.float32), self._spoilt.reshape(*shape[:2], -1))
        spoilt = spoilt.reshape(shape)
        for axis, draw in zip((2, 3, 4), self._draws, strict=True):
            along = [1, k, 1, 1, 1]
            along[axis] = -1
            anew = spoilt.sum(axis=axis, keepdims=True) * draw.reshape(along).astype(np.float32)
            spoilt = self._stays * spoilt + (1 - self._stays) * anew
        first, second = (self._likelihood(rows, class_probs)[:, :, self._shows] for rows, class_probs in looks)
        spoilt *= first[:, :, :, :, None] * second[:, :, :, None, :]
        evidence = spoilt.sum(axis=(2, 3, 4))
        self._spoilt = spoilt / np.maximum(evidence, 1e-30)[:, :, None, None, None]
        states = moved.sum(axis=1) * evidence[:, timing.class_of]
        self._states = states / states.sum(axis=1, keepdims=True)
        return self._states

    def _likelihood(self, rows: IntArray, class_probs: FloatArray) -> FloatArray:
        """(n, k, spoilers) whether a camera says what it does, for each class shown; ones where it says nothing."""
        k, errors = self._k, self._errors
        best, lead = class_probs.argmax(axis=1), class_probs.max(axis=1)
        is_seen = best[:, None] == self._ids  # (m, k)
        level = np.digitize(lead, (_LOW, _HIGHEST))
        fits = np.zeros((len(rows), k, errors + 3), dtype=bool)
        for j in range(k):
            # An error stays one when the light changes; if its class is what is shown now, it is right in doubt.
            shown = np.arange(k) == j
            in_doubt = is_seen[:, j] & (level < 2)
            for part in (0, 1):
                fits[:, :, 2 * j + part] = (in_doubt & (level == part))[:, None] | (in_doubt[:, None] & shown)
        fits[:, :, 2 * k] = ~is_seen.any(axis=1)[:, None]
        for part in range(3):
            fits[:, :, errors + part] = is_seen & (level == part)[:, None]
        likelihood = np.ones((len(self._states), k, errors + 3), dtype=np.float32)
        likelihood[rows] = np.where(fits, 1.0, _SLIP)
        return likelihood


def knowing(road: Road, timing: Timing, outcomes: Outcomes, config: TrackConfig, odds: Sequence[float]) -> list[Said]:
    """What a filter says that knows the detector, for each way of choosing."""
    sets, count = road.reported.shape
    names = road.signals.states_of(road.kind)
    belief = KnowingFilter(road, names, timing)
    reported = [pair.reported for pair in road.signals.types[road.kind].flashing]
    labels = [
        (reported[0] if flashes else names[c], bool(flashes))
        for c, flashes in zip(timing.class_of, timing.flashes, strict=True)
    ]
    membership = np.array([[float((o.class_name, o.flashing) == label) for o in outcomes.names] for label in labels])
    ids = np.array([road.signals.class_ids[o.class_name] for o in outcomes.names])
    flashing = np.array([o.flashing for o in outcomes.names])
    g = len(ids)
    rules = [np.where(outcomes.stops_flashing | np.eye(g, dtype=bool), 1.0, value) for value in odds]
    before = [np.full(count, -1) for _ in odds]
    said = [Said(np.empty((sets, count), dtype=np.int64), np.empty((sets, count), dtype=bool)) for _ in odds]
    contradiction = np.broadcast_to(outcomes.contradiction, (count, g, g))
    for number in range(sets):
        mass = belief.step(road.looks(number)) @ membership
        for i, rule in enumerate(rules):
            choice = choose(
                mass,
                contradiction,
                np.zeros((count, g), dtype=bool),
                before[i],
                rule[before[i]],
                max_go_risk=config.max_go_risk,
                min_probability=config.min_probability,
            )
            before[i] = np.where(choice.doubtful, before[i], choice.outcome)
            said[i].class_ids[number] = np.where(choice.doubtful, -1, ids[choice.outcome])
            said[i].flashing[number] = flashing[choice.outcome]
    return said


def figures(road: Road, said: Said) -> str:
    """A row of the table, counted as the suite counts."""
    truth, flashes = road.reported[_SETTLE:], road.flashing[_SETTLE:]
    told, flags = said.class_ids[_SETTLE:], said.flashing[_SETTLE:]
    sets, count = truth.shape
    means = [road.signals.meanings(name) for name in road.signals.classes]
    denies = np.array(
        [
            [any(there.get(m) == "stop" and what == "go" for m, what in here.items()) for there in means]
            for here in means
        ]
    )
    frames: list[int] = []
    onsets: list[int] = []
    flickers = unsafe = 0
    for i in range(count):
        new = np.append(False, truth[1:, i] != truth[:-1, i])
        ends = np.append(np.flatnonzero(new), sets)
        for start, end in pairwise(ends.tolist()):
            known = told[start:end, i] == truth[start, i]
            if flashes[start, i]:
                onsets += [int(at) for at in np.flatnonzero(known & flags[start:end, i])[:1]]
            else:
                frames += [int(at) for at in np.flatnonzero(known)[:1]]
            go = told[start + 4 : end, i]
            unsafe += int(denies[go[go >= 0], truth[start, i]].sum())
        last, owed = -1, False
        for changed, right, now in zip(new, truth[:, i], told[:, i].tolist(), strict=True):
            owed |= bool(changed)
            if now < 0:
                continue
            if last < 0:
                owed = False
            elif now != last:
                flickers += not (owed and now == right)
                owed &= now != right
            last = now
    minutes = sets * count * _DT_S / 60
    return (
        f"{100 * (told == truth).mean():.2f} | {100 * (told < 0).mean():.2f} | {unsafe} | {flickers / minutes:.3f} | "
        f"{np.median(frames):.0f} / {np.quantile(frames, 0.95):.1f} | {100 * (np.array(frames) > 2).mean():.1f} | "
        f"{max(onsets, default=0) * _DT_S:.1f}"
    )


def main() -> None:
    """Simulate, filter, print Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=sorted(SHOWN), help="type of light")
    parser.add_argument("--lights", type=int, default=40)
    parser.add_argument("--sets", type=int, default=1200)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--odds", type=float, nargs="+", default=[1, 3, 9, 30], help="change_odds of the rule")
    arguments = parser.parse_args()
    if arguments.sets <= _SETTLE:
        parser.error(f"--sets must be above {_SETTLE}, which are not counted; got {arguments.sets}")
    config = load_config("runtime/default", PipelineConfig).track
    road = Road.simulate(arguments.kind, arguments.lights, arguments.sets, arguments.seed)
    params = suite_hmm(road.suite, road.signals)[road.kind]
    chain = HiddenChain.of(
        road.kind,
        road.signals,
        params,
        stages=config.dwell_stages,
        odd_changes_per_hour=config.odd_changes_per_hour,
    )
    outcomes = Outcomes.of(road.kind, road.signals, params, chain)
    print(
        "| filter | change odds | right, % | withheld, % | unsafe | flicker/min | latency | > 2, % | worst onset, s |"
    )
    print("| --- " * 9 + "|")
    for odds in arguments.odds:
        said = runtime(road, config.model_copy(update={"change_odds": odds}))
        print(f"| runtime | {odds:g} | {figures(road, said)} |", flush=True)
    timings = {
        "knows the detector": described_timing(chain),
        "knows detector and programme": programme_timing(road.kind, params.states, road.signals),
    }
    for name, timing in timings.items():
        for odds, said in zip(arguments.odds, knowing(road, timing, outcomes, config, arguments.odds), strict=True):
            print(f"| {name} | {odds:g} | {figures(road, said)} |", flush=True)


if __name__ == "__main__":
    main()
