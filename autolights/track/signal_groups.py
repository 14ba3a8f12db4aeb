"""Lights that show the same phase: they share evidence, unless what is seen of them says that they do not."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from autolights.core import BoolArray, FloatArray, IntArray, TrafficLightMap

_NEVER = 1e-30  # probability of what nothing speaks for
_AGREE, _DISAGREE = 0.5, 0.1  # probability that a light and its mates show one class


def group_numbers(lights: TrafficLightMap) -> IntArray:
    """(n,) number of each light's signal group; −1 for a light that shows its phase alone or names no group.

    Only lights of one intersection, group and type show the same: an approach may have arrows beside its balls.
    """
    members: dict[tuple[str, str, str], list[int]] = {}
    for row, key in enumerate(zip(lights.intersections, lights.groups, lights.types, strict=True)):
        if key[1]:
            members.setdefault(key, []).append(row)
    numbers = np.full(len(lights), -1, dtype=np.int64)
    for number, rows in enumerate(rows for rows in members.values() if len(rows) > 1):
        numbers[rows] = number
    return numbers


def share(
    own: FloatArray, shared: FloatArray | None, before: IntArray, after: IntArray, initial: FloatArray
) -> FloatArray:
    """Beliefs of lights that join and leave groups of evidence.

    A new group believes what all its lights have seen, each counted once against what was known before any of them.
    Who joins later takes over the group's belief in the state. Given the state, all keep their own belief in their
    appearance.

    Args:
        own: (n, c, K) from each light itself.
        shared: (n, c, K) from its group until now; None if there was none.
        before: (n,) group until now; negative for none.
        after: (n,) from now on.
        initial: (n, K) belief in each hidden state before anything was seen; 0 where a light's type has none.
    """
    fresh = own.copy()
    for group in np.unique(after[after >= 0]):
        members = np.flatnonzero(after == group)
        old = members[before[members] == group] if shared is not None else members[:0]
        if shared is not None and len(old):
            fresh[old] = shared[old]
            state = shared[old[0]].sum(axis=0)
        else:
            before_all = initial[members[0]]
            told = np.maximum(own[members].sum(axis=1), _NEVER) / np.where(before_all > 0, before_all, 1.0)
            evidence = np.log(told).sum(axis=0)
            state = before_all * np.exp(evidence - evidence.max())
            state /= state.sum()
        joining = np.setdiff1d(members, old)
        marginals = own[joining].sum(axis=1)
        factors = np.divide(state, marginals, out=np.zeros_like(marginals), where=marginals > _NEVER)
        fresh[joining] = own[joining] * factors[:, None]
    return fresh


@dataclass(frozen=True, eq=False)
class Partners:
    """Which of n lights share evidence.

    Attributes:
        codes: (n,) number of each light's group, 0 to g − 1; a light that shares with nobody has one of its own.
        order: (n,) lights by group.
        starts: (g,) where each group begins in `order`.
    """

    codes: IntArray
    order: IntArray
    starts: IntArray

    @classmethod
    def of(cls, joined: IntArray) -> Self:
        """From (n,) numbers of groups, negative for none."""
        keys = np.where(joined < 0, -1 - np.arange(len(joined)), joined)
        _, codes, counts = np.unique(keys, return_inverse=True, return_counts=True)
        return cls(codes, np.argsort(codes, kind="stable"), np.cumsum(counts) - counts)

    def total(self, values: FloatArray) -> FloatArray:
        """(n, k) sums of (n, k) values over each light's group."""
        return np.asarray(np.add.reduceat(values.take(self.order, axis=0), self.starts).take(self.codes, axis=0))


class GroupDisputes:
    """Which lights are at odds with their group, from their own beliefs alone.

    A light is disputed once its belief has contradicted that of its mates for `after_s` without a break, and is so
    until they agree. In a pair nobody knows who is right, so both are.

    Args:
        after_s: Longer than a detector's errors last.
    """

    def __init__(self, after_s: float) -> None:
        self._after_ms = after_s * 1000
        self._since_ms = np.empty(0, dtype=np.int64)
        self.disputed = np.empty(0, dtype=bool)
        self._all_agree = True  # nobody is at odds with anybody, nor has begun to be

    def append(self, count: int) -> None:
        """Take in new tracks."""
        self._since_ms = np.concatenate([self._since_ms, np.full(count, -1)])
        self.disputed = np.concatenate([self.disputed, np.zeros(count, dtype=bool)])

    def keep(self, rows: IntArray) -> None:
        """Forget all tracks but these."""
        self._since_ms, self.disputed = self._since_ms[rows], self.disputed[rows]

    def reset(self, rows: IntArray) -> None:
        """Forget disputes of some tracks."""
        self._since_ms[rows], self.disputed[rows] = -1, False

    def take_over(self, row: int, source: int) -> None:
        """What is held against the second track is held against the first."""
        self._since_ms[row], self.disputed[row] = self._since_ms[source], self.disputed[source]

    def judge(self, rows: IntArray, mates: Partners, beliefs: FloatArray, seen: BoolArray, now_ms: int) -> None:
        """Compare lights with those of their groups.

        Args:
            rows: (n,) tracks.
            mates: Who is of one group on the map.
            beliefs: (n, k) in each class, from each light's own looks.
            seen: (n,) whether a light lives and was seen in this set; who is not is neither judged nor heard.
            now_ms: Of this set.
        """
        heard = np.empty((len(rows), beliefs.shape[1] + 1))
        heard[:, 0] = seen
        np.multiply(beliefs, seen[:, None], out=heard[:, 1:])
        others = mates.total(heard) - heard
        same = np.add.reduce(heard[:, 1:] * others[:, 1:], axis=1) / np.maximum(others[:, 0], 1)
        judged = seen & (others[:, 0] > 0.5)
        odd = judged & (same < _DISAGREE)
        if self._all_agree and not np.count_nonzero(odd):
            return
        since_ms = self._since_ms.take(rows)
        since_ms = np.where(odd, np.where(since_ms < 0, now_ms, since_ms), since_ms)
        since_ms[~judged | (same > _AGREE)] = -1
        self._since_ms[rows] = since_ms
        agreed, long_odd = judged & (same > _AGREE), odd & (now_ms - since_ms >= self._after_ms)
        self.disputed[rows] = (self.disputed.take(rows) & ~agreed) | long_odd
        self._all_agree = bool((self._since_ms < 0).all() and not self.disputed.any())

    def to_json(self) -> dict[str, Any]:
        """All that is remembered."""
        return {"since_ms": self._since_ms.tolist(), "disputed": self.disputed.tolist()}

    def restore(self, values: dict[str, Any]) -> None:
        """Remember what `to_json` gave."""
        self._since_ms = np.array(values["since_ms"], dtype=np.int64)
        self.disputed = np.array(values["disputed"], dtype=bool)
        self._all_agree = False  # until they are judged
