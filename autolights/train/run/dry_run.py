"""What a run would do, found out without training: the network's cost, the data, the steps and the rates."""

from autolights.train.config import TrainConfig
from autolights.train.learning.anchors import anchor_recall
from autolights.train.learning.schedule import Schedule
from autolights.train.network.complexity import gflops, parameter_count
from autolights.train.network.model import YoloV5
from autolights.train.processes import ALONE
from autolights.train.run.preparation import (
    TrainingData,
    batches_per_step,
    build_model,
    check_anchors,
    initialise,
    load_training_data,
    schedule_of,
)


def describe_run(config: TrainConfig) -> str:
    """Load data and weights as the run would, and say what it is made of.

    Images are read once, so that those that do not decode are known before it matters.

    Raises:
        UsageError: If data or weights are missing.
        DataError: If a label breaks its format, or too many images do not decode.
        CheckpointError: If the weights cannot be read or are of another size.
    """
    data = load_training_data(config, ALONE)
    model = build_model(config, data.images.classes)
    initialise(model, config)
    check_anchors(model, config, data.samples)
    schedule = schedule_of(config, len(data.loader))
    return "\n".join([*_network(model, config), *_data(data, config, model), *_steps(config, schedule)])


def _network(model: YoloV5, config: TrainConfig) -> list[str]:
    side = config.input_side_px
    return [
        f"network  YOLOv5{model.size}, {len(model.classes)} classes, strides {', '.join(map(str, model.strides))}: "
        f"{parameter_count(model):,} parameters, {gflops(model, (side, side)):.2f} GFLOPs at {side}x{side}",
    ]


def _data(data: TrainingData, config: TrainConfig, model: YoloV5) -> list[str]:
    weights = data.class_weights(config.loss.class_balance)
    width = max(len(name) for name in ("class", *model.classes))
    head = f"         {'class':{width}}  to train on  held out" + ("  weight" if weights is not None else "")
    lines = [f"data     {len(data.images)} images to train on, {len(data.held_out)} held out; labels:", head]
    held_out_counts = data.held_out.class_counts
    for i, (name, count) in enumerate(zip(model.classes, data.images.class_counts, strict=True)):
        weight = f"{weights[i]:8.2f}" if weights is not None else ""
        lines.append(f"         {name:{width}}  {count:11,}  {held_out_counts[i]:8,}{weight}")
    recall = anchor_recall(data.samples.sides_px(), model.anchors_px.double().numpy())
    lines.append(f"anchors  can reach {recall:.1%} of the labels as the network sees them")
    return lines


def _steps(config: TrainConfig, schedule: Schedule) -> list[str]:
    epochs, batches = config.epochs, schedule.steps_per_epoch
    start, end = schedule.at(schedule.warmup_steps), schedule.at(schedule.steps - 1)
    summed = config.batch * batches_per_step(config, 1.0)
    return [
        f"steps    {epochs} epochs of {batches} batches of {config.batch}; {_optimizer_steps(config, schedule):,} of "
        f"the optimiser ({config.optimizer.kind}), each over {summed} images once warm",
        f"rates    {config.schedule.kind}: warm-up of {schedule.warmup_steps} batches to {start.rate:.3g}, "
        f"at the end {end.rate:.3g}",
    ]


def _optimizer_steps(config: TrainConfig, schedule: Schedule) -> int:
    steps = summed = 0
    for batch in range(schedule.steps):
        summed += 1
        if summed >= batches_per_step(config, schedule.warmed_up(batch)):
            steps, summed = steps + 1, 0
    return steps
