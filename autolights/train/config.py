"""Settings of a training run, with defaults, units and sources."""

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from autolights.core.config import Config
from autolights.train.network.model import MAX_STRIDE, Size

_Share = Annotated[float, Field(ge=0, le=1)]


class LossConfig(Config):
    """Gains of the loss; defaults are those of YOLOv5 v6.

    Attributes:
        box_gain: Of 1 − CIoU.
        objectness_gain: Of the objectness; scaled by (image size / 640)².
        class_gain: Of the classes; scaled by classes / 80. A few-step run from nothing wants 3.0.
        label_smoothing: Wanted class probabilities are 1 − half of this, and half of this.
        focal_gamma: Weighs easy cells and classes down by (1 − p)^γ; 0 is plain cross-entropy (Lin et al. 2017).
        class_balance: Rare classes weigh more: a class's positives count (labels of the class)^−this, scaled so that
            the mean over labels is 1. 0: all alike; 1: each class as much as any other.
    """

    box_gain: float = Field(default=0.05, gt=0)
    objectness_gain: float = Field(default=1.0, gt=0)
    class_gain: float = Field(default=0.5, gt=0)
    label_smoothing: float = Field(default=0.0, ge=0, lt=1)
    focal_gamma: float = Field(default=0.0, ge=0)
    class_balance: float = Field(default=0.0, ge=0, le=1)


class ScheduleConfig(Config):
    """The learning rate over the run.

    Attributes:
        kind: ``cyclic_cosine`` falls from the maximum to the minimum in each cycle and starts again; ``cosine`` does so
            once; ``linear`` falls in a straight line.
        cycles: Of equal length; for ``cyclic_cosine`` alone.
        max_rate: Learning rate at the start of a cycle (the paper: 0.008).
        min_rate: At the end of a cycle, and of the run.
        warmup_epochs: The rate rises linearly from 0 in this time.
        warmup_steps: At least so many steps of warm-up, but never more than a third of the run.
        warmup_momentum: Momentum at the start of the warm-up.
        warmup_bias_rate: Where the biases' rate starts, falling to the schedule's; None: at 0 like the others. For SGD
            only: YOLOv5 takes 0.1.
    """

    kind: Literal["cyclic_cosine", "cosine", "linear"] = "cyclic_cosine"
    cycles: int = Field(default=2, ge=1)
    max_rate: float = Field(default=0.008, gt=0)
    min_rate: float = Field(default=0.00008, ge=0)
    warmup_epochs: float = Field(default=1.0, ge=0)
    warmup_steps: int = Field(default=100, ge=0)
    warmup_momentum: float = Field(default=0.8, ge=0, lt=1)
    warmup_bias_rate: float | None = Field(default=None, ge=0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.min_rate > self.max_rate:
            raise ValueError(f"min_rate must not exceed max_rate {self.max_rate:g}, got {self.min_rate:g}")
        return self


class OptimizerConfig(Config):
    """How steps are taken.

    Attributes:
        kind: ``sgd`` with Nesterov momentum, or ``adamw``.
        momentum: Of SGD, and the first beta of AdamW.
        weight_decay: On convolution weights only; for a nominal batch.
        clip_norm: Largest norm of the gradient.
        ema_decay: The average of weights that is validated and saved moves by 1 − this, at last.
        ema_ramp_steps: It comes near that after so many steps.
    """

    kind: Literal["sgd", "adamw"] = "sgd"
    momentum: float = Field(default=0.937, ge=0, lt=1)
    weight_decay: float = Field(default=0.0005, ge=0)
    clip_norm: float = Field(default=10.0, gt=0)
    ema_decay: float = Field(default=0.9999, gt=0, lt=1)
    ema_ramp_steps: float = Field(default=2000.0, gt=0)


class AugmentConfig(Config):
    """Random changes of training images (the paper: Gaussian blur, colour jitter, rotation, flips).

    Attributes:
        rotate_deg: Largest rotation either way.
        scale: Whole images are scaled by 1 ± this; crops have their own range.
        translate: Whole images are moved by up to this share of the input, either way.
        flip: Probability of a horizontal flip where each class in view has a mirror class.
        flip_vertical: Probability of turning the picture upside down where each class in view is its own mirror class.
            For photos that are met so, as some collections hold them, and classes whose lamps are told by colour: a
            straight arrow is its own mirror class too.
        mosaic: Probability that four whole images are put together.
        blur: Probability of a Gaussian blur.
        blur_sigma_px: Its range.
        jitter: Probability of a colour jitter.
        brightness: Largest change, as a share.
        contrast: Largest change, as a share.
        saturation: Largest change, as a share.
        hue: Largest shift, as a share of the colour circle. Red and amber lamps are 0.06 apart and more: two shifts of
            0.02 do not make them meet.
        min_visible: A label is dropped if less than this share of its box is left in view.
        min_side_px: A label is dropped if a side is shorter.
    """

    rotate_deg: float = Field(default=3.0, ge=0, le=45)
    scale: float = Field(default=0.3, ge=0, lt=1)
    translate: float = Field(default=0.1, ge=0, le=0.5)
    flip: _Share = 0.5
    flip_vertical: _Share = 0.0
    mosaic: _Share = 0.0
    blur: _Share = 0.1
    blur_sigma_px: tuple[float, float] = (0.3, 1.5)
    jitter: _Share = 0.5
    brightness: float = Field(default=0.3, ge=0, lt=1)
    contrast: float = Field(default=0.2, ge=0, lt=1)
    saturation: float = Field(default=0.4, ge=0, lt=1)
    hue: float = Field(default=0.005, ge=0, le=0.02)
    min_visible: _Share = 0.5
    min_side_px: float = Field(default=2.0, ge=0)


class CropConfig(Config):
    """Train on crops, most of them around a light, instead of whole images.

    Attributes:
        size: Side of a crop, pixels.
        scale: Range of the factor by which the image is scaled before the crop is cut.
        light_share: Share of crops that are placed around a random light, where the image has one.
        per_image: Crops from each image in an epoch.
    """

    size: int = Field(default=192, ge=MAX_STRIDE)
    scale: tuple[float, float] = (0.6, 1.1)
    light_share: _Share = 0.9
    per_image: int = Field(default=1, ge=1)

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_side(self.size, "size")
        if not 0 < self.scale[0] <= self.scale[1]:
            raise ValueError(f"scale must be a range of positive factors, got {list(self.scale)}")
        return self


class TrainConfig(Config):
    """A training run.

    Attributes:
        data: Folder in the YOLO layout.
        classes: Names, for a folder without ``data.yaml``.
        val_fraction: Share held out for validation, if the folder has no part of its own for it.
        group_pattern: Regular expression; files whose first group is equal stay on one side of that split.
        signals: Signal description that gives the mirror classes; empty takes the one that ``data.yaml`` names, if any.
        mirrors: Class → mirror class, for data without a signal description; classes that are not named have none.
        size: Of the network: n, s, m, l or x.
        weights: ``base`` for the shipped base checkpoint, a file, or empty to start from nothing.
        image_size: Side of the square input for whole images, pixels.
        rectangular: Whole images keep their shape: a batch holds images of like aspect ratio in the smallest stride-32
            rectangle that fits them, without mosaic.
        crops: Train on crops instead.
        finest_stride: Pixels in a cell of the finest level; 4 adds a level to YOLOv5's three.
        anchors: ``auto`` re-estimates the anchors if they can reach too few labels; ``published`` leaves them alone.
        epochs: Passes through the training images.
        batch: Images in a step of the network.
        nominal_batch: Gradients are summed over batches up to about this many images (YOLOv5: 64).
        val_long_side: Long side of the input in validation, pixels; None is `image_size`.
        val_every: Epochs between validations; the last epoch is always validated. 0: only that one.
        val_score_threshold: Of the confusion matrix.
        optimizer: How steps are taken.
        schedule: Of the learning rate.
        loss: Gains.
        augment: Random changes.
        patience: Stop after so many epochs without better figures; 0: never.
        freeze_batch_norm: Keep the running statistics that the weights came with.
        precision: Of the network's arithmetic in training; ``fp16`` scales the loss and needs a GPU.
        compile: Translate the network by ``torch.compile`` first; pays on GPUs alone.
        bad_images: Largest share of images that do not decode; they are listed and left out.
        seed: Of all randomness.
        workers: Processes that prepare images; 0 prepares them between the steps.
        threads: Of torch; 0 leaves the choice to it.
        device: Where the network runs, e.g. ``cpu`` or ``cuda``; under torchrun each process takes its own GPU.
        cache_mb: Decoded images are kept up to this many megabytes.
        cache_dir: Keep decoded images in this folder for the next run too; empty: in memory only.
    """

    data: str
    classes: tuple[str, ...] = ()
    val_fraction: float = Field(default=0.0, ge=0, lt=1)
    group_pattern: str | None = None
    signals: str = ""
    mirrors: dict[str, str] = Field(default_factory=dict)
    size: Size = "n"
    weights: str = "base"
    image_size: int = Field(default=320, ge=MAX_STRIDE)
    rectangular: bool = False
    crops: CropConfig | None = None
    finest_stride: Literal[8, 4] = 8
    anchors: Literal["auto", "published"] = "auto"
    epochs: int = Field(default=20, ge=1)
    batch: int = Field(default=16, ge=1)
    nominal_batch: int = Field(default=64, ge=1)
    val_long_side: int | None = Field(default=None, ge=MAX_STRIDE)
    val_every: int = Field(default=1, ge=0)
    val_score_threshold: float = Field(default=0.25, gt=0, lt=1)
    optimizer: OptimizerConfig = OptimizerConfig()
    schedule: ScheduleConfig = ScheduleConfig()
    loss: LossConfig = LossConfig()
    augment: AugmentConfig = AugmentConfig()
    patience: int = Field(default=0, ge=0)
    freeze_batch_norm: bool = False
    precision: Literal["fp32", "bf16", "fp16"] = "fp32"
    compile: bool = False
    bad_images: _Share = 0.01
    seed: int = Field(default=0, ge=0)
    workers: int = Field(default=1, ge=0)
    threads: int = Field(default=0, ge=0)
    device: str = "cpu"
    cache_mb: int = Field(default=1500, ge=0)
    cache_dir: str = ""

    @field_validator("data")
    @classmethod
    def _data_given(cls, data: str) -> str:
        if not data:
            raise ValueError("give the folder with the images, e.g. data=runs/images")
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_side(self.image_size, "image_size")
        if self.rectangular and self.crops:
            raise ValueError("rectangular is for whole images; leave out crops or rectangular")
        return self

    @property
    def input_side_px(self) -> int:
        """Side of what enters the network in training."""
        return self.crops.size if self.crops else self.image_size


def _check_side(side_px: int, name: str) -> None:
    if side_px % MAX_STRIDE:
        lower = side_px // MAX_STRIDE * MAX_STRIDE
        raise ValueError(f"{name} must be a multiple of {MAX_STRIDE}, got {side_px}; try {lower or MAX_STRIDE}")
