"""Time training beside the public YOLOv5: images a second of the step, of the loader, and of both as in an epoch.

Both sides get the same images, weights, input, batch, workers and augmentations (those of train/original). Each has a
process of its own, as settings of memory and threads belong to processes, and they take turns. The ratio of a round is
that of neighbours in time, so a busy machine slows both. Without the package `yolov5` (PyPI, 7.0.14) ours runs alone.

    python tools/bench_train.py data=FOLDER weights=yolov5n.pt batch=16 workers=1 --sizes 320 640
"""

import argparse
import itertools
import logging
import multiprocessing
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from importlib.metadata import version
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
import yaml

from autolights.core import load_config
from autolights.core.errors import AutolightsError, UsageError
from autolights.core.progress import say, track
from autolights.data import load_image_dataset
from autolights.train import TrainConfig
from autolights.train.config import ScheduleConfig
from autolights.train.memory import keep_freed_memory
from autolights.train.network.model import YoloV5
from autolights.train.processes import ALONE
from autolights.train.run.preparation import build_model, initialise, schedule_of, start
from autolights.train.run.steps import AUTOCAST, Steps
from autolights.train.samples.dataset import TrainingSamples
from autolights.train.samples.loader import Batch, BatchLoader

Part = Literal["step", "loader", "epoch"]
PARTS: tuple[Part, ...] = get_args(Part)
FIXED_BATCHES = 4  # that the bare step is fed with
LEAST_BATCHES = 3  # in a turn, however long they take
# Low and steady, so that after any number of steps the losses are those of a sane network.
STEADY = ScheduleConfig(kind="linear", max_rate=1e-3, min_rate=1e-3, warmup_epochs=0)


class Ours:
    """The engine's own loader and steps."""

    name = "autolights"

    def __init__(self, config: TrainConfig, samples: TrainingSamples, model: YoloV5) -> None:
        if config.device == "cpu":
            keep_freed_memory()
        self._loader = BatchLoader(samples, config)
        schedule = schedule_of(config, len(self._loader))
        model = model.to(config.device).to(memory_format=torch.channels_last)
        self._steps = Steps(start(model, config), schedule, config, class_weights=None, processes=ALONE)
        self._steps.start_epoch()

    def batches(self) -> Iterator[Batch]:
        """The loader's batches, epoch after epoch without end."""
        return itertools.chain.from_iterable(self._loader.epoch(number) for number in itertools.count(1))

    def own_form(self, batch: Batch) -> Batch:
        """The same images and labels as its own loader would give them."""
        return batch

    def step(self, batch: Batch) -> None:
        """Forward, loss, backward, optimiser, average of weights."""
        self._steps.backward(batch, ends_epoch=False)
        self._steps.advance()


class Public:
    """The package's loader, network, loss, optimiser and average, called as its own loop calls them.

    The trainer's script around them is left out: it fetches a font and imports clients of web services.
    """

    name = "yolov5"

    def __init__(self, config: TrainConfig, samples: TrainingSamples, model: YoloV5) -> None:
        import yolov5
        from yolov5.models.yolo import Model
        from yolov5.utils.dataloaders import create_dataloader
        from yolov5.utils.loss import ComputeLoss
        from yolov5.utils.torch_utils import ModelEMA, smart_optimizer

        class_count = len(model.classes)
        logging.getLogger("yolov5").setLevel(logging.WARNING)
        package = Path(yolov5.__file__).parent
        hyp = yaml.safe_load((package / "data" / "hyps" / "hyp.scratch-low.yaml").read_text(encoding="utf-8"))
        hyp |= {
            "box": config.loss.box_gain,
            "obj": config.loss.objectness_gain * (config.image_size / 640) ** 2,
            "cls": config.loss.class_gain * class_count / 80,
            "label_smoothing": 0.0,
        }
        self._loader, _ = create_dataloader(
            str(samples.images.image_paths[0].parent),
            config.image_size,
            config.batch,
            32,
            hyp=hyp,
            augment=True,
            cache="ram",
            workers=config.workers,
            shuffle=True,
        )
        self._device = torch.device(config.device)
        self._model = Model(package / "models" / f"yolov5{config.size}.yaml", ch=3, nc=class_count)
        self._model.load_state_dict(model.state_dict())  # both name their layers alike
        self._model.to(self._device).train()
        self._model.hyp = hyp
        self._loss = ComputeLoss(self._model)
        self._optimizer = smart_optimizer(
            self._model, "SGD", STEADY.max_rate, config.optimizer.momentum, config.optimizer.weight_decay
        )
        self._average = ModelEMA(self._model)
        self._amp_type = AUTOCAST[config.precision]
        self._clip_norm = config.optimizer.clip_norm

    def batches(self) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        """See Ours."""
        for images, labels, *_ in itertools.chain.from_iterable(itertools.repeat(self._loader)):
            yield images, labels

    def own_form(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor]:
        """See Ours."""
        return batch.images.permute(0, 3, 1, 2).contiguous(), batch.labels

    def step(self, batch: tuple[torch.Tensor, torch.Tensor]) -> None:
        """See Ours."""
        images = batch[0].to(self._device, non_blocking=True).float() / 255
        with torch.autocast(self._device.type, self._amp_type, enabled=self._amp_type is not None):
            loss, parts = self._loss(self._model(images), batch[1].to(self._device))
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._model.parameters(), self._clip_norm)
        self._optimizer.step()
        self._optimizer.zero_grad()
        self._average.update(self._model)
        parts.tolist()  # for the log, like ours


class Stopwatch:
    """Takes the turns of one trainer."""

    def __init__(self, trainer: Ours | Public, fixed: list[Batch], config: TrainConfig) -> None:
        self._trainer = trainer
        self._fixed = itertools.cycle([trainer.own_form(batch) for batch in fixed])
        self._stream = trainer.batches()
        self._config = config
        self._made_ahead = 2 * config.workers  # batches that a DataLoader prepares before they are asked for
        self._load_s = 0.0

    def images_per_second(self, part: Part, seconds: float) -> float:
        """Time one turn in its steady state: what was prepared before it is used up first."""
        source = self._fixed if part == "step" else self._stream
        use: Callable[[Any], object] = self._trainer.step if part != "loader" else lambda batch: batch
        for _ in range(max(self._made_ahead, 1)):
            use(next(source))
        self._wait_for_gpu()
        count, started = 0, time.perf_counter()
        while count < LEAST_BATCHES or time.perf_counter() - started < seconds:
            use(next(source))
            count += 1
        self._wait_for_gpu()
        batch_s = (time.perf_counter() - started) / count
        if part == "loader":
            self._load_s = batch_s
        if source is self._stream:
            time.sleep(self._made_ahead * self._load_s)  # else the workers prepare on during the other's turn
        return self._config.batch / batch_s

    def _wait_for_gpu(self) -> None:
        if self._config.device.startswith("cuda"):
            torch.cuda.synchronize()


def settings(image_size: int, overrides: list[str]) -> TrainConfig:
    """The original's recipe, with all images in memory and a step of the optimiser after each batch, on both sides."""
    config = load_config("train/original", TrainConfig, [*overrides, f"image_size={image_size}"])
    return config.model_copy(update={"schedule": STEADY, "nominal_batch": config.batch, "cache_mb": 10**6})


def copy_images(config: TrainConfig, count: int, folder: Path) -> None:
    """Lay out images as both loaders read them: links to the files, and their boxes written anew."""
    images = load_image_dataset(
        Path(config.data),
        "train",
        classes=config.classes or None,
        val_fraction=config.val_fraction,
        group_pattern=config.group_pattern,
    )
    whole_batches = min(count, len(images)) // config.batch * config.batch
    if not whole_batches:
        raise UsageError(f"a batch takes {config.batch} images, got {min(count, len(images))}; set batch or --images")
    for part in ("images", "labels"):
        (folder / part / "train").mkdir(parents=True)
    for i in np.linspace(0, len(images) - 1, whole_batches).round().astype(int).tolist():
        path = images.image_paths[i]
        (folder / "images" / "train" / path.name).symlink_to(path.resolve())
        rows = np.column_stack([images.class_ids[i], images.boxes_cxcywh[i]])
        np.savetxt(folder / "labels" / "train" / f"{path.stem}.txt", rows, fmt="%d %.6f %.6f %.6f %.6f")
    (folder / "data.yaml").write_text(yaml.safe_dump({"names": list(images.classes)}), encoding="utf-8")


def take_turns(trainer_type: type[Ours | Public], config: TrainConfig, folder: Path, remote: Connection) -> None:
    """What a trainer's process does: get ready, then answer each part and seconds with images a second."""
    if config.threads:
        torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    images = load_image_dataset(folder, "train")
    # Each class is its own mirror, so that flips happen as often as in the public loader.
    samples = TrainingSamples(images, np.arange(len(images.classes)), config)
    model = build_model(config, images.classes)
    initialise(model, config)
    here = BatchLoader(samples, config.model_copy(update={"workers": 0}))
    fixed = list(itertools.islice(here.epoch(1), FIXED_BATCHES))
    watch = Stopwatch(trainer_type(config, samples, model), fixed, config)
    with suppress(EOFError, BrokenPipeError):  # the other end is closed when all is measured
        remote.send("ready")
        while True:
            remote.send(watch.images_per_second(*remote.recv()))


def bench(
    trainer_types: list[type[Ours | Public]], config: TrainConfig, folder: Path, rounds: int, seconds: float
) -> None:
    """Print a line for each part at one input size."""
    spawn = multiprocessing.get_context("spawn")
    speeds: dict[tuple[Part, str], list[float]] = {(part, each.name): [] for part in PARTS for each in trainer_types}
    with ExitStack() as stack:
        processes = {}
        for each in trainer_types:
            processes[each.name], remote = spawn.Pipe()
            process = spawn.Process(target=take_turns, args=(each, config, folder, remote))
            process.start()
            stack.callback(process.join)
            stack.callback(processes[each.name].close)
            remote.close()
            processes[each.name].recv()
        for number in track(range(rounds), description=f"{config.image_size} px", total=rounds, unit="rounds"):
            for part in PARTS:
                # Who goes first changes, so that a drift of the machine favours nobody.
                for name in list(processes)[:: -1 if number % 2 else 1]:
                    processes[name].send((part, seconds))
                    speeds[part, name].append(processes[name].recv())
    for part in PARTS:
        line = f"{config.image_size:4d}  {part:7s}"
        for each in trainer_types:
            line += f"  {each.name} {statistics.median(speeds[part, each.name]):6.1f}"
        if len(trainer_types) > 1:
            ratios = sorted(a / b for a, b in zip(speeds[part, Ours.name], speeds[part, Public.name], strict=True))
            line += f"  ratio {statistics.median(ratios):.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f})"
        print(line, flush=True)


def main() -> None:
    """Parse, time, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="+", metavar="KEY=VALUE", help="of train/original; data=FOLDER at least")
    parser.add_argument("--sizes", nargs="+", type=int, default=[320, 640], help="sides of the input, pixels")
    parser.add_argument("--images", type=int, default=512, help="how many of the training images are used (512)")
    parser.add_argument("--rounds", type=int, default=8, help="turns of each side (8)")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each turn (6)")
    arguments = parser.parse_args()

    try:
        configs = [settings(size, arguments.overrides) for size in arguments.sizes]
        trainer_types: list[type[Ours | Public]] = [Ours, Public] if find_spec("yolov5") else [Ours]
        if Public not in trainer_types:
            say("autolights alone; for a comparison: pip install yolov5==7.0.14")
        with tempfile.TemporaryDirectory() as folder:
            copy_images(configs[0], arguments.images, Path(folder))
            print(
                f"images a second, median of {arguments.rounds} turns of {arguments.seconds:g} s: "
                f"YOLOv5{configs[0].size}, batch {configs[0].batch}, workers {configs[0].workers}, "
                f"threads {configs[0].threads or torch.get_num_threads()}, {configs[0].device}, "
                f"torch {version('torch')}",
                flush=True,
            )
            for config in configs:
                bench(trainer_types, config, Path(folder), arguments.rounds, arguments.seconds)
    except AutolightsError as error:
        sys.exit(f"error: {error}")
    except EOFError:
        sys.exit("error: the process of one side ended early; it says why above")


if __name__ == "__main__":
    main()
