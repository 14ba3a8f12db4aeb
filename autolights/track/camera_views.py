"""Which images of one set show which tracks, as users of estimates read it."""

from functools import partial
from operator import itemgetter
from typing import Any

from autolights.core import CameraView, FloatArray, IntArray
from autolights.core.shots import Shots

_VIEW = partial(tuple.__new__, CameraView)  # a third of the time of a call with names


def note_views(
    views: dict[int, list[CameraView]],
    shots: Shots,
    rows: IntArray,
    images: IntArray,
    boxes_xyxy: FloatArray,
    missed: IntArray,
    missed_in: IntArray,
) -> None:
    """Note which images show a light, and which should have.

    Args:
        views: By track, image by image; gets the new ones.
        shots: The images.
        rows: (m,) tracks that were seen.
        images: (m,) in which image.
        boxes_xyxy: (m, 4) pixels, where.
        missed: (j,) tracks that an image should have shown.
        missed_in: (j,) which image.
    """
    cameras = [camera.name for camera in shots.optics.cameras]
    stamps_ns = [pose.stamp_ns for pose in shots.poses]
    shown: list[tuple[int, int, Any]] = list(
        zip(images.tolist(), rows.tolist(), map(tuple, boxes_xyxy.tolist()), strict=True)
    )
    if len(missed):
        shown += [(image, row, None) for image, row in zip(missed_in.tolist(), missed.tolist(), strict=True)]
        shown.sort(key=itemgetter(0))
    for image, row, box in shown:
        view = _VIEW((cameras[image], stamps_ns[image], box))
        if row in views:
            views[row].append(view)
        else:
            views[row] = [view]
