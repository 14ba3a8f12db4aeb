"""YOLOv5 v6: CSP-Darknet, SPPF, PAN and three anchor levels, in five sizes; a fourth, finer level on request.

Module names are those of the public checkpoints (``model.N.…``, N from 0 to 24), so that their state dicts load.
"""

import math
from collections.abc import Sequence
from typing import Literal, cast

import torch
from torch import Tensor, nn

from autolights.core.model_info import InitialWeights

Size = Literal["n", "s", "m", "l", "x"]

# (depth, width): how often blocks repeat and how wide they are, as multiples of size l
SIZES: dict[Size, tuple[float, float]] = {
    "n": (0.33, 0.25),
    "s": (0.33, 0.50),
    "m": (0.67, 0.75),
    "l": (1.0, 1.0),
    "x": (1.33, 1.25),
}
STRIDES = (8, 16, 32)
FINE_STRIDES = (8, 16, 32, 4)  # the added level comes last, so that the published ones keep their names and rows
MAX_STRIDE = 32  # sides of the input must be multiples of it
# By stride, three (width, height) in pixels; clustered on COCO by the authors of YOLOv5. Those of stride 4 are ours:
# half of stride 8's, as a cell is half as wide.
ANCHORS_PX = {
    8: ((10.0, 13.0), (16.0, 30.0), (33.0, 23.0)),
    16: ((30.0, 61.0), (62.0, 45.0), (59.0, 119.0)),
    32: ((116.0, 90.0), (156.0, 198.0), (373.0, 326.0)),
    4: ((5.0, 6.5), (8.0, 15.0), (16.5, 11.5)),
}


class Conv(nn.Module):
    """Convolution without bias, batch norm, SiLU; keeps the size at stride 1."""

    def __init__(
        self, in_channels: int, out_channels: int, kernel: int = 1, stride: int = 1, padding: int | None = None
    ) -> None:
        super().__init__()
        padding = kernel // 2 if padding is None else padding
        self.conv = nn.Conv2d(in_channels, out_channels, kernel, stride, padding, bias=False)
        self.bn = nn.BatchNorm2d(out_channels, eps=1e-3, momentum=0.03)
        self.act = nn.SiLU()

    def forward(self, x: Tensor) -> Tensor:
        """(B, in, H, W) → (B, out, H / stride, W / stride)."""
        return cast(Tensor, self.act(self.bn(self.conv(x))))


class Bottleneck(nn.Module):
    """1×1 and 3×3 convolution, added to their input if `shortcut`."""

    def __init__(self, channels: int, *, shortcut: bool) -> None:
        super().__init__()
        self.cv1 = Conv(channels, channels)
        self.cv2 = Conv(channels, channels, kernel=3)
        self.shortcut = shortcut

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) → the same shape."""
        y = cast(Tensor, self.cv2(self.cv1(x)))
        return x + y if self.shortcut else y


class C3(nn.Module):
    """Cross-stage partial block: bottlenecks on one half of the channels, the other half passes by."""

    def __init__(self, in_channels: int, out_channels: int, repeats: int, *, shortcut: bool) -> None:
        super().__init__()
        hidden = out_channels // 2
        self.cv1 = Conv(in_channels, hidden)
        self.cv2 = Conv(in_channels, hidden)
        self.cv3 = Conv(2 * hidden, out_channels)
        self.m = nn.Sequential(*(Bottleneck(hidden, shortcut=shortcut) for _ in range(repeats)))

    def forward(self, x: Tensor) -> Tensor:
        """(B, in, H, W) → (B, out, H, W)."""
        return cast(Tensor, self.cv3(torch.cat([self.m(self.cv1(x)), self.cv2(x)], dim=1)))


class SPPF(nn.Module):
    """Three chained max-pools see 5, 9 and 13 cells around each; they are put beside the input."""

    def __init__(self, in_channels: int, out_channels: int, kernel: int = 5) -> None:
        super().__init__()
        hidden = in_channels // 2
        self.cv1 = Conv(in_channels, hidden)
        self.cv2 = Conv(4 * hidden, out_channels)
        self.m = nn.MaxPool2d(kernel, stride=1, padding=kernel // 2)

    def forward(self, x: Tensor) -> Tensor:
        """(B, in, H, W) → (B, out, H, W)."""
        levels = [self.cv1(x)]
        for _ in range(3):
            levels.append(self.m(levels[-1]))
        return cast(Tensor, self.cv2(torch.cat(levels, dim=1)))


class FineLevel(nn.Module):
    """The neck's next step up: features of stride 8, enlarged, beside the backbone's of stride 4."""

    def __init__(self, coarse_channels: int, channels: int, repeats: int) -> None:
        super().__init__()
        self.reduce = Conv(coarse_channels, channels)
        self.enlarge = nn.Upsample(scale_factor=2, mode="nearest")
        self.merge = C3(2 * channels, channels, repeats, shortcut=False)

    def forward(self, coarse: Tensor, fine: Tensor) -> Tensor:
        """(B, coarse, H / 8, W / 8) and (B, C, H / 4, W / 4) → (B, C, H / 4, W / 4)."""
        return cast(Tensor, self.merge(torch.cat([self.enlarge(self.reduce(coarse)), fine], dim=1)))


class Detect(nn.Module):
    """One 1×1 convolution per level: for each cell and anchor a box, an objectness and C classes."""

    anchors: Tensor

    def __init__(self, in_channels: Sequence[int], strides: Sequence[int], class_count: int) -> None:
        super().__init__()
        self.class_count = class_count
        self.strides = tuple(strides)
        # In units of each level's cells, as in the public checkpoints.
        anchors = torch.stack([torch.tensor(ANCHORS_PX[stride]) / stride for stride in self.strides])
        self.register_buffer("anchors", anchors)
        self.m = nn.ModuleList(nn.Conv2d(channels, 3 * (5 + class_count), 1) for channels in in_channels)
        self._start_biases()

    def _start_biases(self) -> None:
        """Start with what is known: about 8 objects in an image of 640 px, classes equally rare."""
        for conv, stride in zip(self.m, self.strides, strict=True):
            bias = cast(nn.Conv2d, conv).bias
            assert bias is not None
            with torch.no_grad():
                rows = bias.view(3, 5 + self.class_count)
                rows[:, 4] += math.log(8 / (640 / stride) ** 2)
                rows[:, 5:] += math.log(0.6 / (self.class_count - 0.99999))

    def forward(self, features: Sequence[Tensor]) -> list[Tensor]:
        """Per level (B, in, H, W) → (B, 3, H, W, 5 + C) of logits."""
        maps = []
        for conv, feature in zip(self.m, features, strict=True):
            y = conv(feature)
            batch, _, height, width = y.shape
            maps.append(y.view(batch, 3, 5 + self.class_count, height, width).permute(0, 1, 3, 4, 2))
        return maps

    def decode(self, maps: Sequence[Tensor]) -> Tensor:
        """Logits → (B, N, 5 + C): centre, width, height in input pixels, objectness, class probabilities.

        Rows run over levels, then anchors, y and x.
        """
        rows = []
        for level, (logits, stride) in enumerate(zip(maps, self.strides, strict=True)):
            _, _, height, width, columns = logits.shape
            y, x = torch.meshgrid(
                torch.arange(height, device=logits.device, dtype=logits.dtype),
                torch.arange(width, device=logits.device, dtype=logits.dtype),
                indexing="ij",
            )
            cells = torch.stack([x, y], dim=-1)
            anchors_px = (self.anchors[level] * stride).view(1, 3, 1, 1, 2)
            values = logits.sigmoid()
            centres = (values[..., 0:2] * 2 - 0.5 + cells) * stride
            sides = (values[..., 2:4] * 2) ** 2 * anchors_px
            decoded = torch.cat([centres, sides, values[..., 4:]], dim=-1)
            rows.append(decoded.reshape(logits.shape[0], 3 * height * width, columns))
        return torch.cat(rows, dim=1)


class YoloV5(nn.Module):
    """The detector network.

    In training mode a call gives a map (B, 3, H, W, 5 + C) of logits per level, in eval mode the decoded
    (B, N, 5 + C).

    Attributes:
        size: One of n, s, m, l, x.
        classes: Their names.
        initial_weights: What its training started from; None if from nothing or not known.
    """

    def __init__(
        self, size: Size, class_count: int, classes: Sequence[str] = (), *, strides: Sequence[int] = STRIDES
    ) -> None:
        """Build a network with random weights.

        Args:
            size: One of n, s, m, l, x.
            class_count: C.
            classes: Their names; without any they are called by their numbers.
            strides: Of the levels, pixels: `STRIDES` as published, or `FINE_STRIDES` with one more for small objects.

        Raises:
            ValueError: If there is no class, the names are not as many as the classes, or the strides are others.
        """
        super().__init__()
        if class_count < 1 or (classes and len(classes) != class_count):
            raise ValueError(f"class_count must be at least 1 and fit the names, got {class_count} and {len(classes)}")
        if tuple(strides) not in (STRIDES, FINE_STRIDES):
            raise ValueError(f"strides must be {STRIDES} or {FINE_STRIDES}, got {tuple(strides)}")
        self.size = size
        self.classes = tuple(classes) or tuple(str(i) for i in range(class_count))
        self.initial_weights: InitialWeights | None = None
        depth, width = SIZES[size]
        c1, c2, c3, c4, c5 = (math.ceil(channels * width / 8) * 8 for channels in (64, 128, 256, 512, 1024))
        few, some, many = (max(round(repeats * depth), 1) for repeats in (3, 6, 9))
        is_fine = tuple(strides) == FINE_STRIDES
        self.model = nn.ModuleList(
            [
                Conv(3, c1, kernel=6, stride=2, padding=2),  # 0
                Conv(c1, c2, kernel=3, stride=2),  # 1
                C3(c2, c2, few, shortcut=True),  # 2: stride 4
                Conv(c2, c3, kernel=3, stride=2),  # 3
                C3(c3, c3, some, shortcut=True),  # 4: stride 8
                Conv(c3, c4, kernel=3, stride=2),  # 5
                C3(c4, c4, many, shortcut=True),  # 6: stride 16
                Conv(c4, c5, kernel=3, stride=2),  # 7
                C3(c5, c5, few, shortcut=True),  # 8
                SPPF(c5, c5),  # 9: stride 32
                Conv(c5, c4),  # 10
                nn.Upsample(scale_factor=2, mode="nearest"),  # 11
                nn.Identity(),  # 12: beside 6
                C3(2 * c4, c4, few, shortcut=False),  # 13
                Conv(c4, c3),  # 14
                nn.Upsample(scale_factor=2, mode="nearest"),  # 15
                nn.Identity(),  # 16: beside 4
                C3(2 * c3, c3, few, shortcut=False),  # 17: stride 8 out
                Conv(c3, c3, kernel=3, stride=2),  # 18
                nn.Identity(),  # 19: beside 14
                C3(2 * c3, c4, few, shortcut=False),  # 20: stride 16 out
                Conv(c4, c4, kernel=3, stride=2),  # 21
                nn.Identity(),  # 22: beside 10
                C3(2 * c4, c5, few, shortcut=False),  # 23: stride 32 out
                Detect((c3, c4, c5, c2) if is_fine else (c3, c4, c5), strides, class_count),  # 24
            ]
        )
        self.fine = FineLevel(c3, c2, few) if is_fine else None

    @property
    def detect(self) -> Detect:
        """The last layer."""
        return cast(Detect, self.model[24])

    @property
    def strides(self) -> tuple[int, ...]:
        """Pixels in a cell of each level, in the order of maps, anchors and rows."""
        return self.detect.strides

    @property
    def anchors(self) -> Tensor:
        """(levels, 3, 2) width and height of each level's anchors, in cells of the level."""
        return self.detect.anchors

    @property
    def anchors_px(self) -> Tensor:
        """(levels, 3, 2) the same in pixels of the input."""
        return self.anchors * self._cell_sides()

    def set_anchors(self, anchors_px: Tensor) -> None:
        """Replace the anchors: (levels, 3, 2) in pixels of the input, levels in the order of `strides`."""
        self.anchors.copy_(anchors_px.to(self.anchors) / self._cell_sides())

    def _cell_sides(self) -> Tensor:
        return self.anchors.new_tensor(self.strides).view(-1, 1, 1)

    def logits(self, images: Tensor) -> list[Tensor]:
        """(B, 3, H, W) RGB in [0, 1], sides multiples of 32 → per level (B, 3, H / stride, W / stride, 5 + C)."""
        return self.detect.forward(self.features(images))

    def features(self, images: Tensor) -> list[Tensor]:
        """(B, 3, H, W) as for `logits` → per level (B, channels, H / stride, W / stride), what the last layer sees."""
        layers = self.model
        x = images
        kept: dict[int, Tensor] = {}
        for i in range(10):
            x = layers[i](x)
            if i in (2, 4, 6):
                kept[i] = x
        down32 = layers[10](x)
        x = layers[13](torch.cat([layers[11](down32), kept[6]], dim=1))
        down16 = layers[14](x)
        out8 = layers[17](torch.cat([layers[15](down16), kept[4]], dim=1))
        out16 = layers[20](torch.cat([layers[18](out8), down16], dim=1))
        out32 = layers[23](torch.cat([layers[21](out16), down32], dim=1))
        features = [out8, out16, out32]
        if self.fine is not None:
            features.append(self.fine(out8, kept[2]))
        return features

    def forward(self, images: Tensor) -> Tensor | list[Tensor]:
        """See the class."""
        maps = self.logits(images)
        return maps if self.training else self.detect.decode(maps)
