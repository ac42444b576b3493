"""The array aliases, and what a frozen value does with the arrays that it is given."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias, TypeVar

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

__all__ = ["BoolArray", "FloatArray", "FrozenArrays", "IntArray", "frozen_array", "readonly"]


def readonly(array: _Array) -> _Array:
    """A read-only array that no one can write to: the given one where nobody else holds it, a copy of a view.

    The memory of a view belongs to another array, through which it could still be changed.
    """
    frozen = array if array.base is None else array.copy()
    frozen.setflags(write=False)
    return frozen


class FrozenArrays:
    """A frozen value that holds arrays, and whose copies are as frozen as it is.

    Numpy's own copies and what pickle restores are writable. Nobody needs copies of what cannot change, so a copy is
    the value itself; and what pickle restores is made read-only again.
    """

    def __copy__(self: _Value) -> _Value:
        return self

    def __deepcopy__(self: _Value, memo: object) -> _Value:
        return self

    def __setstate__(self, state: Mapping[str, object]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, _frozen_again(value))


def _frozen_again(value: object) -> object:
    """Every array in a value, and in tuples of values, read-only."""
    if isinstance(value, np.ndarray):
        return readonly(value)
    if isinstance(value, tuple):
        make: Callable[[Iterable[object]], object] = getattr(value, "_make", tuple)  # a named tuple stays one
        return make(_frozen_again(one) for one in value)
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
        array = np.array(given, dtype=np.float64, copy=True)
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
