"""The moving average of a network's weights, which is what is validated and saved."""

import copy
import math

import torch

from autolights.train.network.model import YoloV5


class WeightAverage:
    """Exponential moving average that follows closely at first: decay · (1 − e^(−updates / ramp)).

    Attributes:
        model: The averaged network, in eval mode.
        updates: Steps so far.
    """

    def __init__(self, model: YoloV5, *, decay: float, ramp_steps: float) -> None:
        self.model = copy.deepcopy(model).eval().requires_grad_(False)
        self.updates = 0
        self._decay = decay
        self._ramp_steps = ramp_steps

    @torch.no_grad()
    def update(self, model: YoloV5) -> None:
        """Move towards the network's present weights and running statistics."""
        self.updates += 1
        decay = self._decay * (1 - math.exp(-self.updates / self._ramp_steps))
        for mean, value in zip(self.model.state_dict().values(), model.state_dict().values(), strict=True):
            if mean.is_floating_point():
                mean.lerp_(value, 1 - decay)
            else:
                mean.copy_(value)
