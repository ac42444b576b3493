"""The one array alias and the one way to freeze an array."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

__all__ = ["BoolArray", "FloatArray", "IntArray", "frozen_array", "readonly"]


def readonly(array: FloatArray) -> FloatArray:
    """Mark an array that nobody else holds as read-only and return it."""
    array.setflags(write=False)
    return array


def frozen_array(values: ArrayLike, name: str, columns: int | None = None) -> FloatArray:
    """A read-only float64 copy of `values`, checked for shape and finiteness.

    Args:
        values: Numbers, Shape (n,) or, with `columns`, Shape (n, columns).
        name: What the values are called in error messages.
        columns: Number of columns of a two-dimensional array; None for one dimension.

    Raises:
        InvalidValue: Wrong shape, not numbers, NaN or infinity.
    """
    try:
        array = np.array(values, dtype=np.float64, copy=True)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidValue(f"{name}: must be numbers, got {values!r}") from error
    wanted = "(n,)" if columns is None else f"(n, {columns})"
    if array.ndim != (1 if columns is None else 2) or (columns is not None and array.shape[1] != columns):
        raise InvalidValue(f"{name}: must have shape {wanted}, got {array.shape}")
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        raise InvalidValue(f"{name}: must be finite, got {array[tuple(bad[0])]} at index {bad[0].tolist()}")
    return readonly(array)
