"""The learning rate and the momentum of each step, in closed form."""

import math
from dataclasses import dataclass

from autolights.train.config import ScheduleConfig


@dataclass(frozen=True)
class Rates:
    """What a step is taken with."""

    rate: float
    bias_rate: float
    momentum: float


@dataclass(frozen=True)
class Schedule:
    """Annealing along a line, or along a cosine in one or more cycles, behind a linear warm-up.

    Attributes:
        config: Its shape.
        steps: Batches in the run.
        steps_per_epoch: Batches in an epoch.
        momentum: After the warm-up.

    References:
        Loshchilov and Hutter 2017, "SGDR".
    """

    config: ScheduleConfig
    steps: int
    steps_per_epoch: int
    momentum: float

    @property
    def warmup_steps(self) -> int:
        """Length of the warm-up; a third of the run at most, so that a short run does learn."""
        wanted = max(round(self.config.warmup_epochs * self.steps_per_epoch), self.config.warmup_steps)
        if self.config.warmup_epochs == 0:
            wanted = 0
        return min(wanted, self.steps // 3)

    def annealed(self, step: int) -> float:
        """The rate without warm-up: the maximum at a cycle's first step, the minimum at its last.

        Args:
            step: From 0 to steps − 1.
        """
        cycles = self.config.cycles if self.config.kind == "cyclic_cosine" else 1
        cycle = step * cycles // self.steps
        first = -(-cycle * self.steps // cycles)
        last = -(-(cycle + 1) * self.steps // cycles) - 1
        progress = (step - first) / (last - first) if last > first else 1.0
        share = 1 - progress if self.config.kind == "linear" else (1 + math.cos(math.pi * progress)) / 2
        return self.config.min_rate + (self.config.max_rate - self.config.min_rate) * share

    def warmed_up(self, step: int) -> float:
        """How much of the warm-up is done, 0 to 1."""
        return 1.0 if step >= self.warmup_steps else step / self.warmup_steps

    def at(self, step: int) -> Rates:
        """Rates and momentum of a step."""
        share = self.warmed_up(step)
        annealed = self.annealed(step)
        bias_start = self.config.warmup_bias_rate or 0.0
        return Rates(
            rate=share * annealed,
            bias_rate=bias_start + share * (annealed - bias_start),
            momentum=self.config.warmup_momentum + share * (self.momentum - self.config.warmup_momentum),
        )
