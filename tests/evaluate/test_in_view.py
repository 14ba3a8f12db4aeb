import numpy as np
import pytest

from autolights.core import CameraModel, Pose
from autolights.data import TruthLight
from autolights.evaluate.in_view import lights_in_view

CAMERA = CameraModel("front", (640, 400), np.array([[500.0, 0, 320], [0, 500, 200], [0, 0, 1]]), [], np.eye(4), 64.0)
POSE = Pose(0, np.array([0.0, 0, 0]), np.array([0.0, 0, 0, 1]))


@pytest.mark.parametrize(
    ("change", "counts"),
    [
        pytest.param({}, True, id="plain"),
        pytest.param({"occlusion": 1.0}, True, id="hidden-lights-count"),
        pytest.param({"box_xyxy": (0, 0, 20, 400)}, True, id="touches-the-edges"),
        pytest.param({"box_xyxy": (-0.5, 10, 20, 60)}, False, id="cut-on-the-left"),
        pytest.param({"box_xyxy": (600, 10, 640.5, 60)}, False, id="cut-on-the-right"),
        pytest.param({"box_xyxy": (10, 10, 20, 17.9)}, False, id="too-small"),
        pytest.param({"box_xyxy": (10, 10, 20, 18)}, True, id="eight-pixels"),
        pytest.param({"position": (64.0, 0, 0)}, True, id="at-the-range"),
        pytest.param({"position": (63.9, 0, 5.0)}, False, id="beyond-the-range-in-space"),
        pytest.param({"heading_deg": 270 + 59.0}, True, id="turned-by-59"),
        pytest.param({"heading_deg": 270 - 61.0}, False, id="turned-by-61"),
        pytest.param({"heading_deg": -90.0}, True, id="headings-wrap"),
        pytest.param({"heading_deg": 90.0}, False, id="seen-from-behind"),
        pytest.param({"position": (0, 30.0, 0), "heading_deg": 180.0}, True, id="north-of-the-vehicle-facing-south"),
    ],
)
def test_which_lights_count(change: dict[str, object], counts: bool) -> None:
    values = {"box_xyxy": (10, 10, 20, 60), "occlusion": 0.0, "position": (40.0, 0, 0), "heading_deg": 270.0, **change}
    light = TruthLight("A", None, "3", "3-red", "3-red", flashing=False, truncated=False, **values)
    assert lights_in_view([light], CAMERA, POSE) == ([light] if counts else [])
