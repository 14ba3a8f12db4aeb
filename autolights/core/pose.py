"""Where the vehicle is: poses, and the pose at an exact stamp between two of them."""

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from autolights.core.arrays import FloatArray, as_float_array
from autolights.core.errors import PoseError
from autolights.core.transforms import matrix_from_quaternion, rigid, slerp


@dataclass(frozen=True, eq=False)
class Pose:
    """The vehicle frame in the map frame at one instant.

    Attributes:
        stamp_ns: Integer nanoseconds.
        position: (3,) east, north, up in metres (UTM).
        quaternion_xyzw: (4,) rotation of `utm_from_ins`, normalised here.
    """

    stamp_ns: int
    position: FloatArray
    quaternion_xyzw: FloatArray

    def __post_init__(self) -> None:
        quaternion = as_float_array(self.quaternion_xyzw, (4,), "quaternion_xyzw")
        length = float(np.linalg.norm(quaternion))
        if not 0.9 < length < 1.1:
            raise ValueError(f"quaternion_xyzw must have length 1, got {length:.3g}")
        object.__setattr__(self, "position", as_float_array(self.position, (3,), "position"))
        object.__setattr__(self, "quaternion_xyzw", quaternion / length)

    @cached_property
    def utm_from_ins(self) -> FloatArray:
        """(4, 4) vehicle frame to map frame."""
        matrix = rigid(matrix_from_quaternion(self.quaternion_xyzw), self.position)
        matrix.flags.writeable = False
        return matrix


class PoseBuffer:
    """Poses in the order of time, interpolated at an image's own stamp.

    Position is interpolated linearly, rotation along the great arc (the paper's pose interpolation, Sec. III-B).

    Args:
        poses: Initial poses, in any order; of those with equal stamps the last one counts.
        max_gap_s: Two neighbours farther apart than this are not interpolated between.
        max_extrapolation_s: How far beyond the first or last pose the motion is continued; 0 forbids it.
        history_s: Poses older than this before the newest are forgotten; None keeps all.
    """

    def __init__(
        self,
        poses: Iterable[Pose] = (),
        *,
        max_gap_s: float = 0.2,
        max_extrapolation_s: float = 0.05,
        history_s: float | None = None,
    ) -> None:
        by_stamp = {pose.stamp_ns: pose for pose in poses}
        self._stamps_ns = sorted(by_stamp)
        self._poses = [by_stamp[stamp_ns] for stamp_ns in self._stamps_ns]
        self._max_gap_ns = round(max_gap_s * 1e9)
        self._max_extrapolation_ns = round(max_extrapolation_s * 1e9)
        self._history_ns = None if history_s is None else round(history_s * 1e9)

    def __len__(self) -> int:
        return len(self._poses)

    def add(self, pose: Pose) -> None:
        """Take in one pose; late ones find their place, one with a known stamp replaces the old one.

        One that is older than all that `history_s` keeps tells that the clock was set back: the buffer begins anew.
        """
        stamps_ns, history_ns = self._stamps_ns, self._history_ns
        if history_ns is not None and stamps_ns and pose.stamp_ns < stamps_ns[-1] - history_ns:
            self._forget(len(stamps_ns))
        i = bisect_left(stamps_ns, pose.stamp_ns)
        if i < len(stamps_ns) and stamps_ns[i] == pose.stamp_ns:
            self._poses[i] = pose
        else:
            stamps_ns.insert(i, pose.stamp_ns)
            self._poses.insert(i, pose)
        if history_ns is not None and stamps_ns[0] < stamps_ns[-1] - history_ns:
            self._forget(bisect_left(stamps_ns, stamps_ns[-1] - history_ns))

    def _forget(self, count: int) -> None:
        """The oldest."""
        del self._stamps_ns[:count], self._poses[:count]

    def at(self, stamp_ns: int) -> Pose:
        """The pose at exactly this stamp.

        Raises:
            PoseError: If there are no poses, the stamp lies too far outside them, or in too wide a gap.
        """
        poses, stamps_ns = self._poses, self._stamps_ns
        if not poses:
            raise PoseError(f"no pose at stamp {stamp_ns}: no poses have arrived")
        i = bisect_left(stamps_ns, stamp_ns)
        if i < len(poses) and stamps_ns[i] == stamp_ns:
            return poses[i]
        outside_ns = max(stamps_ns[0] - stamp_ns, stamp_ns - stamps_ns[-1])
        if outside_ns > self._max_extrapolation_ns or (outside_ns > 0 and len(poses) < 2):
            raise PoseError(
                f"no pose at stamp {stamp_ns}: poses cover {stamps_ns[0]} to {stamps_ns[-1]}, "
                f"which it misses by {outside_ns / 1e9:.3f} s (allowed: {self._max_extrapolation_ns / 1e9:.3f} s)"
            )
        i = min(max(i, 1), len(poses) - 1)
        before, after = poses[i - 1], poses[i]
        gap_ns = after.stamp_ns - before.stamp_ns
        if gap_ns > self._max_gap_ns:
            raise PoseError(
                f"no pose at stamp {stamp_ns}: the poses around it are {gap_ns / 1e9:.3f} s apart "
                f"(allowed: {self._max_gap_ns / 1e9:.3f} s)"
            )
        return _between(before, after, stamp_ns)


def _between(before: Pose, after: Pose, stamp_ns: int) -> Pose:
    """Two poses are checked already, and what lies between them needs no check."""
    fraction = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    position = before.position + fraction * (after.position - before.position)
    quaternion = slerp(before.quaternion_xyzw, after.quaternion_xyzw, fraction)
    position.flags.writeable = quaternion.flags.writeable = False
    pose = object.__new__(Pose)
    pose.__dict__.update(stamp_ns=stamp_ns, position=position, quaternion_xyzw=quaternion)
    return pose
