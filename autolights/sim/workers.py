"""Work on several processes whose results come in order and do not depend on how many there are."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import cv2

T = TypeVar("T")
R = TypeVar("R")


def in_order(function: Callable[[T], R], items: Sequence[T], *, workers: int) -> Iterator[R]:
    """Apply a picklable function to each item; one worker means this process.

    Fresh interpreters are started rather than forked ones: OpenCV's threads do not survive a fork.
    """
    workers = min(workers, len(items))
    if workers <= 1:
        yield from map(function, items)
        return
    with multiprocessing.get_context("spawn").Pool(workers, initializer=_start_worker) as pool:
        yield from pool.imap(function, items, chunksize=4)


def _start_worker() -> None:
    cv2.setNumThreads(1)  # as many workers as cores already
