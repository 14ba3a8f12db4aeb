"""What stands behind the network in an ONNX graph: rows as they are, suppression in the graph, or TensorRT's plug-in.

Each head is a module that torch traces. The network's 1×1 convolutions may run in half precision; all that follows them
is float32, since pixels beyond 2048 have no exact half and scores decide who suppresses whom.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from autolights.core import ModelInfo
from autolights.train.deliver.tensorrt_shapes import MIN_DYNAMIC_SIDE
from autolights.train.network.model import YoloV5

# Rows that take part in suppression in the graph. The shipped nano has at most 332 rows above a score of 0.25 in 75
# simulated images and in noise, 120 in the median; the overlap matrix of 512 costs less than a millisecond.
MAX_CANDIDATES = 512
# Rounds of suppression: each settles one more link of "a suppresses b, so b cannot suppress c". The longest chain in
# those images has 3 links among scores above 0.25, 6 among all 512. An even number errs on the side of a box too many.
SUPPRESSION_ROUNDS = 8


def build_head(model: YoloV5, info: ModelInfo) -> nn.Module:
    """The module to trace: images in, the outputs of `info.head` out; for the plug-in its inputs."""
    rows = _DynamicRows(model) if info.dynamic_size else _FixedRows(model, info.size_wh)
    if info.head == "raw":
        return RawHead(rows)
    if info.head == "end2end":
        return End2EndHead(rows, info)
    return BoxesAndScoresHead(rows)


def row_count(size_wh: tuple[int, int], strides: Sequence[int]) -> int:
    """N: three anchors in every cell of every level."""
    return sum(3 * (size_wh[0] // stride) * (size_wh[1] // stride) for stride in strides)


class _Rows(nn.Module, ABC):
    """The network up to its probabilities, one row for each level, anchor, y and x.

    What a row's cell and anchor add to its decoding is a table of six columns: twice the stride for x and for y, the
    cell's offset in x and y, four times the anchor's width and height.
    """

    def __init__(self, model: YoloV5) -> None:
        super().__init__()
        self.network = model
        self.class_count = len(model.classes)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 3, H, W) → (B, N, 5 + C) after the sigmoid, (N, 6)."""
        maps = [
            convolution(feature)
            for convolution, feature in zip(self.network.detect.m, self.network.features(images), strict=True)
        ]
        logits = [_RowsOfMap.apply(logits, 5 + self.class_count) for logits in maps]
        return torch.cat(logits, dim=1).sigmoid(), self.table(maps)

    @abstractmethod
    def table(self, maps: Sequence[Tensor]) -> Tensor:
        """Per level (B, channels, rows, columns) → (N, 6)."""


class _FixedRows(_Rows):
    """For one input size: the table is a constant."""

    cells: Tensor

    def __init__(self, model: YoloV5, size_wh: tuple[int, int]) -> None:
        super().__init__(model)
        width, height = size_wh
        levels = []
        for constants, stride in zip(_table_constants(model), model.strides, strict=True):
            y = torch.arange(height // stride, device=constants.device)
            x = torch.arange(width // stride, device=constants.device)
            levels.append(_table_of_level(constants, y, x))
        self.register_buffer("cells", torch.cat(levels))

    def table(self, maps: Sequence[Tensor]) -> Tensor:
        return self.cells


class _DynamicRows(_Rows):
    """For any input size: the table is computed from the shapes of the maps."""

    constants: Tensor

    def __init__(self, model: YoloV5) -> None:
        super().__init__(model)
        self.register_buffer("constants", _table_constants(model))

    def table(self, maps: Sequence[Tensor]) -> Tensor:
        levels = []
        for level, logits in enumerate(maps):
            rows, columns = logits.shape[2:]
            y, x = torch.arange(rows, device=logits.device), torch.arange(columns, device=logits.device)
            levels.append(_table_of_level(self.constants[level], y, x))
        return torch.cat(levels)


def _table_constants(model: YoloV5) -> Tensor:
    """(levels, 5, 6): the table's rows of three anchors in cell (0, 0), then what a cell down and a cell right add."""
    constants = model.anchors.new_zeros(len(model.strides), 5, 6)
    strides = model.anchors.new_tensor(model.strides)
    constants[:, :3, 0:2] = 2 * strides.view(-1, 1, 1)
    constants[:, :3, 2:4] = -strides.view(-1, 1, 1) / 2
    constants[:, :3, 4:6] = 4 * model.anchors_px
    constants[:, 3, 3] = strides
    constants[:, 4, 2] = strides
    return constants


def _table_of_level(constants: Tensor, y: Tensor, x: Tensor) -> Tensor:
    """(5, 6), and (rows,) and (columns,) integers → (3 · rows · columns, 6), see `_Rows`."""
    anchors, down, right = torch.split(constants, [3, 1, 1])
    along_y = anchors.view(3, 1, 1, 6) + y.to(constants.dtype).view(-1, 1, 1) * down
    return (along_y + x.to(constants.dtype).view(-1, 1) * right).view(-1, 6)


def _decode(values: Tensor, cells: Tensor) -> tuple[Tensor, Tensor]:
    """(…, 4) sigmoids and (…, 6) table → centre, and width and height, both (…, 2) in input pixels.

    The equations of `Detect.decode`, sorted so that all that does not depend on the image is one constant.
    """
    xy, wh = torch.split(values, [2, 2], dim=-1)
    scales, offsets, anchors = torch.split(cells, [2, 2, 2], dim=-1)
    return xy * scales + offsets, wh * wh * anchors


class RawHead(nn.Module):
    """(B, 3, H, W) → (B, N, 5 + C), as the network in eval mode."""

    def __init__(self, rows: _Rows) -> None:
        super().__init__()
        self.rows = rows

    def forward(self, images: Tensor) -> Tensor:
        """See the class."""
        values, cells = self.rows(images)
        box_values, probs = torch.split(values, [4, 1 + self.rows.class_count], dim=-1)
        return torch.cat([*_decode(box_values, cells), probs], dim=-1)


class End2EndHead(nn.Module):
    """Greedy non-maximum suppression, whatever the classes, as matrix operators.

    Greedy suppression keeps a box if no kept better box overlaps it: ``keep = not any(keep[j] and overlaps[j, i])``
    with `overlaps` strictly upper triangular over boxes sorted by score. Started from "all are kept" and repeated,
    this gives upper and lower bounds of the greedy answer in turn, and after as many rounds as the longest chain has
    links the answer itself. No score threshold is needed: worse boxes never suppress better ones, so a reader may cut
    where it likes.
    """

    def __init__(self, rows: _Rows, info: ModelInfo) -> None:
        super().__init__()
        self.rows = rows
        self.candidates = candidate_count(info, rows.network.strides)
        self.max_detections = info.max_detections
        # intersection > t · union  ⇔  intersection > t / (1 + t) · (area + area)
        self.area_share = info.nms_iou_threshold / (1 + info.nms_iou_threshold)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """(B, 3, H, W) → boxes (B, K, 4) xyxy, scores (B, K) best first, classes (B, K), class_probs (B, K, C)."""
        values, cells = self.rows(images)
        class_count = self.rows.class_count
        _, class_probs = torch.split(values, [5, class_count], dim=-1)
        scores, best = (values[..., 4] * class_probs.amax(dim=-1)).topk(self.candidates, dim=1)
        box_values, _, class_probs = torch.split(_GatherRows.apply(values, best), [4, 1, class_count], dim=-1)
        centres, sides = _decode(box_values, cells[best])
        halves = sides * 0.5
        boxes = torch.cat([centres - halves, centres + halves], dim=-1)
        scores, kept = (scores * self._keep(boxes)).topk(self.max_detections, dim=1)
        chosen = _GatherRows.apply(torch.cat([boxes, class_probs], dim=-1), kept)
        boxes, class_probs = torch.split(chosen, [4, class_count], dim=-1)
        return boxes, scores, class_probs.argmax(dim=-1).to(torch.int32), class_probs

    def _keep(self, boxes_xyxy: Tensor) -> Tensor:
        """(B, K, 4), best first → (B, K), 1 where greedy suppression keeps and 0 where it drops."""
        left, top, right, bottom = torch.split(boxes_xyxy, [1, 1, 1, 1], dim=-1)
        width = torch.relu(torch.minimum(right, right.transpose(1, 2)) - torch.maximum(left, left.transpose(1, 2)))
        height = torch.relu(torch.minimum(bottom, bottom.transpose(1, 2)) - torch.maximum(top, top.transpose(1, 2)))
        areas = (right - left) * (bottom - top) * self.area_share
        overlaps = torch.triu((width * height > areas + areas.transpose(1, 2)).to(boxes_xyxy.dtype), diagonal=1)
        keep = 1 - overlaps.amax(dim=1, keepdim=True)
        for _ in range(SUPPRESSION_ROUNDS - 1):
            # A matrix product, but not as MatMul: TensorRT for RTX has none in float32 for compute capability 7.5.
            keep = 1 - (keep.transpose(1, 2) * overlaps).amax(dim=1, keepdim=True)
        return keep[:, 0]


def candidate_count(info: ModelInfo, strides: Sequence[int]) -> int:
    """Rows that take part in suppression: all of a small input, else `MAX_CANDIDATES`."""
    smallest = (MIN_DYNAMIC_SIDE, MIN_DYNAMIC_SIDE) if info.dynamic_size else info.size_wh
    return min(MAX_CANDIDATES, row_count(smallest, strides))


class BoxesAndScoresHead(nn.Module):
    """What TensorRT's plug-in for suppression reads; its node is put behind the traced graph."""

    def __init__(self, rows: _Rows) -> None:
        super().__init__()
        self.rows = rows

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 3, H, W) → boxes (B, N, 4) as centre and sides, scores (B, N, C) with objectness."""
        values, cells = self.rows(images)
        box_values, objectness, class_probs = torch.split(values, [4, 1, self.rows.class_count], dim=-1)
        return torch.cat(_decode(box_values, cells), dim=-1), objectness * class_probs


class _RowsOfMap(torch.autograd.Function):
    """(B, 3 · columns, H, W) → (B, 3 · H · W, columns), with shapes that hold for every batch and size.

    Traced as views it would compute each dynamic shape by nodes of its own.
    """

    @staticmethod
    def forward(ctx: Any, logits: Tensor, columns: int) -> Tensor:
        """See the class."""
        batch, _, height, width = logits.shape
        return logits.reshape(batch, 3, columns, height * width).transpose(2, 3).reshape(batch, -1, columns)

    @staticmethod
    def symbolic(g: Any, logits: Any, columns: int) -> Any:
        """In ONNX a 0 keeps the dimension and -1 takes what is left."""
        split = g.op("Reshape", logits, g.op("Constant", value_t=torch.tensor([0, 3, columns, -1])))
        last = g.op("Transpose", split, perm_i=[0, 1, 3, 2])
        return g.op("Reshape", last, g.op("Constant", value_t=torch.tensor([0, -1, columns])))


class _GatherRows(torch.autograd.Function):
    """(B, N, columns) and (B, K) indices → (B, K, columns)."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, indices: Tensor) -> Tensor:
        """See the class."""
        return rows.gather(1, indices[..., None].expand(-1, -1, rows.shape[-1]))

    @staticmethod
    def symbolic(g: Any, rows: Any, indices: Any) -> Any:
        """One node; `gather` of torch would enlarge the indices first."""
        last = g.op("Unsqueeze", indices, g.op("Constant", value_t=torch.tensor([-1])))
        return g.op("GatherND", rows, last, batch_dims_i=1)
