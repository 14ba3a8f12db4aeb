"""Towns, signal controllers, cameras and rendering: data with known truth."""

from autolights.sim.config import DrivesConfig, ImagesConfig
from autolights.sim.drives import simulate_drives
from autolights.sim.images import simulate_images

__all__ = ["DrivesConfig", "ImagesConfig", "simulate_drives", "simulate_images"]
