"""The command line: one verb per job, each a thin cover over a function that a notebook can call."""

from autolights.cli.app import main

__all__ = ["main"]
