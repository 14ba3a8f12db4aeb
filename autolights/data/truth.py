"""Truth of a drive: ``truth.jsonl``, one line per camera frame with every light in view, occluded ones too."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from autolights.core import FloatArray
from autolights.core.arrays import as_float_array
from autolights.core.atomic import write_text
from autolights.core.errors import DataError
from autolights.data.tables import read_json_lines


@dataclass(frozen=True, eq=False)
class TruthLight:
    """A light as it really is in one camera frame.

    Attributes:
        truth_id: The same for one light through the whole drive.
        map_id: The map light that stands for it, or None where the map lacks it.
        type: Type of the signal description.
        class_name: What a report should say; both phases of a flash have the pair's name.
        lit_class: What is shown at this very instant: the dark phase of a flash is its own class.
        flashing: Whether the indication flashes.
        box_xyxy: Left, top, right, bottom in pixels of the whole housing (amodal); may leave the image.
        occlusion: Share of the box that something hides, 0 to 1.
        truncated: Whether the box leaves the image.
        position: (3,) centre of the housing: east, north, up in metres.
        heading_deg: The way the face looks, clockwise from north.
    """

    truth_id: str
    map_id: str | None
    type: str
    class_name: str
    lit_class: str
    flashing: bool
    box_xyxy: tuple[float, float, float, float]
    occlusion: float
    truncated: bool
    position: FloatArray
    heading_deg: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", as_float_array(self.position, (3,), "xyz"))
        left, top, right, bottom = as_float_array(self.box_xyxy, (4,), "box_xyxy").tolist()
        if not (left < right and top < bottom):
            raise ValueError(f"box_xyxy must read left < right and top < bottom, got {list(self.box_xyxy)}")
        object.__setattr__(self, "box_xyxy", (left, top, right, bottom))
        if not 0 <= self.occlusion <= 1:
            raise ValueError(f"occlusion must lie in [0, 1], got {self.occlusion}")

    def to_json(self) -> dict[str, Any]:
        """One entry of `lights` in a line of ``truth.jsonl``."""
        return {
            "truth_id": self.truth_id,
            "map_id": self.map_id,
            "type": self.type,
            "class": self.class_name,
            "lit_class": self.lit_class,
            "flashing": self.flashing,
            "box_xyxy": [round(edge, 2) for edge in self.box_xyxy],
            "occlusion": round(self.occlusion, 3),
            "truncated": self.truncated,
            "xyz": [round(float(value), 3) for value in self.position],
            "heading_deg": round(self.heading_deg, 3),
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Read what `to_json` gave; raises `DataError` on anything else."""
        try:
            return cls(
                truth_id=str(values["truth_id"]),
                map_id=None if values["map_id"] is None else str(values["map_id"]),
                type=str(values["type"]),
                class_name=str(values["class"]),
                lit_class=str(values["lit_class"]),
                flashing=bool(values["flashing"]),
                box_xyxy=values["box_xyxy"],
                occlusion=float(values["occlusion"]),
                truncated=bool(values["truncated"]),
                position=values["xyz"],
                heading_deg=float(values["heading_deg"]),
            )
        except KeyError as error:
            raise DataError(f"truth light: field {error} is missing") from error
        except (TypeError, ValueError) as error:
            raise DataError(f"truth light: {error}") from error


@dataclass(frozen=True, eq=False)
class TruthFrame:
    """Every light in one camera frame; a frame without lights is an ordinary case."""

    stamp_ns: int
    camera: str
    lights: tuple[TruthLight, ...]


def load_truth(path: Path) -> list[TruthFrame]:
    """Read the truth of a drive in the order of time.

    Raises:
        DataError: If the file is missing, a line breaks the format, or a camera frame comes twice; the text names
            file and line.
    """
    frames: list[TruthFrame] = []
    seen: set[tuple[str, int]] = set()
    for number, values in read_json_lines(path):
        try:
            frame = TruthFrame(
                stamp_ns=int(values["stamp_ns"]),
                camera=str(values["camera"]),
                lights=tuple(TruthLight.from_json(light) for light in values["lights"]),
            )
        except KeyError as error:
            raise DataError(f"{path}:{number}: field {error} is missing") from error
        except (DataError, TypeError, ValueError) as error:
            raise DataError(f"{path}:{number}: {error}") from error
        if (frame.camera, frame.stamp_ns) in seen:
            raise DataError(f"{path}:{number}: camera '{frame.camera}' has stamp {frame.stamp_ns} twice")
        seen.add((frame.camera, frame.stamp_ns))
        frames.append(frame)
    return sorted(frames, key=lambda frame: (frame.stamp_ns, frame.camera))


def save_truth(path: Path, frames: Iterable[TruthFrame]) -> None:
    """Write truth as JSON lines that `load_truth` reads back."""
    lines = (
        json.dumps(
            {
                "stamp_ns": frame.stamp_ns,
                "camera": frame.camera,
                "lights": [light.to_json() for light in frame.lights],
            }
        )
        for frame in frames
    )
    write_text(path, "".join(line + "\n" for line in lines))
