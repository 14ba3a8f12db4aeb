"""Mode ``timed``: what is believed of all tracks, moved through time, updated and read by arrays, type by type."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from autolights.core import BoolArray, FloatArray, HmmParameters, IntArray, SignalSet
from autolights.track.appearance_filter import (
    LookReader,
    leading_pairs,
    miss_likelihood,
    seen_likelihood,
)
from autolights.track.belief_block import BeliefBlock, LineUp
from autolights.track.config import TrackConfig
from autolights.track.outcomes import choose
from autolights.track.signal_groups import GroupDisputes
from autolights.track.states import Looks, Reports
from autolights.track.type_model import TypeModel

_TIE = 1e-6  # of probability
_SURELY = 0.5  # how far the highest level of certainty is reached


class TimedStates:
    """Beliefs of all tracks: hidden states with dwell times, and how the detector sees them.

    Args:
        signals: The signal description.
        hmm: One model per type.
        config: Of tracking.
    """

    def __init__(self, signals: SignalSet, hmm: Mapping[str, HmmParameters], config: TrackConfig) -> None:
        self._config = config
        widest = max(len(params.states) for params in hmm.values())
        self._models = [TypeModel.of(name, signals, hmm[name], widest, config) for name in signals.types]
        count, outcomes = len(self._models), [model.outcomes for model in self._models]
        most = max(len(own.names) for own in outcomes)
        self._contradiction = np.zeros((count, most, most))
        self._change_odds = np.ones((count, most, most))
        self._said_class_ids, self._said_flashing = (
            np.zeros((count, most), dtype=np.int64),
            np.zeros((count, most), bool),
        )
        for t, own in enumerate(outcomes):
            g = len(own.names)
            self._contradiction[t, :g, :g] = own.contradiction
            said_again = np.eye(g, dtype=bool)
            self._change_odds[t, :g, :g] = np.where(said_again | own.stops_flashing, 1.0, config.change_odds)
            self._said_class_ids[t, :g] = [signals.class_ids[name.class_name] for name in own.names]
            self._said_flashing[t, :g] = [name.flashing for name in own.names]
        self._unseen = self._first_reports()
        self._reader = LookReader.of([hmm[name] for name in signals.types], signals.class_ids)
        self._missed = miss_likelihood(widest, self._reader.levels)
        self._types: IntArray = np.empty(0, dtype=np.int64)
        self._groups: IntArray = np.empty(0, dtype=np.int64)
        self._disputes = GroupDisputes(config.dispute_after_s)
        self._looked = np.empty(0, dtype=bool)
        self._alive = np.empty(0, dtype=bool)
        self._surely_seen = np.empty((0, widest))  # how surely a camera saw each class in this set
        self._class_count = len(signals.classes)
        self._pairs: IntArray = np.empty(0, dtype=np.int64)  # which two classes led in this set, −1 for none
        self._said: IntArray = np.empty(0, dtype=np.int64)  # outcome that was reported last, −1 for none
        nobody: IntArray = np.empty(0, dtype=np.int64)
        self._blocks = [BeliefBlock.fresh(model.filter, nobody, nobody) for model in self._models]
        self._line: LineUp | None = None
        self._now_ms: int | None = None

    def append(self, types: IntArray, groups: IntArray) -> None:
        """Take in new tracks; a group that is negative is none."""
        rows = len(self._types) + np.arange(len(types))
        self._types = np.concatenate([self._types, types])
        self._groups = np.concatenate([self._groups, groups])
        self._looked = np.concatenate([self._looked, np.zeros(len(types), dtype=bool)])
        self._alive = np.concatenate([self._alive, np.zeros(len(types), dtype=bool)])
        self._surely_seen = np.pad(self._surely_seen, ((0, len(types)), (0, 0)))
        self._said = np.concatenate([self._said, np.full(len(types), -1)])
        self._pairs = np.concatenate([self._pairs, np.full(len(types), -1)])
        self._disputes.append(len(types))
        self._begin(rows, types)

    def keep(self, rows: IntArray) -> None:
        """Forget all tracks but these, ascending."""
        place = np.full(len(self._types), -1)
        place[rows] = np.arange(len(rows))
        self._types, self._groups, self._looked = self._types[rows], self._groups[rows], self._looked[rows]
        self._alive, self._said, self._surely_seen = self._alive[rows], self._said[rows], self._surely_seen[rows]
        self._pairs = self._pairs[rows]
        self._disputes.keep(rows)
        self._replace({t: block.take(place[block.rows] >= 0) for t, block in enumerate(self._blocks)})
        for block in self._blocks:
            block.rows = place[block.rows]

    def start_anew(self, rows: IntArray, types: IntArray) -> None:
        """Forget what is known of some tracks' states; they may have other types now."""
        self._disputes.reset(rows)
        self._said[rows] = -1
        self._replace({t: block.take(~np.isin(block.rows, rows)) for t, block in enumerate(self._blocks)})
        self._types[rows] = types
        self._begin(rows, types)

    def _begin(self, rows: IntArray, types: IntArray) -> None:
        """Take in tracks of which nothing is known."""
        for t in np.unique(types).tolist():
            own = np.sort(rows[types == t])
            fresh = BeliefBlock.fresh(self._models[t].filter, own, self._groups[own])
            self._replace({t: self._blocks[t].join(fresh)})

    def merge(self, row: int, other: int, source: int) -> None:
        """Two tracks of one type are one light: see `LightStates.merge`."""
        group = self._groups[row] = self._groups[source]
        t = int(self._types[row])
        block = self._blocks[t]
        heard, *doubled = [one for one in (source, row + other - source) if one in block.rows] or [-1]
        if heard < 0:
            return
        kept = block.take(~np.isin(block.rows, doubled))
        rows = np.where(kept.rows == heard, row, kept.rows)
        merged = replace(kept, rows=rows, groups=np.where(rows == row, group, kept.groups))
        self._replace({t: merged.take(rows.argsort())})
        for column in (self._looked, self._said, self._pairs):
            column[row] = column[heard]
        self._disputes.take_over(row, heard)

    def let_time_pass(self, stamp_ns: int) -> None:
        """Predict to the stamp of a set of frames."""
        now_ms = round(stamp_ns / 1e6)
        elapsed_ms = 0 if self._now_ms is None else now_ms - self._now_ms
        self._now_ms = now_ms
        if elapsed_ms == 0:
            return
        for block in self._blocks:
            if len(block):
                block.predict(elapsed_ms)

    def take_in(self, looks: Sequence[Looks]) -> None:
        """Update by a set of frames, one entry for each camera.

        That a camera missed a light which another one saw says nothing about its state.
        """
        n, k, levels = len(self._types), self._reader.columns.shape[1], self._reader.levels
        said, reached = np.ones((n, k)), np.zeros((n, levels - 1, k))
        looked = self._looked = np.zeros(n, dtype=bool)
        surest = np.zeros((n, self._class_count))
        seen = [look for look in looks if len(look.rows)]
        if seen:
            # All cameras are read at once: each call costs more than its numbers.
            rows = np.concatenate([look.rows for look in seen])
            several = np.bincount(rows, minlength=n)[rows] > 1
            class_probs = np.concatenate([look.class_probs for look in seen])
            all_said, all_reached, alone = self._reader.read(class_probs, self._types[rows])
            all_said[several] += alone[several, None]
            start = 0
            for look in seen:
                here = slice(start, start + len(look.rows))
                said[look.rows] *= all_said[here]
                reached[look.rows] = np.maximum(reached[look.rows], all_reached[here])
                start = here.stop
            looked[rows] = True
            by_confidence = class_probs.max(axis=1).argsort(kind="stable")
            surest[rows[by_confidence]] = class_probs[by_confidence]
        self._surely_seen = reached[:, -1] if levels > 1 else np.zeros((n, k))
        likelihood = np.where(looked[:, None], seen_likelihood(said, reached), 1.0)
        for look in looks:
            if len(look.missed):
                likelihood[look.missed[~looked[look.missed]]] = self._missed
        line = self._line_up()
        new, leading = self._second_classes(surest, looked, line)
        likelihood = likelihood.take(line.rows, axis=0)
        for block, model, here in zip(self._blocks, self._models, line.slices, strict=True):
            if not len(block):
                continue
            factors = None
            if model.filter.second_if_wrong:
                telling = new[here].nonzero()[0]
                if len(telling):
                    vectors = leading[here].take(telling, axis=0)[:, : len(model.states)]
                    factors = telling, model.filter.seconds(vectors)
            block.update(likelihood[here].take(model.appearances, axis=1), factors)

    def _second_classes(self, surest: FloatArray, looked: BoolArray, line: LineUp) -> tuple[BoolArray, FloatArray]:
        """(m,) of whom the two leading classes are others than before, and (m, k) probabilities of its type's classes.

        While the leading two stay, they say nothing new.
        """
        rows = line.rows
        padded = np.zeros((len(rows), self._class_count + 1))
        padded[:, :-1] = surest.take(rows, axis=0)
        first_columns = padded.shape[1] * np.arange(len(rows))[:, None]
        leading = padded.take(self._reader.columns.take(self._types.take(rows), axis=0) + first_columns)
        pairs = np.where(looked.take(rows), leading_pairs(leading), -1)
        before, self._pairs = self._pairs.take(rows), np.full(len(looked), -1)
        self._pairs[rows] = pairs
        return (pairs >= 0) & (pairs != before), leading

    def _line_up(self) -> LineUp:
        if self._line is None:
            self._line = LineUp.of(self._blocks)
        return self._line

    def end_set(self, alive: BoolArray, over: BoolArray) -> None:
        """Say which tracks are alive: only these share evidence. Those whose past is over take no room from now on."""
        self._alive = alive
        if np.count_nonzero(over.take(self._line_up().rows)):
            self._replace({t: block.take(~over.take(block.rows)) for t, block in enumerate(self._blocks)})
        line = self._line_up()
        if not self._config.share_groups or (not line.grouped and line.partners is None):
            return
        lives, looked = alive.take(line.rows), self._looked.take(line.rows)
        self._disputes.judge(line.rows, line.mates, self._class_beliefs(line), lives & looked, self._now_ms or 0)
        may_join = lives & ~self._disputes.disputed.take(line.rows)
        if line.may_join is not None and np.array_equal(may_join, line.may_join):
            return
        together = may_join & (line.mates.total(may_join[:, None].astype(np.float64))[:, 0] > 1)
        self._replace({t: self._blocks[t].share_among(together[here]) for t, here in enumerate(line.slices)})
        self._line_up().may_join = may_join

    def _class_beliefs(self, line: LineUp) -> FloatArray:
        """(m, k) belief in each class of its type, from what was seen of each light itself."""
        beliefs = np.zeros((len(line.rows), self._reader.columns.shape[1]))
        for block, model, here in zip(self._blocks, self._models, line.slices, strict=True):
            if len(block):
                beliefs[here, : len(model.states)] = model.filter.states(block.own) @ model.class_membership
        return beliefs

    def _replace(self, blocks: Mapping[int, BeliefBlock]) -> None:
        """Blocks of these types have other tracks now, or share otherwise."""
        for t, block in blocks.items():
            self._blocks[t] = block
        self._line = None

    def report(self) -> Reports:
        """What is said of each track; of those of which nothing is remembered, what is likely before any look."""
        line = self._line_up()
        rows = line.rows
        types, said = self._types.take(rows), self._said.take(rows)
        mass = np.zeros((len(rows), self._contradiction.shape[1]))
        denials, surely = np.zeros(mass.shape), self._surely_seen.take(rows, axis=0)
        for block, model, here in zip(self._blocks, self._models, line.slices, strict=True):
            if len(block):
                names = slice(len(model.outcomes.names))
                mass[here, names] = model.filter.states(block.told) @ model.outcomes.membership
                denials[here, names] = surely[here, : len(model.states)] @ model.outcomes.denied_by
        denied = denials > _SURELY
        if line.partners is not None:  # what is surely seen of one light of a group is denied to all of them
            denied = line.partners.total(denied.astype(np.float64)) > 0
        choice = choose(
            mass,
            self._contradiction.take(types, axis=0),
            denied,
            said,
            self._change_odds[types, said],
            max_go_risk=self._config.max_go_risk,
            min_probability=self._config.min_probability,
        )
        self._said[:] = -1
        self._said[rows] = np.where(self._alive.take(rows), np.where(choice.doubtful, said, choice.outcome), -1)
        reports = self._unseen.take(self._types)
        reports.class_ids[rows] = self._said_class_ids[types, choice.outcome]
        reports.flashing[rows] = self._said_flashing[types, choice.outcome]
        reports.probability[rows] = choice.probability
        reports.doubtful[rows] = choice.doubtful
        reports.go_held[rows] = choice.go_held
        if line.partners is not None:
            reports.shares[rows] = np.concatenate([block.joined for block in self._blocks]) >= 0
        reports.disputed[:] = self._disputes.disputed
        return reports

    def explain(self, row: int) -> dict[str, Any]:
        """Belief in each class, each outcome, the stage of its phase, and how the detector sees the light."""
        t = int(self._types[row])
        model, block = self._models[t], self._blocks[t]
        slots = np.flatnonzero(block.rows == row).tolist()
        told: dict[str, Any] = model.explain(block.told[slots[0]]) if slots else {"belief": None}
        if self._groups[row] >= 0:
            told["group"] = {
                "shares": bool(slots) and bool(block.joined[slots[0]] >= 0),
                "disputed": bool(self._disputes.disputed[row]),
                "own_belief": model.explain(block.own[slots[0]])["belief"] if slots else None,
            }
        return told

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values."""
        return {
            "now_ms": self._now_ms,
            "groups": self._groups.tolist(),
            "disputes": self._disputes.to_json(),
            "said": self._said.tolist(),
            "pairs": self._pairs.tolist(),
            "blocks": [
                {
                    "rows": block.rows.tolist(),
                    "own": block.own.tolist(),
                    "shared": block.beliefs[1].tolist() if block.shares else None,
                    "joined": block.joined.tolist(),
                }
                for block in self._blocks
            ],
        }

    def restore(self, values: dict[str, Any], types: IntArray) -> None:
        """Remember what `to_json` gave.

        Raises:
            ValueError: If the beliefs do not have the shape that these types and settings ask for.
        """
        self._now_ms = values["now_ms"]
        self._types, self._groups = types, np.array(values["groups"], dtype=np.int64)
        self._looked, self._alive = np.zeros((2, len(types)), dtype=bool)
        self._said = np.array(values["said"], dtype=np.int64)
        self._pairs = np.array(values["pairs"], dtype=np.int64)
        self._surely_seen = np.zeros((len(types), self._reader.columns.shape[1]))
        self._disputes.restore(values["disputes"])
        blocks = []
        for t, saved in enumerate(values["blocks"]):
            own_filter, rows = self._models[t].filter, np.array(saved["rows"], dtype=np.int64)
            layers = [saved["own"]] if saved["shared"] is None else [saved["own"], saved["shared"]]
            beliefs = np.array(layers, dtype=np.float64).reshape(len(layers), len(rows), *own_filter.first.shape)
            joined = np.array(saved["joined"], dtype=np.int64)
            blocks.append(BeliefBlock(own_filter, rows, self._groups[rows], joined, beliefs))
        self._replace(dict(enumerate(blocks)))

    def _first_reports(self) -> Reports:
        """What is said of a light of each type before anybody has looked: it is not to be acted upon."""
        count = len(self._models)
        mass = [model.filter.chain.initial @ model.outcomes.membership for model in self._models]
        # Of things equally probable, rather one that stops somebody.
        go = [model.outcomes.contradiction.any(axis=1) for model in self._models]
        likely = np.array([(own - _TIE * says_go).argmax() for own, says_go in zip(mass, go, strict=True)])
        nowhere = np.zeros(count, dtype=bool)
        return Reports(
            class_ids=self._said_class_ids[np.arange(count), likely],
            flashing=self._said_flashing[np.arange(count), likely],
            probability=np.array([own[best] for own, best in zip(mass, likely.tolist(), strict=True)]),
            doubtful=~nowhere,
            go_held=nowhere,
            shares=nowhere,
            disputed=nowhere,
        )
