"""The numbers of tracking: birth, death, memory, and how far the detector's errors hang together."""

from typing import Literal

from pydantic import Field

from autolights.core.config import Config


class TrackConfig(Config):
    """How tracks are born, live and die.

    Attributes:
        mode: ``paper`` counts sets of frames and uses one fixed transition matrix per observation; ``timed`` counts
            seconds, so frame rate, dropped frames and the number of cameras do not change the behaviour.
        birth_hits: Consecutive sets with a detection before a light is reported (N_birth = 2 in the paper).
        death_sets: Mode ``paper``: a light that was missed in more sets than this is no longer reported (N_death = 15).
        max_coast_s: Mode ``timed``: a light that was looked for in vain for longer than this loses its state, and no
            state older than this is acted upon. In both modes a light out of sight is reported no longer than this.
        error_correlation_s: Mode ``timed``: glare or a passing wire spoils a detector's answers for about this long,
            so an observation that follows the last one sooner counts as that share of an independent one; 0 takes all
            observations as independent, as the paper does.
        history_size: Observations that a track remembers at least (the paper's N).
        history_s: It also remembers all of the last seconds, so that two flashes fit in whatever the frame rate.
        box_sigma_px: Standard deviation of a detected box's edges, from which unmapped positions are weighted.
    """

    mode: Literal["paper", "timed"] = "timed"
    birth_hits: int = Field(default=2, ge=1)
    death_sets: int = Field(default=15, ge=0)
    max_coast_s: float = Field(default=2.0, gt=0)
    error_correlation_s: float = Field(default=0.15, ge=0)
    history_size: int = Field(default=64, ge=1)
    history_s: float = Field(default=4.0, ge=0)
    box_sigma_px: float = Field(default=1.5, gt=0)
