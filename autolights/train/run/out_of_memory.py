"""What to do when a GPU's memory has run out: find the batch that fits."""

import torch

from autolights.train.config import TrainConfig
from autolights.train.network.model import YoloV5
from autolights.train.run.steps import AUTOCAST


def advise(model: YoloV5, config: TrainConfig, process_count: int) -> str:
    """Try smaller and smaller batches on random images, and say which one fits.

    Call it outside of the ``except`` block: the error keeps the failed batch's memory.
    """
    fitting = _largest_fitting(model, config, config.batch // process_count) * process_count
    text = f"the GPU's memory ran out with batch={config.batch} at {config.input_side_px} px"
    if fitting:
        return f"{text}; batch={fitting} fits (nominal_batch keeps the sum of an optimiser step as it is)"
    return f"{text}, and no smaller batch fits; choose a smaller image_size or size, or precision=bf16"


def _largest_fitting(model: YoloV5, config: TrainConfig, batch: int) -> int:
    """The first of batch / 2, batch / 4, ... that passes forward and backward; 0 if none does."""
    # Evaluation mode needs the same memory, and synchronised batch norms ask no other process for anything.
    model.eval()
    while batch > 1:
        batch //= 2
        model.zero_grad()
        if torch.cuda.is_available():
            torch.cuda.empty_cache()
        if _fits(model, config, batch):
            return batch
    return 0


def _fits(model: YoloV5, config: TrainConfig, batch: int) -> bool:
    device = model.anchors.device
    images = torch.rand(batch, 3, config.input_side_px, config.input_side_px)
    try:
        with torch.autocast(device.type, dtype=AUTOCAST[config.precision], enabled=config.precision != "fp32"):
            maps = model.logits(images.to(device, memory_format=torch.channels_last))
        torch.autograd.backward([logits.float().mean() for logits in maps])
    except torch.OutOfMemoryError:
        return False
    return True
