"""What the runtime says about one light at one instant."""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Self, TypeAlias

from autolights.core.arrays import FloatArray, as_float_array
from autolights.core.errors import DataError

# Of the pipeline, the paper's ablation: detections alone, held against the map, tracked.
Variant: TypeAlias = Literal["od", "fusion", "full"]
VARIANTS: tuple[Variant, ...] = ("od", "fusion", "full")


class CameraView(NamedTuple):
    """Where one camera saw a light in this set of frames.

    Attributes:
        camera: Name of the camera.
        stamp_ns: Stamp of its image.
        box_xyxy: The detection's box in pixels of that image; None if the light was expected there but not detected.
    """

    camera: str
    stamp_ns: int
    box_xyxy: tuple[float, float, float, float] | None


@dataclass(frozen=True, eq=False)
class LightEstimate:
    """A tracked light.

    Attributes:
        stamp_ns: Latest stamp of the set of frames.
        track_id: Unique for the life of the pipeline.
        map_id: The map light that it is, or None for a light that the map does not hold.
        type: Type of the signal description.
        class_name: State that is reported (for a flashing pair the pair's name).
        probability: Belief in that state, in [0, 1].
        flashing: Whether the indication flashes.
        withheld: True if the state is too old or too doubtful to act upon.
        position: (3,) east, north, up in metres.
        covariance: (3, 3) m² of the position, or None where it is not known.
        distance_m: From the vehicle to the light.
        last_seen_ns: Stamp of the last detection.
        views: One for each camera that covers the light.
        ahead_m: From the vehicle to the light along the way it heads, negative behind it; None where nobody asked.
        intersection: To which it belongs: the map's name, or one derived (`autolights.track.relevance`); None likewise.
        governs: Whether it is meant for the vehicle's approach; None where the way its face looks is not known.
    """

    stamp_ns: int
    track_id: int
    map_id: str | None
    type: str
    class_name: str
    probability: float
    flashing: bool
    withheld: bool
    position: FloatArray
    covariance: FloatArray | None
    distance_m: float
    last_seen_ns: int
    views: tuple[CameraView, ...] = ()
    ahead_m: float | None = None
    intersection: str | None = None
    governs: bool | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", as_float_array(self.position, (3,), "position"))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", as_float_array(self.covariance, (3, 3), "covariance"))

    @classmethod
    def of_filter(cls, **fields: Any) -> Self:
        """An estimate of all fields; `position` and `covariance` are arrays that the filter's own numbers made."""
        estimate = object.__new__(cls)
        object.__setattr__(estimate, "__dict__", fields)
        return estimate

    def to_json(self) -> dict[str, Any]:
        """One entry of `lights` in a line of ``estimates.jsonl`` (DESIGN: Files); the line holds the stamp."""
        return {
            "track_id": self.track_id,
            "map_id": self.map_id,
            "type": self.type,
            "class": self.class_name,
            "probability": round(self.probability, 4),
            "flashing": self.flashing,
            "withheld": self.withheld,
            "position": [round(float(value), 3) for value in self.position],
            "covariance": None if self.covariance is None else self.covariance.tolist(),
            "distance_m": round(self.distance_m, 3),
            "ahead_m": None if self.ahead_m is None else round(self.ahead_m, 3),
            "intersection": self.intersection,
            "governs": self.governs,
            "last_seen_ns": self.last_seen_ns,
            "views": [
                {
                    "camera": view.camera,
                    "stamp_ns": view.stamp_ns,
                    "box_xyxy": None if view.box_xyxy is None else [round(edge, 2) for edge in view.box_xyxy],
                }
                for view in self.views
            ],
        }

    @classmethod
    def from_json(cls, values: dict[str, Any], stamp_ns: int) -> Self:
        """Read what `to_json` gave; raises `DataError` on anything else."""
        try:
            views = tuple(
                CameraView(
                    camera=str(view["camera"]),
                    stamp_ns=int(view["stamp_ns"]),
                    box_xyxy=None if view["box_xyxy"] is None else tuple(view["box_xyxy"]),
                )
                for view in values["views"]
            )
            return cls(
                stamp_ns=stamp_ns,
                track_id=int(values["track_id"]),
                map_id=values["map_id"],
                type=str(values["type"]),
                class_name=str(values["class"]),
                probability=float(values["probability"]),
                flashing=bool(values["flashing"]),
                withheld=bool(values["withheld"]),
                position=values["position"],
                covariance=values["covariance"],
                distance_m=float(values["distance_m"]),
                last_seen_ns=int(values["last_seen_ns"]),
                views=views,
                # Format 1 does not have these.
                ahead_m=None if values.get("ahead_m") is None else float(values["ahead_m"]),
                intersection=None if values.get("intersection") is None else str(values["intersection"]),
                governs=None if values.get("governs") is None else bool(values["governs"]),
            )
        except KeyError as error:
            raise DataError(f"light estimate: field {error} is missing") from error
        except (TypeError, ValueError) as error:
            raise DataError(f"light estimate: {error}") from error
