"""Vehicle poses: ``poses.csv``, one line per stamp."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from autolights.core import Pose
from autolights.core.atomic import write_text
from autolights.core.errors import DataError
from autolights.data.tables import read_csv

COLUMNS = ("stamp_ns", "x", "y", "z", "qx", "qy", "qz", "qw")


def load_poses(path: Path) -> tuple[Pose, ...]:
    """Read poses of `utm_from_ins` in the order of time.

    Raises:
        DataError: If the file is missing, a value is no number, stamps do not rise, a quaternion is none, or fewer
            than two poses are there (nothing could be interpolated).
    """
    poses: list[Pose] = []
    for number, row in read_csv(path, COLUMNS):
        try:
            values = np.array([float(text) for text in row[1:]])
            pose = Pose(int(row[0]), values[:3], values[3:])
        except ValueError as error:
            raise DataError(f"{path}:{number}: {error}; expected {', '.join(COLUMNS)}") from error
        if poses and pose.stamp_ns <= poses[-1].stamp_ns:
            raise DataError(
                f"{path}:{number}: stamps must rise, got {pose.stamp_ns} after {poses[-1].stamp_ns}; sort the file"
            )
        poses.append(pose)
    if len(poses) < 2:
        raise DataError(f"{path}: at least two poses are needed to interpolate between, got {len(poses)}")
    return tuple(poses)


def save_poses(path: Path, poses: Iterable[Pose]) -> None:
    """Write poses: metres with 4 decimals, quaternions with 9."""
    lines = [",".join(COLUMNS)]
    for pose in poses:
        position = ",".join(f"{value:.4f}" for value in pose.position)
        quaternion = ",".join(f"{value:.9f}" for value in pose.quaternion_xyzw)
        lines.append(f"{pose.stamp_ns},{position},{quaternion}")
    write_text(path, "\n".join(lines) + "\n")
