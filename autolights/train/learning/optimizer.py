"""The optimiser: which parameters decay, and how a step's rates reach it."""

from torch import nn
from torch.optim import SGD, AdamW, Optimizer

from autolights.train.config import OptimizerConfig
from autolights.train.learning.schedule import Rates


def build_optimizer(model: nn.Module, config: OptimizerConfig, *, weight_decay: float) -> Optimizer:
    """SGD with Nesterov momentum or AdamW, in three groups: ``decayed`` weights, ``norms`` and ``biases``.

    Args:
        model: Whose parameters are trained.
        config: Kind and momentum.
        weight_decay: Of the decayed weights, for the batch that a step really sums over.
    """
    biases = [module.bias for module in model.modules() if isinstance(getattr(module, "bias", None), nn.Parameter)]
    norms = [module.weight for module in model.modules() if isinstance(module, nn.BatchNorm2d)]
    others = {id(parameter) for parameter in (*biases, *norms)}
    decayed = [parameter for parameter in model.parameters() if id(parameter) not in others]
    groups = [
        {"name": "decayed", "params": decayed, "weight_decay": weight_decay},
        {"name": "norms", "params": norms, "weight_decay": 0.0},
        {"name": "biases", "params": biases, "weight_decay": 0.0},
    ]
    # The rate is set before each step.
    if config.kind == "sgd":
        return SGD(groups, lr=0.0, momentum=config.momentum, nesterov=config.momentum > 0, fused=True)
    return AdamW(groups, lr=0.0, betas=(config.momentum, 0.999), fused=True)


def set_rates(optimizer: Optimizer, rates: Rates) -> None:
    """Take the next step with these rates."""
    for group in optimizer.param_groups:
        group["lr"] = rates.bias_rate if group["name"] == "biases" else rates.rate
        if "betas" in group:
            group["betas"] = (rates.momentum, group["betas"][1])
        else:
            group["momentum"] = rates.momentum
