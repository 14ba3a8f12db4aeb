"""What a run over a drive leaves behind: ``estimates.jsonl``, ``detections.jsonl`` and ``run.json``."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from autolights.core import FloatArray, LightEstimate
from autolights.core.arrays import as_float_array
from autolights.core.errors import DataError
from autolights.core.json_files import read_json_object
from autolights.data.tables import read_json_lines

ESTIMATES, DETECTIONS, RUN = "estimates.jsonl", "detections.jsonl", "run.json"
ESTIMATES_FORMAT = 2  # of each line; 1, which lines did not name, told nothing of relevance


@dataclass(frozen=True)
class EstimateSet:
    """What one variant of the pipeline said about one set of frames.

    Attributes:
        stamp_ns: Latest stamp of the set.
        variant: ``od``, ``fusion`` or ``full``.
        frames: (camera, stamp_ns) of each frame in the set.
        lights: The estimates.
    """

    stamp_ns: int
    variant: str
    frames: tuple[tuple[str, int], ...]
    lights: tuple[LightEstimate, ...]


@dataclass(frozen=True, eq=False)
class DetectedFrame:
    """What the detector said about one image.

    Attributes:
        stamp_ns: Of the image.
        camera: Of the image.
        boxes_xyxy: (n, 4) pixels.
        scores: (n,) in [0, 1].
        classes: n class names.
    """

    stamp_ns: int
    camera: str
    boxes_xyxy: FloatArray
    scores: FloatArray
    classes: tuple[str, ...]


def load_estimates(path: Path, variants: Iterable[str] | None = None) -> list[EstimateSet]:
    """Read estimates in the order of the file; `variants` keeps those only.

    Raises:
        DataError: If the file is missing, of a newer format, or a line breaks it; the text names file and line.
    """
    wanted = None if variants is None else frozenset(variants)
    sets: list[EstimateSet] = []
    for number, values in read_json_lines(path):
        try:
            if int(values.get("format", 1)) > ESTIMATES_FORMAT:
                raise DataError(
                    f"format {values['format']} is newer than {ESTIMATES_FORMAT}; upgrade autolights or run again"
                )
            if wanted is not None and values["variant"] not in wanted:
                continue
            stamp_ns = int(values["stamp_ns"])
            sets.append(
                EstimateSet(
                    stamp_ns=stamp_ns,
                    variant=str(values["variant"]),
                    frames=tuple((str(frame["camera"]), int(frame["stamp_ns"])) for frame in values["frames"]),
                    lights=tuple(LightEstimate.from_json(light, stamp_ns) for light in values["lights"]),
                )
            )
        except KeyError as error:
            raise DataError(f"{path}:{number}: field {error} is missing") from error
        except (DataError, TypeError, ValueError) as error:
            raise DataError(f"{path}:{number}: {error}") from error
    return sets


def load_detections(path: Path) -> list[DetectedFrame]:
    """Read the detections of each image.

    Raises:
        DataError: If the file is missing or a line breaks the format; the text names file and line.
    """
    frames: list[DetectedFrame] = []
    for number, values in read_json_lines(path):
        try:
            n = len(values["classes"])
            frames.append(
                DetectedFrame(
                    stamp_ns=int(values["stamp_ns"]),
                    camera=str(values["camera"]),
                    boxes_xyxy=as_float_array(np.asarray(values["boxes_xyxy"]).reshape(-1, 4), (n, 4), "boxes_xyxy"),
                    scores=as_float_array(values["scores"], (n,), "scores"),
                    classes=tuple(str(name) for name in values["classes"]),
                )
            )
        except KeyError as error:
            raise DataError(f"{path}:{number}: field {error} is missing") from error
        except (TypeError, ValueError) as error:
            raise DataError(f"{path}:{number}: {error}") from error
    return frames


def load_run_info(run_dir: Path) -> dict[str, Any]:
    """Read the ``run.json`` of a run: versions, drive, configuration and times.

    Raises:
        DataError: If the file is missing or is no JSON object with ``drive`` and ``variants``.
    """
    path = run_dir / RUN
    info = read_json_object(path, hint="is this the folder of a finished run?")
    for name, kind in (("drive", str), ("variants", dict)):
        if not isinstance(info.get(name), kind):
            raise DataError(f"{path}: field '{name}' is missing; is this the folder of a finished run?")
    return info
