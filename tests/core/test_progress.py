import itertools

import pytest

from autolights.core import progress


@pytest.fixture
def clock(monkeypatch):
    """A second passes with each look at the clock."""
    ticks = itertools.count()
    monkeypatch.setattr(progress.time, "monotonic", lambda: float(next(ticks)))


def test_plain_lines_where_there_is_no_terminal(clock, capsys):
    items = list(progress.track(range(20), description="epoch 1/3", total=20, unit="images"))

    captured = capsys.readouterr()
    assert items == list(range(20))
    assert captured.out == ""
    assert captured.err == "epoch 1/3: 10/20, 1.0 images/s, 10 s left\nepoch 1/3: 20/20, 1.0 images/s, 0 s left\n"


def test_short_work_is_silent(capsys):
    list(progress.track(range(3), description="short", total=3))

    assert capsys.readouterr().err == ""
