import json

import numpy as np
import pytest

from autolights.core import CameraView, LightEstimate
from autolights.core.errors import DataError


@pytest.fixture
def estimate():
    return LightEstimate(
        stamp_ns=1_700_000_000_123_456_789,
        track_id=7,
        map_id=None,
        type="4",
        class_name="4-yleft2",
        probability=0.98766,
        flashing=True,
        withheld=False,
        position=np.array([448_262.1234, 5_411_932.5, 251.25]),
        covariance=np.eye(3),
        distance_m=41.5,
        last_seen_ns=1_700_000_000_123_456_700,
        views=(CameraView("narrow", 1_700_000_000_123_456_789, (1.0, 2.0, 3.125, 4.0)), CameraView("wide", 5, None)),
    )


def test_line_reads_back_to_the_nanosecond_and_millimetre(estimate):
    read = LightEstimate.from_json(json.loads(json.dumps(estimate.to_json())), estimate.stamp_ns)

    assert (read.stamp_ns, read.last_seen_ns) == (estimate.stamp_ns, estimate.last_seen_ns)
    np.testing.assert_allclose(read.position, estimate.position, atol=5e-4)
    assert read.probability == 0.9877
    assert read.views == (CameraView("narrow", 1_700_000_000_123_456_789, (1.0, 2.0, 3.12, 4.0)), estimate.views[1])
    assert read.to_json() == {**estimate.to_json(), "position": read.to_json()["position"]}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param(
            {"position": [1, 2]}, r"light estimate: position must have shape \(3\), got \(2,\)", id="position"
        ),
        pytest.param({"covariance": [[1]]}, r"covariance must have shape \(3, 3\)", id="covariance"),
        pytest.param({"views": [{}]}, "light estimate: field 'camera' is missing", id="view"),
        pytest.param({"track_id": "first"}, "light estimate: invalid literal", id="id"),
    ],
)
def test_broken_lines(estimate, change, message):
    with pytest.raises(DataError, match=message):
        LightEstimate.from_json({**estimate.to_json(), **change}, 0)
