"""Mode ``timed``: what is believed of all tracks, moved through time, updated and read in arrays."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from autolights.core import BoolArray, FloatArray, HmmParameters, IntArray, SignalSet
from autolights.track.appearance_filter import AppearanceFilter
from autolights.track.beliefs import Beliefs
from autolights.track.config import TrackConfig
from autolights.track.look_reader import LookReader, leading_pairs, miss_likelihood, seen_likelihood
from autolights.track.outcomes import choose
from autolights.track.signal_groups import GroupDisputes
from autolights.track.states import Looks, Reports
from autolights.track.type_model import OutcomeTables, TypeModel

_TIE = 1e-6  # of probability
_SURELY = 0.5  # how far the highest level of certainty is reached
_DTYPE = np.float32  # of beliefs


class TimedStates:
    """Beliefs of all tracks: hidden states with dwell times, and how the detector sees them.

    Args:
        signals: The signal description.
        hmm: One model per type.
        config: Of tracking.
    """

    def __init__(self, signals: SignalSet, hmm: Mapping[str, HmmParameters], config: TrackConfig) -> None:
        self._config = config
        params = [hmm[name] for name in signals.types]
        self._widest = max(len(own.states) for own in params)
        self._reader = LookReader.of(params, signals.class_ids)
        self._missed = miss_likelihood(self._widest, self._reader.levels)
        self._models = [TypeModel.of(name, signals, hmm[name], config) for name in signals.types]
        chains = [model.chain for model in self._models]
        self._filter = AppearanceFilter.of(chains, params, error_duration_s=config.error_duration_s, dtype=_DTYPE)
        self._tables = OutcomeTables.of(self._models, signals, config, dtype=_DTYPE)
        self._unseen = self._first_reports()
        nobody: IntArray = np.empty(0, dtype=np.int64)
        self._types = self._groups = nobody
        self._disputes = GroupDisputes(config.dispute_after_s)
        self._looked = self._alive = np.empty(0, dtype=bool)
        self._surely_seen = np.empty((0, self._widest))  # how surely a camera saw each class in this set
        self._pairs = nobody  # which two classes led in this set, −1 for none
        self._said = nobody  # outcome that was reported last, −1 for none
        self._beliefs = Beliefs.fresh(self._filter, nobody, nobody, nobody)
        self._tables_for: tuple[IntArray, OutcomeTables] | None = None
        self._now_ms: int | None = None

    def append(self, types: IntArray, groups: IntArray) -> None:
        """Take in new tracks; a group that is negative is none."""
        rows = len(self._types) + np.arange(len(types))
        self._types = np.concatenate([self._types, types])
        self._groups = np.concatenate([self._groups, groups])
        self._looked = np.concatenate([self._looked, np.zeros(len(types), dtype=bool)])
        self._alive = np.concatenate([self._alive, np.zeros(len(types), dtype=bool)])
        self._surely_seen = np.concatenate([self._surely_seen, np.zeros((len(types), self._widest))])
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
        kept = self._beliefs.take(place[self._beliefs.rows] >= 0)
        self._beliefs = kept.moved(place[kept.rows], kept.groups)

    def start_anew(self, rows: IntArray, types: IntArray) -> None:
        """Forget what is known of some tracks' states; they may have other types now."""
        self._disputes.reset(rows)
        self._said[rows] = -1
        self._beliefs = self._beliefs.take(~np.isin(self._beliefs.rows, rows))
        self._types[rows] = types
        self._begin(rows, types)

    def _begin(self, rows: IntArray, types: IntArray) -> None:
        """Take in tracks of which nothing is known."""
        self._beliefs = self._beliefs.join(Beliefs.fresh(self._filter, rows, types, self._groups[rows]))

    def merge(self, row: int, other: int, source: int) -> None:
        """Two tracks of one type are one light: see `LightStates.merge`."""
        group = self._groups[row] = self._groups[source]
        beliefs = self._beliefs
        heard, *doubled = [one for one in (source, row + other - source) if one in beliefs.rows] or [-1]
        if heard < 0:
            return
        kept = beliefs.take(~np.isin(beliefs.rows, doubled))
        rows = np.where(kept.rows == heard, row, kept.rows)
        self._beliefs = kept.moved(rows, np.where(rows == row, group, kept.groups))
        for column in (self._looked, self._said, self._pairs):
            column[row] = column[heard]
        self._disputes.take_over(row, heard)

    def let_time_pass(self, stamp_ns: int) -> None:
        """Predict to the stamp of a set of frames."""
        now_ms = round(stamp_ns / 1e6)
        elapsed_ms = 0 if self._now_ms is None else now_ms - self._now_ms
        self._now_ms = now_ms
        if len(self._beliefs):
            self._beliefs.predict(elapsed_ms)

    def take_in(self, looks: Looks) -> None:
        """Update by a set of frames.

        That a camera missed a light which another one saw says nothing about its state.
        """
        n, beliefs = len(self._types), self._beliefs
        looked = self._looked = np.zeros(n, dtype=bool)
        self._surely_seen = np.zeros((n, self._widest))
        likelihood, leading = np.empty((n, len(self._missed))), None
        likelihood.fill(1.0)
        if len(looks.rows):
            order = looks.rows.argsort(kind="stable")
            rows, class_probs = looks.rows.take(order), looks.class_probs.take(order, axis=0)
            begins = np.empty(len(rows), dtype=bool)  # whether a look is the first of its track
            begins[0] = True
            np.not_equal(rows[1:], rows[:-1], out=begins[1:])
            starts = begins.nonzero()[0]
            seen = rows.take(starts)
            looked[seen] = True
            said, reached, alone, own = self._reader.read(class_probs, self._types.take(rows))
            several = np.bincount(rows).take(rows) > 1
            said += (alone * several)[:, None]
            said, reached = np.multiply.reduceat(said, starts), np.maximum.reduceat(reached, starts)
            likelihood[seen] = seen_likelihood(said, reached)
            if self._reader.levels > 1:
                self._surely_seen[seen] = reached[:, -1]
            by_confidence = np.maximum.reduce(own, axis=1).argsort(kind="stable")
            surest = np.zeros(n, dtype=np.int64)
            surest[rows.take(by_confidence)] = by_confidence
            leading = own.take(surest.take(beliefs.rows), axis=0)
        if len(looks.missed):
            likelihood[looks.missed[~looked[looks.missed]]] = self._missed
        if not len(beliefs):
            self._pairs = np.full(n, -1)
            return
        beliefs.update(likelihood.take(beliefs.rows, axis=0), self._second_classes(leading, looked))

    def _second_classes(
        self, leading: FloatArray | None, looked: BoolArray
    ) -> tuple[IntArray, IntArray, FloatArray] | None:
        """Whose second class says something new, and what, for `Beliefs.update`; None if nobody's does.

        While the leading two stay as they were, they say nothing new.

        Args:
            leading: (m, k) what the surest camera says of each light that was looked at; None if none was.
            looked: (n,) at which tracks.
        """
        rows, types = self._beliefs.rows, self._beliefs.lights.types
        before, self._pairs = self._pairs.take(rows), np.full(len(looked), -1)
        if leading is None:
            return None
        pairs = np.where(looked.take(rows), leading_pairs(leading), -1)
        self._pairs[rows] = pairs
        new = (pairs >= 0) & (pairs != before) & (self._filter.second_if_wrong.take(types) > 0)
        telling = new.nonzero()[0]
        if not len(telling):
            return None
        return telling, *self._filter.seconds(leading.take(telling, axis=0), types.take(telling))

    def end_set(self, alive: BoolArray, over: BoolArray) -> None:
        """Say which tracks are alive: only these share evidence. Those whose past is over take no room from now on."""
        self._alive = alive
        gone = over.take(self._beliefs.rows)
        if np.count_nonzero(gone):
            self._beliefs = self._beliefs.take(~gone)
        beliefs = self._beliefs
        if not self._config.share_groups or not (beliefs.grouped or beliefs.shares):
            return
        rows = beliefs.rows
        lives, looked = alive.take(rows), self._looked.take(rows)
        of_classes = (beliefs.states[:, :1] @ self._tables_of_lights().class_membership)[:, 0]
        self._disputes.judge(rows, beliefs.mates, of_classes, lives & looked, self._now_ms or 0)
        self._beliefs = beliefs.share_among(lives & ~self._disputes.disputed.take(rows))

    def _tables_of_lights(self) -> OutcomeTables:
        """How to read each light's belief, made anew when the lights are others."""
        types = self._beliefs.lights.types
        if self._tables_for is None or self._tables_for[0] is not types:
            self._tables_for = types, self._tables.take(types)
        return self._tables_for[1]

    def report(self) -> Reports:
        """What is said of each track; of those of which nothing is remembered, what is likely before any look."""
        beliefs, said = self._beliefs, self._said
        all_remembered = len(beliefs) == len(said)
        reports = Reports.blank(len(said)) if all_remembered else self._unseen.take(self._types)
        reports.disputed[:] = self._disputes.disputed
        self._said = np.full(len(said), -1)
        if not len(beliefs):
            return reports
        rows, tables = beliefs.rows, self._tables_of_lights()
        said = said.take(rows)
        denials = (self._surely_seen.take(rows, axis=0)[:, None] @ tables.denied_by)[:, 0]
        denied = denials > _SURELY
        if beliefs.partners is not None:  # what is surely seen of one light of a group is denied to all of them
            denied = beliefs.partners.total(denied.astype(np.float64)) > 0
        every = np.arange(len(rows))
        choice = choose(
            (beliefs.states[:, -1:] @ tables.membership)[:, 0],
            tables.contradiction,
            denied,
            said,
            tables.change_odds[every, said],
            max_go_risk=self._config.max_go_risk,
            min_probability=self._config.min_probability,
        )
        self._said[rows] = np.where(self._alive.take(rows), np.where(choice.doubtful, said, choice.outcome), -1)
        reports.class_ids[rows] = tables.class_ids[every, choice.outcome]
        reports.flashing[rows] = tables.flashing[every, choice.outcome]
        reports.probability[rows] = np.minimum(choice.probability, 1.0)  # rounded, a certainty may be more
        reports.doubtful[rows] = choice.doubtful
        reports.go_held[rows] = choice.go_held
        reports.shares[rows] = beliefs.joined >= 0
        return reports

    def explain(self, row: int) -> dict[str, Any]:
        """Belief in each class, each outcome, the stage of its phase, and how the detector sees the light."""
        model, beliefs = self._models[int(self._types[row])], self._beliefs
        own_part = model.own_part(self._widest)
        slots = np.flatnonzero(beliefs.rows == row).tolist()
        told: dict[str, Any] = model.explain(beliefs.told[slots[0]][own_part]) if slots else {"belief": None}
        if self._groups[row] >= 0:
            told["group"] = {
                "shares": bool(slots) and bool(beliefs.joined[slots[0]] >= 0),
                "disputed": bool(self._disputes.disputed[row]),
                "own_belief": model.explain(beliefs.own[slots[0]][own_part])["belief"] if slots else None,
            }
        return told

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values."""
        beliefs = self._beliefs
        parts = [model.own_part(self._widest) for model in self._models]
        types = beliefs.lights.types.tolist()
        return {
            "now_ms": self._now_ms,
            "groups": self._groups.tolist(),
            "disputes": self._disputes.to_json(),
            "said": self._said.tolist(),
            "pairs": self._pairs.tolist(),
            "rows": beliefs.rows.tolist(),
            "joined": beliefs.joined.tolist(),
            "beliefs": [
                [layer[parts[t]].tolist() for layer in light] for t, light in zip(types, beliefs.array, strict=True)
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
        self._surely_seen = np.zeros((len(types), self._widest))
        self._disputes.restore(values["disputes"])
        rows, joined = (np.array(values[name], dtype=np.int64) for name in ("rows", "joined"))
        layers = max(map(len, values["beliefs"]), default=1)
        array = np.zeros((len(rows), layers, *self._filter.first.shape[1:]), _DTYPE)
        for light, t, saved in zip(array, types[rows].tolist(), values["beliefs"], strict=True):
            own_part = self._models[t].own_part(self._widest)
            for layer, belief in zip(light, saved, strict=True):
                layer[own_part] = np.array(belief, dtype=_DTYPE).reshape(layer[own_part].shape)
        self._beliefs = Beliefs.of(self._filter, rows, types[rows], self._groups[rows], joined, array)

    def _first_reports(self) -> Reports:
        """What is said of a light of each type before anybody has looked: it is not to be acted upon."""
        count = len(self._models)
        mass = [model.chain.initial @ model.outcomes.membership for model in self._models]
        # Of things equally probable, rather one that stops somebody.
        go = [model.outcomes.contradiction.any(axis=1) for model in self._models]
        likely = np.array([(own - _TIE * says_go).argmax() for own, says_go in zip(mass, go, strict=True)])
        nowhere = np.zeros(count, dtype=bool)
        return Reports(
            class_ids=self._tables.class_ids[np.arange(count), likely],
            flashing=self._tables.flashing[np.arange(count), likely],
            probability=np.array([own[best] for own, best in zip(mass, likely.tolist(), strict=True)]),
            doubtful=~nowhere,
            go_held=nowhere,
            shares=nowhere,
            disputed=nowhere,
        )
