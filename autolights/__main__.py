"""``python -m autolights`` is the ``autolights`` program."""

from autolights.cli import main

main()
