"""The numbers of tracking: birth, death, memory, and how far the detector's errors hang together."""

from typing import Literal, Self

from pydantic import Field, model_validator

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
        state_memory_s: Mode ``timed``: what is believed of a light that was not seen for longer than this is forgotten,
            and it is born anew when it comes into sight again: its phase is over by then.
        error_duration_s: Mode ``timed``: glare or a passing wire spoils a detector's answers for about this long, and
            until then its saying the same again is hardly news; 0 takes all looks as independent, as the paper does.
        dwell_stages: Mode ``timed``: a least duration (`SignalState.min_s`, the phases of a flash) is passed in so many
            stages; 1 lets every state end at any time, as the paper does.
        odd_changes_per_hour: Mode ``timed``: how often lights do what their description does not foresee.
        change_odds: Mode ``timed``: what was said before is said again until something else is this many times as
            probable; 1 says the most probable at any time.
        max_go_risk: Mode ``timed``: "go" is said to nobody who is told to stop with more than this probability.
        min_probability: Mode ``timed``: a state that is less probable is withheld.
        min_missed_px: Mode ``timed``: a light of at least this height that is in plain view and not detected is a hint
            at states that are often missed (P(missed | state) of the bundle).
        share_groups: Mode ``timed``: lights that the map gives one intersection, group and type share evidence.
        dispute_after_s: Lights of a group that contradict each other for this long stop sharing until they agree.
        max_tracks: Lights that are remembered; beyond it those that were out of sight longest are forgotten.
        history_size: Mode ``paper``: observations that a track remembers at least (the paper's N).
        history_s: Mode ``paper``: it also remembers all of the last seconds, so that two flashes fit in.
        box_sigma_px: Standard deviation of a detected box's edges, by which localisations of a new light are weighted.
    """

    mode: Literal["paper", "timed"] = "timed"
    birth_hits: int = Field(default=2, ge=1)
    death_sets: int = Field(default=15, ge=0)
    max_coast_s: float = Field(default=2.0, gt=0)
    state_memory_s: float = Field(default=10.0, gt=0)
    error_duration_s: float = Field(default=0.4, ge=0)
    dwell_stages: int = Field(default=4, ge=1, le=32)
    odd_changes_per_hour: float = Field(default=1.0, gt=0)
    change_odds: float = Field(default=3.0, ge=1)
    max_go_risk: float = Field(default=0.1, gt=0, le=1)
    min_probability: float = Field(default=0.25, ge=0, lt=1)
    min_missed_px: float = Field(default=12.0, ge=0)
    share_groups: bool = True
    dispute_after_s: float = Field(default=1.5, gt=0)
    max_tracks: int = Field(default=2000, ge=1)
    history_size: int = Field(default=64, ge=1)
    history_s: float = Field(default=4.0, ge=0)
    box_sigma_px: float = Field(default=1.5, gt=0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.mode == "timed" and self.state_memory_s < self.max_coast_s:
            raise ValueError(
                f"state_memory_s must be at least max_coast_s ({self.max_coast_s:g}), got {self.state_memory_s:g}: "
                "what is still acted upon must not be forgotten"
            )
        return self
