"""Heads in the town: where their face is, and whether a camera sees it."""

import numpy as np
import pytest

from autolights.core import load_signals
from autolights.sim.config import NARROW
from autolights.sim.disturbances import HeadLook
from autolights.sim.heads import HeadPainter, SignalHead
from autolights.sim.lighting import LIGHTINGS
from autolights.sim.rig import build_camera
from autolights.sim.view import View

SIGNALS = load_signals()


def make_head(yaw: float) -> SignalHead:
    size_m = SIGNALS.types["4"].size_m
    return SignalHead("h", "4", np.array([20.0, 0.0, 2.0]), yaw, "j", "ours", "black", size_m)


def test_the_face_turned_to_us_has_its_right_on_our_right() -> None:
    head = make_head(np.pi)
    np.testing.assert_allclose(head.right, [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(head.on_face(np.array([1.0]), np.array([0.0]))[0], [19.85, -0.18, 2.71], atol=1e-9)
    assert head.facing_deg(np.array([0.0, 0.0, 1.6])) == pytest.approx(0, abs=1e-5)
    assert head.facing_deg(np.array([20.0, 5.0, 1.6])) == pytest.approx(90)


def test_a_head_seen_from_behind_shows_no_lamp() -> None:
    painter = HeadPainter(SIGNALS, LIGHTINGS["sunny"])
    view = View(build_camera(NARROW), np.eye(4))
    pictures = []
    for yaw in (np.pi, 0.0):
        canvas = np.zeros((800, 1280, 3), np.uint8)
        outlines = painter.paint(canvas, view, make_head(yaw), "4-gleft", HeadLook())
        assert len(outlines) == 4  # one for each lamp's section
        pictures.append(int(canvas.max()))
    assert pictures[0] > 200 > 80 > pictures[1]


def test_a_head_behind_the_camera_is_not_painted() -> None:
    head = make_head(np.pi)
    view = View(build_camera(NARROW), np.array([[1.0, 0, 0, 25], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]]))
    canvas = np.zeros((800, 1280, 3), np.uint8)
    assert HeadPainter(SIGNALS, LIGHTINGS["sunny"]).paint(canvas, view, head, "4-off", HeadLook()) == []
    assert canvas.max() == 0
