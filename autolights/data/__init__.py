"""Files of the outside world: labelled images, drives, maps, calibrations, truth and what a run leaves behind."""

from autolights.data.calibrations import load_calibration, save_calibration
from autolights.data.drives import Drive, FrameRecord, write_drive
from autolights.data.image_dataset import ImageDataset, load_image_dataset
from autolights.data.maps import load_map, save_map
from autolights.data.poses import load_poses, save_poses
from autolights.data.run_output import DetectedFrame, EstimateSet, load_detections, load_estimates, load_run_info
from autolights.data.truth import TruthFrame, TruthLight, load_truth, save_truth
from autolights.data.utm import lon_lat_from_utm

__all__ = [
    "DetectedFrame",
    "Drive",
    "EstimateSet",
    "FrameRecord",
    "ImageDataset",
    "TruthFrame",
    "TruthLight",
    "load_calibration",
    "load_detections",
    "load_estimates",
    "load_image_dataset",
    "load_map",
    "load_poses",
    "load_run_info",
    "load_truth",
    "lon_lat_from_utm",
    "save_calibration",
    "save_map",
    "save_poses",
    "save_truth",
    "write_drive",
]
