"""Traffic lights done right: train, export, run, track and prove.

The main path, in the order in which things are made:

>>> from autolights.sim import simulate_images, simulate_drives    # data with known truth
>>> from autolights.train import train, export_onnx, fit_hmm       # the training side (needs ``[train]``)
>>> from autolights.core import Bundle                             # what travels from training to car
>>> from autolights.pipeline import LightPipeline                  # frames and poses in, lights out

Nothing is imported here, so that ``import autolights`` costs nothing.
"""

__version__ = "0.1.0"
