import pytest

_LAMPS = {
    color: {"color": color, "shape": "ball", "center": [0.5, y], "movements": ["through"], "meaning": meaning}
    for color, y, meaning in (("red", 0.2, "stop"), ("green", 0.8, "go"))
}
BEACON = {
    "name": "beacon",
    "classes": ["b-dark", "b-green", "b-red"],
    "types": {
        "b": {
            "width_m": 0.36,
            "height_m": 1.07,
            "depth_m": 0.3,
            "lamps": _LAMPS,
            "states": {
                "b-dark": {"lit": [], "mean_s": 0.46, "next": {"b-red": 1}, "mirror": "b-dark"},
                "b-green": {"lit": ["green"], "mean_s": 20, "next": {"b-red": 1}, "mirror": "b-green"},
                "b-red": {"lit": ["red"], "mean_s": 2, "next": {"b-dark": 3, "b-green": 1}, "mirror": "b-red"},
            },
            "flashing": [{"on": "b-red", "off": "b-dark", "reported": "b-red", "steady_on": True}],
        }
    },
}


@pytest.fixture(scope="session")
def beacon() -> dict:
    """A description whose red is legal steady and flashing."""
    return BEACON
