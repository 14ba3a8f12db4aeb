"""With which programs and on which machine a run was made."""

import platform
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import torchvision

import autolights
from autolights.train.processes import Processes


def describe_environment(device: torch.device, processes: Processes) -> dict[str, Any]:
    """What ``environment.json`` holds, but for the data."""
    return {
        "autolights": autolights.__version__,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "torchvision": torchvision.__version__,
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "system": platform.platform(),
        "processor": _processor_name(),
        "device": torch.cuda.get_device_name(device) if device.type == "cuda" else str(device),
        "processes": processes.size,
        "threads": torch.get_num_threads(),
        "command": sys.argv,
    }


def _processor_name() -> str:
    """Linux tells the model by a file alone."""
    information = Path("/proc/cpuinfo")
    if information.is_file():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
