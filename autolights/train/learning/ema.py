"""The moving average of a network's weights, which is what is validated and saved."""

import copy
import itertools
import math
from collections.abc import Iterator

import torch
from torch import Tensor

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
        pairs = list(zip(_tensors(self.model), _tensors(model), strict=True))
        numbers = [pair for pair in pairs if pair[0].is_floating_point()]
        counts = [pair for pair in pairs if not pair[0].is_floating_point()]
        # All in one launch: one by one a GPU takes longer to start them than for the whole step of the optimiser.
        torch._foreach_lerp_([mean for mean, _ in numbers], [value for _, value in numbers], 1 - decay)
        if counts:
            torch._foreach_copy_([mean for mean, _ in counts], [value for _, value in counts])


def _tensors(model: YoloV5) -> Iterator[Tensor]:
    return itertools.chain(model.parameters(), model.buffers())
