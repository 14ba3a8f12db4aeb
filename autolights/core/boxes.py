"""Boxes: layouts, overlap, pairs and non-maximum suppression.

Boxes are edge coordinates in pixels of the original image: (0, 0, width, height) is the whole image.
"""

import numpy as np

from autolights.core.arrays import FloatArray, IntArray

_NMS_BLOCK = 64  # boxes compared at once; with few more are done than needed, with many the pairs fill the cache


def cxcywh_from_xyxy(boxes_xyxy: FloatArray) -> FloatArray:
    """(n, 4) left, top, right, bottom → (n, 4) centre x, centre y, width, height."""
    lows, highs = boxes_xyxy[..., :2], boxes_xyxy[..., 2:]
    return np.concatenate([(lows + highs) / 2, highs - lows], axis=-1)


def cxcywh_columns(boxes_xyxy: FloatArray) -> FloatArray:
    """(n, 4) left, top, right, bottom → (4, n) centre x, centre y, width, height: points last, for quick arithmetic."""
    lows, highs = boxes_xyxy.T[:2], boxes_xyxy.T[2:]
    columns = np.empty((4, len(boxes_xyxy)))
    np.add(lows, highs, out=columns[:2])
    columns[:2] /= 2
    np.subtract(highs, lows, out=columns[2:])
    return columns


def xyxy_from_cxcywh(boxes_cxcywh: FloatArray) -> FloatArray:
    """(n, 4) centre x, centre y, width, height → (n, 4) left, top, right, bottom."""
    centres, halves = boxes_cxcywh[..., :2], boxes_cxcywh[..., 2:] / 2
    return np.concatenate([centres - halves, centres + halves], axis=-1)


def area(boxes_xyxy: FloatArray) -> FloatArray:
    """Area in px², zero for boxes that are turned inside out."""
    sides = np.maximum(boxes_xyxy[..., 2:] - boxes_xyxy[..., :2], 0)
    return np.asarray(sides[..., 0] * sides[..., 1])


def clip(boxes_xyxy: FloatArray, size_wh: tuple[int, int]) -> FloatArray:
    """Cut boxes at the image's edges; `size_wh` in pixels."""
    limits = np.array([*size_wh, *size_wh], dtype=np.float64)
    return np.clip(boxes_xyxy, 0.0, limits)


def iou_matrix(boxes_a_xyxy: FloatArray, boxes_b_xyxy: FloatArray) -> FloatArray:
    """Intersection over union of each pair.

    Args:
        boxes_a_xyxy: (n, 4) pixels.
        boxes_b_xyxy: (m, 4) pixels.

    Returns:
        (n, m) in [0, 1]; pairs without any area get 0.
    """
    lows = np.maximum(boxes_a_xyxy[:, None, :2], boxes_b_xyxy[None, :, :2])
    highs = np.minimum(boxes_a_xyxy[:, None, 2:], boxes_b_xyxy[None, :, 2:])
    sides = np.maximum(highs - lows, 0)
    intersection = sides[..., 0] * sides[..., 1]
    union = area(boxes_a_xyxy)[:, None] + area(boxes_b_xyxy)[None, :] - intersection
    return np.asarray(np.divide(intersection, union, out=np.zeros_like(intersection), where=union > 0))


def match_boxes(
    boxes_a_xyxy: FloatArray, boxes_b_xyxy: FloatArray, *, iou_threshold: float
) -> tuple[IntArray, IntArray]:
    """Pair boxes one to one, the best overlap first, whatever their classes.

    Args:
        boxes_a_xyxy: (n, 4) pixels.
        boxes_b_xyxy: (m, 4) pixels.
        iou_threshold: Pairs that overlap by less are none.

    Returns:
        Two (k,) arrays: rows of a and the rows of b that they are paired with.
    """
    overlap = iou_matrix(boxes_a_xyxy, boxes_b_xyxy)
    rows, columns = np.nonzero(overlap >= iou_threshold)
    best_first = np.argsort(-overlap[rows, columns], kind="stable")
    taken_a, taken_b = np.zeros(len(boxes_a_xyxy), dtype=bool), np.zeros(len(boxes_b_xyxy), dtype=bool)
    pairs: list[tuple[int, int]] = []
    for a, b in zip(rows[best_first], columns[best_first], strict=True):
        if not (taken_a[a] or taken_b[b]):
            taken_a[a] = taken_b[b] = True
            pairs.append((int(a), int(b)))
    matched = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return matched[:, 0], matched[:, 1]


def nms(boxes_xyxy: FloatArray, scores: FloatArray, *, iou_threshold: float, max_boxes: int) -> IntArray:
    """Greedy non-maximum suppression over all boxes, whatever their class.

    Args:
        boxes_xyxy: (n, 4) pixels.
        scores: (n,), the highest wins; equal scores keep their order.
        iou_threshold: A box that overlaps a kept one by more than this is dropped.
        max_boxes: Stop after so many.

    Returns:
        (k,) indices of the kept boxes, best first.
    """
    order = np.argsort(-scores, kind="stable")
    edges = np.ascontiguousarray(boxes_xyxy[order].T)
    kept: list[int] = []
    while order.size:
        # The best few against all that are left, at once: what remains to be done box by box is a row of "or".
        few = min(len(order), _NMS_BLOCK)
        left, top, right, bottom = edges
        intersection = np.minimum(right[:few, None], right)
        intersection -= np.maximum(left[:few, None], left)
        np.maximum(intersection, 0, out=intersection)
        heights = np.minimum(bottom[:few, None], bottom)
        heights -= np.maximum(top[:few, None], top)
        intersection *= np.maximum(heights, 0, out=heights)
        areas = np.maximum(right - left, 0) * np.maximum(bottom - top, 0)
        limit = areas[:few, None] + areas
        limit -= intersection
        limit *= iou_threshold
        overlaps = intersection > limit
        dropped = np.zeros(len(order), dtype=bool)
        for i in range(few):
            if not dropped[i]:
                kept.append(int(order[i]))
                if len(kept) == max_boxes:
                    return np.array(kept, dtype=np.int64)
                dropped |= overlaps[i]
        dropped[:few] = True
        order, edges = order[~dropped], edges[:, ~dropped]
    return np.array(kept, dtype=np.int64)
