"""The beliefs of all tracks of one type in one array, and who of all tracks shares evidence with whom."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np

from autolights.core import BoolArray, FloatArray, IntArray
from autolights.track.appearance_filter import AppearanceFilter
from autolights.track.signal_groups import Partners, share


@dataclass(eq=False)
class BeliefBlock:
    """The n tracks of one type of which something is remembered.

    Attributes:
        filter: Of the type.
        rows: (n,) of the track table, ascending.
        groups: (n,) signal group on the map; negative for none.
        joined: (n,) group with which a light shares evidence now; negative for none.
        beliefs: (1 or 2, n, c, K) from what was seen of each light itself, and, while any two lights share evidence,
            from what was seen of its group as well.
    """

    filter: AppearanceFilter
    rows: IntArray
    groups: IntArray
    joined: IntArray
    beliefs: FloatArray

    @classmethod
    def fresh(cls, own_filter: AppearanceFilter, rows: IntArray, groups: IntArray) -> Self:
        """Lights as they are at first sight."""
        beliefs = np.broadcast_to(own_filter.first, (1, len(rows), *own_filter.first.shape)).copy()
        return cls(own_filter, rows, groups, np.full(len(rows), -1), beliefs)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def own(self) -> FloatArray:
        """(n, c, K) from what was seen of each light itself."""
        return np.asarray(self.beliefs[0])

    @property
    def told(self) -> FloatArray:
        """(n, c, K) what reports are made of."""
        return np.asarray(self.beliefs[-1])

    @property
    def shares(self) -> bool:
        """Whether any two lights share evidence."""
        return len(self.beliefs) > 1

    @cached_property
    def partners(self) -> Partners:
        """Who shares evidence now."""
        return Partners.of(self.joined)

    def take(self, slots: IntArray | BoolArray) -> "BeliefBlock":
        """These lights alone."""
        if slots.dtype == bool and slots.all():
            return self
        joined, beliefs = self.joined[slots], self.beliefs[:, slots]
        if self.shares and (joined < 0).all():
            beliefs = beliefs[:1]
        return BeliefBlock(self.filter, self.rows[slots], self.groups[slots], joined, beliefs)

    def join(self, more: "BeliefBlock") -> "BeliefBlock":
        """Both, by ascending rows; the others share with nobody yet."""
        rows = np.concatenate([self.rows, more.rows])
        order = np.argsort(rows)
        theirs = np.broadcast_to(more.own, (len(self.beliefs), *more.own.shape))
        return BeliefBlock(
            self.filter,
            rows[order],
            np.concatenate([self.groups, more.groups])[order],
            np.concatenate([self.joined, more.joined])[order],
            np.concatenate([self.beliefs, theirs], axis=1)[:, order],
        )

    def predict(self, elapsed_ms: int) -> None:
        """Let time pass."""
        shape = self.beliefs.shape
        self.beliefs = self.filter.predict(self.beliefs.reshape(-1, *shape[2:]), elapsed_ms).reshape(shape)

    def update(self, likelihood: FloatArray, factors: tuple[IntArray, FloatArray] | None) -> None:
        """Take in what cameras saw at one instant: see `AppearanceFilter.update`."""
        before = self.beliefs
        self.beliefs = self.filter.weigh(before, likelihood, factors)
        self.filter.settle(self.own, likelihood)
        if self.shares:
            self.filter.settle_together(before[1], self.beliefs[1], self.partners)

    def share_among(self, together: BoolArray) -> "BeliefBlock":
        """Let those (n,) lights share evidence with the others of their groups."""
        joined = np.where(together, self.groups, -1)
        if np.array_equal(joined, self.joined):
            return self
        layers, shared = [self.own], self.beliefs[1] if self.shares else None
        if together.any():
            layers.append(share(self.own, shared, self.joined, joined, self.filter.chain.initial))
        return replace(self, joined=joined, beliefs=np.stack(layers))


@dataclass(eq=False)
class LineUp:
    """The m tracks of which something is remembered, block by block.

    Attributes:
        rows: (m,) of the track table.
        slices: Of each block.
        mates: Who is of one group on the map.
        grouped: Whether any two are.
        may_join: (m,) who may share evidence with its mates; None while nobody has asked.
        partners: Who does; None if nobody.
    """

    rows: IntArray
    slices: tuple[slice, ...]
    mates: Partners
    grouped: bool
    may_join: BoolArray | None
    partners: Partners | None

    @classmethod
    def of(cls, blocks: Sequence[BeliefBlock]) -> Self:
        """The tracks of these blocks."""
        bounds = np.cumsum([0, *map(len, blocks)]).tolist()
        groups, joined = (np.concatenate([getattr(block, name) for block in blocks]) for name in ("groups", "joined"))
        mates = Partners.of(groups)
        return cls(
            rows=np.concatenate([block.rows for block in blocks]),
            slices=tuple(slice(*bound) for bound in pairwise(bounds)),
            mates=mates,
            grouped=len(mates.starts) < len(groups),
            may_join=None,
            partners=Partners.of(joined) if any(block.shares for block in blocks) else None,
        )
