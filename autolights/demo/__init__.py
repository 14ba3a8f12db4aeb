"""The main job in one call: images, drives, training, bundle, tracking, tables, report."""

from autolights.demo.config import DemoConfig, StageConfig
from autolights.demo.main_job import run_demo

__all__ = ["DemoConfig", "StageConfig", "run_demo"]
