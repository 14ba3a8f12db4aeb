"""How does a detector err, and does the suite's model err alike? Rates, lengths and correlations side by side.

Usage: python tools/detector_errors.py --bundle DIR DRIVE ...     drives with images and truth
"""

import argparse
from pathlib import Path

from autolights.core import Bundle, load_config
from autolights.infer import Detector
from autolights.suite import ScenarioConfig, SuiteConfig, record
from autolights.suite.detector_errors import detector_errors
from autolights.suite.drives import scenario_drives
from autolights.suite.recorded import disturb


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drives", type=Path, nargs="+")
    parser.add_argument("--bundle", type=Path, required=True)
    parser.add_argument("--suite", default="suite/default", help="YAML file or shipped name")
    arguments = parser.parse_args()

    suite = load_config(arguments.suite, SuiteConfig)
    bundle = Bundle.load(arguments.bundle)
    detector = Detector.from_bundle(bundle)
    plain = ScenarioConfig(about="as recorded")
    recorded = [disturb(record(folder, bundle.signals, detector), "as", plain, (0,)) for folder in arguments.drives]
    real, model = detector_errors(recorded), detector_errors(scenario_drives(suite, next(iter(suite.scenarios))))
    print(f"{'':20} {'detector':>28} {'model':>28}")
    for name, of_real in vars(real).items():
        of_model = getattr(model, name)
        if isinstance(of_real, dict):
            for band, value in of_real.items():
                print(f"{name + ' ' + band:28} {value:20.3f} {of_model[band]:28.3f}")
        else:
            print(f"{name:20} {_text(of_real):>28} {_text(of_model):>28}")


def _text(value: object) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
