"""Progress of long work: a bar with time left on a terminal, plain lines elsewhere; always on stderr."""

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

T = TypeVar("T")
_PLAIN_LINE_EVERY_S = 10.0


def track(items: Iterable[T], *, description: str, total: int | None, unit: str = "") -> Iterator[T]:
    """Pass `items` on and show how far they are.

    Args:
        items: What to go through.
        description: What is being done, e.g. ``epoch 3/10``.
        total: How many items there will be; None if that is not known.
        unit: What one item is called in the rate, e.g. ``images``; empty for no rate.
    """
    if sys.stderr.isatty():
        yield from _with_bar(items, description, total)
    else:
        yield from _with_lines(items, description, total, unit)


def say(text: str) -> None:
    """One line for the user on stderr."""
    print(text, file=sys.stderr, flush=True)


def _with_bar(items: Iterable[T], description: str, total: int | None) -> Iterator[T]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        yield from progress.track(items, total=total, description=description)


def _with_lines(items: Iterable[T], description: str, total: int | None, unit: str) -> Iterator[T]:
    start = last = time.monotonic()
    for done, item in enumerate(items, start=1):
        yield item
        now = time.monotonic()
        if now - last >= _PLAIN_LINE_EVERY_S or (done == total and now - start >= _PLAIN_LINE_EVERY_S):
            last = now
            rate = done / (now - start)
            speed = f", {rate:.1f} {unit}/s" if unit else ""
            if total is None:
                say(f"{description}: {done}{speed}")
            else:
                say(f"{description}: {done}/{total}{speed}, {max(total - done, 0) / rate:.0f} s left")
