"""What the tracks know of their lights' states: the interface of the two modes, and what passes through it."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from autolights.core import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Looks:
    """What the images of one set showed of lights.

    Attributes:
        rows: (m,) tracks, each at most once in an image: known ones image by image, then new ones.
        class_probs: (m, C) of all classes.
        heights_px: (m,) of the boxes.
        missed: (j,) tracks that it should have seen and did not, as far as that says something about their state.
    """

    rows: IntArray
    class_probs: FloatArray
    heights_px: FloatArray
    missed: IntArray


@dataclass(frozen=True, eq=False)
class Reports:
    """What is said of n tracks.

    Attributes:
        class_ids: (n,) classes, in the detector's order.
        flashing: (n,) whether the indication flashes.
        probability: (n,) belief.
        doubtful: (n,) too doubtful to act upon.
        go_held: (n,) a "go" was more probable, but not certain enough.
        shares: (n,) what was seen of its signal group counts.
        disputed: (n,) it is at odds with the others of its group.
    """

    class_ids: IntArray
    flashing: BoolArray
    probability: FloatArray
    doubtful: BoolArray
    go_held: BoolArray
    shares: BoolArray
    disputed: BoolArray

    @classmethod
    def blank(cls, count: int) -> "Reports":
        """Room for so many tracks, to be written to."""
        flashing, doubtful, go_held, shares, disputed = np.empty((5, count), dtype=bool)
        return cls(np.empty(count, dtype=np.int64), flashing, np.empty(count), doubtful, go_held, shares, disputed)

    def take(self, rows: IntArray) -> "Reports":
        """What is said of these tracks."""
        return Reports(**{name: column[rows] for name, column in vars(self).items()})


class LightStates(Protocol):
    """The beliefs of all tracks: row i belongs to row i of the track table."""

    def append(self, types: IntArray, groups: IntArray) -> None:
        """Take in new tracks; a group that is negative is none."""

    def keep(self, rows: IntArray) -> None:
        """Forget all tracks but these."""

    def start_anew(self, rows: IntArray, types: IntArray) -> None:
        """Forget what is known of some tracks' states; they may have other types now."""

    def merge(self, row: int, other: int, source: int) -> None:
        """Two tracks of one type are one light, and the first stays.

        It gets the group of `source`, one of the two, and what is believed of that; where nothing is remembered of it,
        what is believed of the other one.
        """

    def let_time_pass(self, stamp_ns: int) -> None:
        """Predict to the stamp of a set of frames."""

    def take_in(self, looks: Looks) -> None:
        """Update by a set of frames."""

    def end_set(self, alive: BoolArray, over: BoolArray) -> None:
        """Say which tracks are alive, as the dead share nothing, and whose past is over: they will start anew."""

    def report(self) -> Reports:
        """What is said of each track."""

    def explain(self, row: int) -> dict[str, Any]:
        """What is behind the report of a track, as JSON-ready values."""

    def to_json(self) -> dict[str, Any]:
        """All that is remembered, as JSON-ready values."""

    def restore(self, values: dict[str, Any], types: IntArray) -> None:
        """Remember what `to_json` gave."""
