"""Array types and the checks that frozen dataclasses of arrays make once."""

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.floating[Any]]
IntArray: TypeAlias = npt.NDArray[np.integer[Any]]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
ImageArray: TypeAlias = npt.NDArray[np.uint8]


def as_float_array(values: Any, shape: Sequence[int | None], name: str, *, finite: bool = True) -> FloatArray:
    """Convert to float64, check the shape and forbid later writes.

    Args:
        values: Anything that numpy can read. An array that is already float64 is viewed, not copied.
        shape: Expected shape; None stands for any length.
        name: How the error calls the value.
        finite: Also refuse NaN and infinity.

    Raises:
        ValueError: If the shape differs or a value is not finite.
    """
    array: FloatArray = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        array = _fitted(array, shape, name)
    if finite and not math.isfinite(array.sum()) and not np.isfinite(array).all():  # a sum costs less, but may overflow
        raise ValueError(f"{name} must be finite, got {np.count_nonzero(~np.isfinite(array))} NaN or infinite values")
    view = array.view()
    view.flags.writeable = False
    return view


def _fitted(array: FloatArray, shape: Sequence[int | None], name: str) -> FloatArray:
    if array.size == 0 and len(shape) > 1 and shape[0] is None:
        array = array.reshape(0, *(length or 0 for length in shape[1:]))
    matches = array.ndim == len(shape) and all(
        want is None or want == got for want, got in zip(shape, array.shape, strict=True)
    )
    if not matches:
        wanted = ", ".join("n" if length is None else str(length) for length in shape)
        raise ValueError(f"{name} must have shape ({wanted}), got {array.shape}")
    return array
