"""What is believed of all tracks in one array, and who of them shares evidence with whom."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from autolights.core import BoolArray, FloatArray, IntArray
from autolights.track.appearance_filter import AppearanceFilter, LightsByType
from autolights.track.signal_groups import Partners, share


@dataclass(eq=False)
class Beliefs:
    """The m tracks of which something is remembered, in the order of their types, then of the track table.

    Attributes:
        filter: Of all types.
        rows: (m,) of the track table.
        groups: (m,) signal group on the map; negative for none.
        joined: (m,) group with which a light shares evidence now; negative for none.
        array: (m, 1 or 2, c, K) from what was seen of each light itself, and, while any two lights share evidence, from
            what was seen of its group as well.
        lights: Their types.
        may_join: (m,) who may share evidence with the others of its group; None while nobody has asked.
        states: (m, 1 or 2, K) belief in each hidden state, whatever it looks like.
    """

    filter: AppearanceFilter
    rows: IntArray
    groups: IntArray
    joined: IntArray
    array: FloatArray
    lights: LightsByType
    may_join: BoolArray | None = None
    _states: FloatArray | None = None

    @classmethod
    def of(
        cls,
        own_filter: AppearanceFilter,
        rows: IntArray,
        types: IntArray,
        groups: IntArray,
        joined: IntArray,
        array: FloatArray,
    ) -> Self:
        """Lights in any order."""
        order = np.lexsort((rows, types))
        lights = own_filter.lights(types[order])
        return cls(own_filter, rows[order], groups[order], joined[order], array[order], lights)

    @classmethod
    def fresh(cls, own_filter: AppearanceFilter, rows: IntArray, types: IntArray, groups: IntArray) -> Self:
        """Lights as they are at first sight, in any order."""
        first = own_filter.first[types][:, None]
        return cls.of(own_filter, rows, types, groups, np.full(len(rows), -1), first)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def states(self) -> FloatArray:
        """See the class."""
        if self._states is None:
            self._states = self.filter.states(self.array)
        return self._states

    @property
    def own(self) -> FloatArray:
        """(m, c, K) from what was seen of each light itself."""
        return np.asarray(self.array[:, 0])

    @property
    def told(self) -> FloatArray:
        """(m, c, K) what reports are made of."""
        return np.asarray(self.array[:, -1])

    @property
    def shares(self) -> bool:
        """Whether any two lights share evidence."""
        return bool(self.array.shape[1] > 1)

    @cached_property
    def mates(self) -> Partners:
        """Who is of one group on the map."""
        return Partners.of(self.groups)

    @cached_property
    def grouped(self) -> bool:
        """Whether any two are."""
        return len(self.mates.starts) < len(self)

    @cached_property
    def partners(self) -> Partners | None:
        """Who shares evidence now; None if nobody."""
        return Partners.of(self.joined) if self.shares else None

    def take(self, slots: IntArray | BoolArray) -> "Beliefs":
        """These lights alone; slots ascend."""
        if slots.dtype == bool and slots.all():
            return self
        joined, array = self.joined[slots], self.array[slots]
        if self.shares and (joined < 0).all():
            array = array[:, :1].copy()
        lights = self.filter.lights(self.lights.types[slots])
        return Beliefs(self.filter, self.rows[slots], self.groups[slots], joined, array, lights)

    def join(self, more: "Beliefs") -> "Beliefs":
        """Both; the others share with nobody yet."""
        theirs = np.broadcast_to(more.array[:, :1], (len(more), *self.array.shape[1:]))
        return Beliefs.of(
            self.filter,
            np.concatenate([self.rows, more.rows]),
            np.concatenate([self.lights.types, more.lights.types]),
            np.concatenate([self.groups, more.groups]),
            np.concatenate([self.joined, more.joined]),
            np.concatenate([self.array, theirs]),
        )

    def moved(self, rows: IntArray, groups: IntArray) -> "Beliefs":
        """The same lights in other rows of the track table, of these groups."""
        return Beliefs.of(self.filter, rows, self.lights.types, groups, self.joined, self.array)

    def predict(self, elapsed_ms: int) -> None:
        """Let time pass, if any does."""
        if elapsed_ms:
            self.array, self._states = self.filter.predict(self.array, self.lights, elapsed_ms)
        else:
            self._states = None  # summed up anew, as by whoever restores these beliefs

    def update(self, likelihood: FloatArray, seconds: tuple[IntArray, IntArray, FloatArray] | None) -> None:
        """Take in what cameras saw at one instant: see `AppearanceFilter.update`."""
        self.array, self._states = self.filter.update(
            self.array, self.states, self.lights, likelihood, self.partners, seconds
        )

    def share_among(self, may_join: BoolArray) -> "Beliefs":
        """Let those (m,) lights share evidence with the others of their groups that may."""
        if self.may_join is not None and not np.count_nonzero(may_join != self.may_join):
            return self
        together = may_join & (self.mates.total(may_join[:, None].astype(np.float64))[:, 0] > 1)
        joined = np.where(together, self.groups, -1)
        if np.array_equal(joined, self.joined):
            self.may_join = may_join
            return self
        layers = [self.own]
        if together.any():
            shared = self.told if self.shares else None
            layers.append(share(self.own, shared, self.joined, joined, self.lights.initial))
        return replace(self, joined=joined, array=np.stack(layers, axis=1), may_join=may_join, _states=None)
