"""How good are fusion and tracking? Scenarios with known truth, a modelled detector, the targets beside the figures.

Usage: python tools/bench_suite.py [--scenario nominal ...] [--config runtime/default] [--set KEY=VALUE ...]
       python tools/bench_suite.py --compare A B               two runtime configurations on the same drives
       python tools/bench_suite.py --bundle DIR --recorded DRIVE ...     the bundle's own detector on rendered drives
"""

import argparse
from pathlib import Path

from autolights.core import Bundle, load_config
from autolights.infer import Detector
from autolights.pipeline import PipelineConfig
from autolights.suite import (
    SuiteConfig,
    comparison,
    default_pipelines,
    markdown,
    record,
    run_recorded,
    run_suite,
)


def main() -> None:
    """Run and print Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--suite", default="suite/default", help="YAML file or shipped name")
    parser.add_argument("--scenario", nargs="+", default=[], help="names; by default all")
    parser.add_argument("--config", default="runtime/default", help="runtime configuration that is judged")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="overrides of that configuration")
    parser.add_argument("--only-full", action="store_true", help="leave out OD, OD + Fusion and the paper's rules")
    parser.add_argument("--compare", nargs=2, metavar=("A", "B"), help="two runtime configurations; B is judged")
    parser.add_argument("--bundle", type=Path, help="its detector and HMMs, for --recorded")
    parser.add_argument("--recorded", type=Path, nargs="+", help="drives with images and truth")
    parser.add_argument("--workers", type=int, default=1, help="processes; more than one spoils the times")
    parser.add_argument("--json", type=Path, help="also write the result here")
    arguments = parser.parse_args()
    if (arguments.bundle is None) != (arguments.recorded is None):
        parser.error("--bundle and --recorded go together")

    suite = load_config(arguments.suite, SuiteConfig)
    pipelines, judged = _pipelines(arguments)
    if arguments.recorded:
        bundle = Bundle.load(arguments.bundle)
        detector = Detector.from_bundle(bundle)
        drives = [record(folder, bundle.signals, detector) for folder in arguments.recorded]
        result = run_recorded(suite, drives, bundle.hmm, pipelines, scenarios=arguments.scenario, judged=judged)
    else:
        result = run_suite(suite, pipelines, scenarios=arguments.scenario, judged=judged, workers=arguments.workers)
    if arguments.json:
        result.save(arguments.json)
    if arguments.compare:
        print(comparison(result, *arguments.compare) + "\n")
    print(markdown(result))


def _pipelines(arguments: argparse.Namespace) -> tuple[dict[str, PipelineConfig], str]:
    """Settings by label, and the label that is judged."""
    if arguments.compare:
        return {name: load_config(name, PipelineConfig) for name in arguments.compare}, arguments.compare[1]
    config = load_config(arguments.config, PipelineConfig, arguments.set)
    pipelines = default_pipelines(config, load_config("runtime/paper", PipelineConfig))
    return ({"full": pipelines["full"]} if arguments.only_full else pipelines), "full"


if __name__ == "__main__":
    main()
