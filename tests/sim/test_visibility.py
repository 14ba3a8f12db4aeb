"""Boxes and hidden shares against hand-made outlines."""

import numpy as np
import pytest

from autolights.core import load_signals
from autolights.sim.config import CameraConfig
from autolights.sim.heads import SignalHead
from autolights.sim.render import Outline
from autolights.sim.rig import build_camera
from autolights.sim.view import View
from autolights.sim.visibility import amodal_box, inside_share, occlusion

BOX = np.array([100.0, 50.0, 120.0, 110.0])


def rectangle(left: float, top: float, right: float, bottom: float) -> np.ndarray:
    """Corners in pixels whose edges are the given box edges."""
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]]) - 0.5


OWN = Outline(rectangle(*BOX), "h")


@pytest.mark.parametrize(
    ("later", "share"),
    [
        pytest.param([], 0.0, id="nothing"),
        pytest.param([rectangle(0, 0, 110, 200)], 0.5, id="left-half"),
        pytest.param([rectangle(90, 95, 130, 300)], 0.25, id="lower-quarter"),
        pytest.param([rectangle(0, 0, 500, 500)], 1.0, id="all"),
        pytest.param([rectangle(0, 0, 110, 200), rectangle(0, 0, 110, 200)], 0.5, id="twice-is-once"),
        pytest.param([rectangle(0, 0, 110, 200), rectangle(110, 0, 200, 200)], 1.0, id="two-halves"),
        pytest.param([rectangle(120, 0, 200, 200)], 0.0, id="beside"),
        pytest.param([np.array([[100.0, 50], [120, 50], [100, 110]]) - 0.5], 0.5, id="triangle"),
    ],
)
def test_hidden_share_of_a_box(later: list[np.ndarray], share: float) -> None:
    outlines = [OWN, *(Outline(polygon, None) for polygon in later)]
    assert occlusion("h", BOX, outlines) == pytest.approx(share, abs=0.05)


def test_what_was_painted_before_the_head_hides_nothing() -> None:
    assert occlusion("h", BOX, [Outline(rectangle(0, 0, 500, 500), None), OWN]) == 0


def test_another_head_hides_like_anything_else() -> None:
    assert occlusion("h", BOX, [OWN, Outline(rectangle(0, 0, 500, 80), "other")]) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(
    ("box", "share"),
    [
        pytest.param([10, 10, 20, 30], 1.0, id="inside"),
        pytest.param([-10, 10, 10, 30], 0.5, id="half-left"),
        pytest.param([-10, -20, 10, 20], 0.25, id="corner"),
        pytest.param([700, 10, 720, 30], 0.0, id="outside"),
    ],
)
def test_share_of_a_box_inside_the_image(box: list[float], share: float) -> None:
    assert inside_share(np.array(box, dtype=float), (640, 400)) == pytest.approx(share)


def test_an_amodal_box_is_the_pinhole_size_of_the_housing() -> None:
    camera = build_camera(CameraConfig(name="c", horizontal_fov_deg=60, max_range_m=80, pitch_deg=0))
    size_m = load_signals().types["3"].size_m
    head = SignalHead("h", "3", np.array([40.0, 0.0, 1.1]), np.pi, "j", "ours", "black", size_m)
    box = amodal_box(head, View(camera, np.eye(4)))
    assert box is not None
    focal = camera.intrinsics[0, 0]
    nearest = 40 - 0.6 - size_m[2] / 2  # the face, from the camera's mounting
    np.testing.assert_allclose(box[2:] - box[:2], [focal * size_m[0] / nearest, focal * size_m[1] / nearest], rtol=1e-9)
    middle = (box[:2] + box[2:]) / 2
    np.testing.assert_allclose(middle, camera.intrinsics[:2, 2] + 0.5, atol=1e-9)
