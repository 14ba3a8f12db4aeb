import pytest

from autolights.core import load_config
from autolights.suite import ScenarioConfig, SuiteConfig


@pytest.fixture(scope="session")
def suite() -> SuiteConfig:
    """The shipped suite, with short scenarios of one disturbance each."""
    shipped = load_config("suite/default", SuiteConfig)
    short = {"drives": 1, "duration_s": 12.0, "junctions": 2}
    scenarios = {
        "plain": {"recordable": True},
        "turned": {"mounting_error_deg": 1.0},
        "moved": {"pose_error_m": 0.5},
        "dropped": {"dropped_share": 0.2, "duration_s": 60.0},
        "dead": {"dead_camera": "narrow"},
        "late": {"late_share": 0.2},
        "flashing_red": {
            "signals": "signals/three_lamp_flashing",
            "layouts": [["3", "3"]],
            "programme": "flashing_red",
            "duration_s": 30.0,
        },
        "row": {"row_spacing_m": 1.5, "layouts": [["3", "3", "3", "3"]]},
        "map": {
            "junctions": 12,
            "map_errors": {"missing_share": 0.3, "moved_share": 0.3, "extra_per_junction": 1, "noise_m": 0.0},
        },
    }
    return shipped.model_copy(
        update={
            "scenarios": {
                name: ScenarioConfig.model_validate({"about": name} | short | changes)
                for name, changes in scenarios.items()
            }
        }
    )
