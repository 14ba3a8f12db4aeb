"""The map that a runtime gets: the town's lights as a surveyor found them, with errors."""

import numpy as np

from autolights.core import FloatArray, TrafficLightMap
from autolights.core.transforms import transform_points
from autolights.sim.config import SurveyConfig
from autolights.sim.heads import SignalHead
from autolights.sim.script import Script
from autolights.sim.town import HALF_WIDTH_M


def map_ids(script: Script, config: SurveyConfig) -> dict[str, str | None]:
    """The map's name of each head, by its id; None for the one that the survey did not find."""
    return {
        head.id: None if config.missing and head.group == "ours-near-side" else f"tl-{number:02d}"
        for number, head in enumerate(script.town.heads, start=1)
    }


def survey(script: Script, config: SurveyConfig, rng: np.random.Generator) -> TrafficLightMap:
    """Measure the town's lights: noise on each, one missing, one that is no longer there."""
    names = map_ids(script, config)
    heads = [head for head in script.town.heads if names[head.id] is not None]
    ids = [str(names[head.id]) for head in heads]
    if config.extra:
        heads.append(_removed_light(script))
        ids.append(f"tl-{len(script.town.heads) + 1:02d}")
    positions = transform_points(script.utm_from_town, np.array([head.position for head in heads]))
    headings = np.array([heading_deg(head, script.utm_from_town) for head in heads])
    return TrafficLightMap(
        ids=tuple(ids),
        types=tuple(head.type for head in heads),
        positions=positions + rng.normal(0, config.noise_m, positions.shape),
        headings_deg=(headings + rng.normal(0, config.heading_noise_deg, len(heads))) % 360,
        sizes_m=np.array([head.size_m for head in heads]),
        intersections=tuple(head.intersection for head in heads),
        groups=tuple(head.group for head in heads),
    )


def heading_deg(head: SignalHead, utm_from_town: FloatArray) -> float:
    """The way a head's face looks, clockwise from the north of the grid."""
    east, north = (utm_from_town[:3, :3] @ head.normal)[:2]
    return float(np.degrees(np.arctan2(east, north)) % 360)


def _removed_light(script: Script) -> SignalHead:
    """Where a light of type 3 once stood: left of the oncoming lanes, at the first junction."""
    like = script.town.heads[0]
    light_type = sorted(script.signals.types)[0]
    position = np.array([script.town.junctions[0].heads_m - 1.0, HALF_WIDTH_M + 1.6, 3.4])
    size_m = script.signals.types[light_type].size_m
    return SignalHead("removed", light_type, position, like.yaw, like.intersection, "ours", "black", size_m)
