"""How a head's lamps look to the camera, and the disturbances that come and go."""

from dataclasses import dataclass

import numpy as np

from autolights.sim.config import DisturbanceConfig


@dataclass(frozen=True)
class HeadLook:
    """What light and exposure do to one head; each number from 0 to 1.

    Attributes:
        washout: Over-exposure of lit lamps: red turns to amber and white, green to white, the halo grows.
        brightness: Of lit lamps; 0 as if off.
        sunlit: Sunlight in the lenses, which then seem lit.
        veil: Stray light over the whole head.
    """

    washout: float = 0.0
    brightness: float = 1.0
    sunlit: float = 0.0
    veil: float = 0.0


@dataclass(frozen=True)
class Disturbance:
    """A look that replaces the ordinary one for a while, seconds after the start."""

    start_s: float
    end_s: float
    look: HeadLook


def ordinary_look(config: DisturbanceConfig, rng: np.random.Generator) -> HeadLook:
    """A look without disturbance."""
    return HeadLook(washout=float(rng.uniform(*config.washout)), brightness=float(rng.uniform(*config.brightness)))


def disturbed_look(config: DisturbanceConfig, ordinary: HeadLook, rng: np.random.Generator) -> HeadLook:
    """The ordinary look with one disturbance of random kind and severity."""
    kinds = list(config.kinds)
    weights = np.array([config.kinds[kind] for kind in kinds])
    kind = kinds[int(rng.choice(len(kinds), p=weights / weights.sum()))]
    severity = float(rng.uniform(*config.severity))
    if kind == "washout":
        return HeadLook(washout=max(ordinary.washout, 0.5 + 0.5 * severity))
    if kind == "faint":
        return HeadLook(ordinary.washout * 0.3, brightness=min(ordinary.brightness, 0.75 - 0.7 * severity))
    if kind == "sunlit":
        return HeadLook(ordinary.washout, 0.9 - 0.4 * severity, sunlit=0.4 + 0.6 * severity)
    return HeadLook(ordinary.washout, ordinary.brightness * (1 - 0.3 * severity), veil=0.3 + 0.6 * severity)


def plan_disturbances(
    config: DisturbanceConfig, ordinary: HeadLook, duration_s: float, rng: np.random.Generator
) -> tuple[Disturbance, ...]:
    """One head's disturbances over a drive: a Poisson process with uniform durations that never overlap."""
    if config.rate_per_minute == 0:
        return ()
    planned: list[Disturbance] = []
    time_s = 0.0
    while True:
        time_s += float(rng.exponential(60 / config.rate_per_minute))
        if time_s >= duration_s:
            return tuple(planned)
        end_s = time_s + float(rng.uniform(*config.duration_s))
        planned.append(Disturbance(time_s, end_s, disturbed_look(config, ordinary, rng)))
        time_s = end_s


def look_at(time_s: float, ordinary: HeadLook, disturbances: tuple[Disturbance, ...]) -> HeadLook:
    """The look at one instant."""
    for disturbance in disturbances:
        if disturbance.start_s <= time_s < disturbance.end_s:
            return disturbance.look
    return ordinary
