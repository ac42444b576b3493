"""The array aliases, and what a frozen value does with the arrays that it is given."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from numpy.typing import ArrayLike

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

_Array = TypeVar("_Array", bound="NDArray[np.generic]")
_Value = TypeVar("_Value")

__all__ = ["BoolArray", "FloatArray", "FrozenArrays", "IntArray", "frozen", "frozen_array", "readonly"]


def readonly(array: _Array) -> _Array:
    """A copy of an array in memory that cannot be written to.

    The memory is that of a `bytes` object that is not held elsewhere. The holder of an array that owns its memory can
    take the read-only flag back with `setflags(write=True)`; of this one, and of its views, numpy refuses that.
    """
    by_columns = array.flags.f_contiguous and not array.flags.c_contiguous  # what is computed of it rounds alike
    order: Literal["C", "F"] = "F" if by_columns else "C"
    copied: _Array = np.ndarray(array.shape, array.dtype, array.tobytes(order), order=order)
    return copied


class FrozenArrays:
    """A frozen value that holds arrays in memory that cannot be written to, and whose copies are as frozen as it is.

    A dataclass that checks nothing gets that from here; one with a `__post_init__` of its own makes its arrays
    `readonly` there.

    Numpy's own copies and what pickle restores are writable. What cannot change needs no copies, so a copy is
    the value itself; and what pickle restores is made `readonly` again.
    """

    def __post_init__(self) -> None:
        self.__setstate__(vars(self).copy())

    def __copy__(self: _Value) -> _Value:
        return self

    def __deepcopy__(self: _Value, memo: object) -> _Value:
        return self

    def __setstate__(self, state: Mapping[str, object]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, frozen(value))


def frozen(value: _Value) -> _Value:
    """A value with every array in it, and in tuples of values, `readonly`."""
    if isinstance(value, np.ndarray):
        return readonly(value)
    if isinstance(value, tuple):
        make: Callable[[Iterable[object]], _Value] = getattr(value, "_make", type(value))  # a named tuple stays one
        return make(frozen(one) for one in value)
    return value


def frozen_array(values: ArrayLike, name: str, columns: int | None = None) -> FloatArray:
    """A read-only float64 copy of `values`, checked for shape and finiteness.

    Args:
        values: Numbers, Shape (n,) or, with `columns`, Shape (n, columns).
        name: What the values are called in error messages.
        columns: Number of columns of a two-dimensional array; None for one dimension.

    Raises:
        InvalidValue: Wrong shape, not numbers (text and switches are none), NaN or infinity.
    """
    try:
        given = np.asarray(values)
        if given.dtype.kind not in "iufO" or any(isinstance(one, str | bool) for one in _objects(given)):
            raise TypeError(given.dtype)
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidValue(f"{name}: must be numbers, got {values!r}") from error
    wanted = "(n,)" if columns is None else f"(n, {columns})"
    if array.ndim != (1 if columns is None else 2) or (columns is not None and array.shape[1] != columns):
        raise InvalidValue(f"{name}: must have shape {wanted}, got {array.shape}")
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        raise InvalidValue(f"{name}: must be finite, got {array[tuple(bad[0])]} at index {bad[0].tolist()}")
    return readonly(array)


def _objects(array: NDArray[np.generic]) -> Iterable[object]:
    """The elements of an array that numpy found no type for."""
    return array.ravel().tolist() if array.dtype.kind == "O" else ()
