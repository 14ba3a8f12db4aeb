"""How frames arrive: some are lost, some late and out of order, and a camera may stop."""

from collections.abc import Sequence

import numpy as np

from autolights.data import FrameRecord
from autolights.suite.config import ScenarioConfig


def arrival(
    sets: Sequence[Sequence[FrameRecord]], scenario: ScenarioConfig, cameras: Sequence[str], rng: np.random.Generator
) -> tuple[tuple[FrameRecord, ...], ...]:
    """Sets of frames in the order of their arrival.

    Lost frames are gone. Late ones come alone, `late_sets` sets later; the first camera is never late.

    Args:
        sets: As they were exposed.
        scenario: What is lost and late.
        cameras: Names, in their order in the rig.
        rng: Decides which.
    """
    arrived: list[list[FrameRecord]] = []
    late: list[tuple[int, FrameRecord]] = []
    for number, exposed in enumerate(sets):
        frames = []
        for frame in exposed:
            lost, delayed = rng.random(2)
            dead = frame.camera == scenario.dead_camera and number >= len(sets) / 2
            if lost < scenario.dropped_share or dead:
                continue
            if frame.camera != cameras[0] and delayed < scenario.late_share:
                late.append((number + scenario.late_sets, frame))
            else:
                frames.append(frame)
        if frames:
            arrived.append(frames)
        arrived += [[frame] for due, frame in late if due == number]
    return tuple(tuple(frames) for frames in arrived)


def in_time(sets: Sequence[Sequence[FrameRecord]]) -> set[tuple[str, int]]:
    """(camera, stamp_ns) of the frames of sets that are not older than one before: nobody asks about the past."""
    newest_ns = 0
    keys: set[tuple[str, int]] = set()
    for frames in sets:
        set_ns = max(frame.stamp_ns for frame in frames)
        if set_ns >= newest_ns:
            keys |= {(frame.camera, frame.stamp_ns) for frame in frames}
            newest_ns = set_ns
    return keys
