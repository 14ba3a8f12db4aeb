"""When the optimiser steps, and in which precision the network computes."""

import pytest
import torch

from autolights.train.network.weights import read_checkpoint
from autolights.train.run import steps
from autolights.train.run.engine import train
from autolights.train.run.steps import Steps

pytestmark = pytest.mark.usefixtures("undrawn")


def test_gradients_are_summed_to_the_nominal_batch(tiny, tmp_path, monkeypatch):
    stepped = []
    real = Steps.advance

    def counted(self):
        real(self)
        if self._state.summed_batches == 0:
            stepped.append(self._state.step)

    monkeypatch.setattr(Steps, "advance", counted)
    train(tiny(batch=3, nominal_batch=6, epochs=2), tmp_path)

    assert stepped == [2, 4, 6, 8]


def test_frozen_batch_norms_keep_their_statistics_and_learn_their_scale(tiny, tmp_path):
    states = {}
    for frozen in (True, False):
        result = train(tiny(epochs=1, freeze_batch_norm=frozen), tmp_path / str(frozen))
        states[frozen] = read_checkpoint(result.last_path).state

    assert torch.equal(states[True]["model.0.bn.running_mean"], torch.zeros(16))
    assert not torch.equal(states[True]["model.0.bn.weight"], torch.ones(16))
    assert not torch.equal(states[False]["model.0.bn.running_mean"], torch.zeros(16))


@pytest.mark.parametrize(("precision", "seen"), [("fp32", torch.float32), ("bf16", torch.bfloat16)])
def test_precision_is_that_of_the_maps_while_the_loss_stays_single(precision, seen, tiny, tmp_path, monkeypatch):
    dtypes = set()
    real = steps.detection_loss

    def watched(maps, *arguments, **settings):
        losses = real(maps, *arguments, **settings)
        dtypes.update({maps[0].dtype, losses.total.dtype})
        return losses

    monkeypatch.setattr(steps, "detection_loss", watched)
    train(tiny(epochs=1, precision=precision), tmp_path)

    assert dtypes == {seen, torch.float32}
