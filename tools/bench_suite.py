"""How good are fusion and tracking? Scenarios with known truth, a modelled detector, the targets beside the figures.

Usage: python tools/bench_suite.py [--scenario nominal ...] [--config runtime/default] [--compare A B] [--json out.json]
"""

import argparse
from pathlib import Path

from autolights.core import load_config
from autolights.pipeline import PipelineConfig
from autolights.suite import SuiteConfig, default_pipelines, markdown, run_suite


def main() -> None:
    """Run and print Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--suite", default="suite/default", help="YAML file or shipped name")
    parser.add_argument("--scenario", nargs="+", default=[], help="names; by default all")
    parser.add_argument("--config", default="runtime/default", help="runtime configuration that is judged")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="overrides of that configuration")
    parser.add_argument("--only-full", action="store_true", help="leave out OD, OD + Fusion and the paper's rules")
    parser.add_argument("--compare", nargs=2, metavar=("A", "B"), help="two runtime configurations side by side")
    parser.add_argument("--workers", type=int, default=1, help="processes; more than one spoils the times")
    parser.add_argument("--json", type=Path, help="also write the result here")
    arguments = parser.parse_args()

    suite = load_config(arguments.suite, SuiteConfig)
    config = load_config(arguments.config, PipelineConfig, arguments.set)
    if arguments.compare:
        pipelines = {name: load_config(name, PipelineConfig) for name in arguments.compare}
        judged = arguments.compare[1]
    else:
        pipelines, judged = default_pipelines(config, load_config("runtime/paper", PipelineConfig)), "full"
        if arguments.only_full:
            pipelines = {"full": pipelines["full"]}
    result = run_suite(suite, pipelines, scenarios=arguments.scenario, judged=judged, workers=arguments.workers)
    if arguments.json:
        result.save(arguments.json)
    print(markdown(result))


if __name__ == "__main__":
    main()
