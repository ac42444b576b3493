"""Array aliases, and read-only arrays for frozen dataclasses."""

from __future__ import annotations

import hashlib
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

__all__ = [
    "BoolArray",
    "FloatArray",
    "FrozenArrays",
    "IntArray",
    "digest",
    "frozen",
    "frozen_array",
    "product_of_columns",
    "readonly",
    "vector",
]

# Multiplications of a product of matrices; OpenBLAS distributes larger ones over threads, which then wait actively.
_LARGEST_PRODUCT = 250_000
_DOUBLE = np.dtype(np.float64)
_DIGEST_BYTES = 8  # a collision of two problems has probability 2^-64; digests detect mistakes, not attacks


def readonly(array: _Array) -> _Array:
    """Return a copy of an array in memory that cannot be made writable again.

    The memory belongs to a `bytes` object, so NumPy rejects `setflags(write=True)` on the copy and on its views.
    """
    by_columns = array.flags.f_contiguous and not array.flags.c_contiguous  # same order, so that results round equally
    order: Literal["C", "F"] = "F" if by_columns else "C"
    copied: _Array = np.ndarray(array.shape, array.dtype, array.tobytes(order), order=order)
    return copied


def product_of_columns(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return `one.T @ other`, computed by the calling thread alone.

    Args:
        one: Shape (n, k).
        other: Shape (n, m).

    Returns:
        Shape (k, m).
    """
    rows = max(1, _LARGEST_PRODUCT // max(one.shape[1] * other.shape[1], 1))
    product: FloatArray = one[:rows].T @ other[:rows]
    for start in range(rows, len(one), rows):
        product += one[start : start + rows].T @ other[start : start + rows]
    return product


class FrozenArrays:
    """Base class of frozen dataclasses with arrays: the arrays are read-only, and copying returns the object itself.

    A dataclass that defines `__post_init__` must make its arrays `readonly` in that method. Arrays restored by pickle
    are made `readonly` again.
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
    """Return the value with all its arrays, including arrays within tuples, made `readonly`."""
    if isinstance(value, np.ndarray):
        return readonly(value)
    if isinstance(value, tuple):
        make: Callable[[Iterable[object]], _Value] = getattr(value, "_make", type(value))  # keeps a named tuple
        return make(frozen(one) for one in value)
    return value


def frozen_array(values: ArrayLike, name: str, columns: int | None = None) -> FloatArray:
    """Return a read-only float64 copy of `values`, checked for shape and finiteness.

    Args:
        values: Numbers, Shape (n,) or, with `columns`, Shape (n, columns).
        name: Name of the values in error messages.
        columns: Number of columns of a two-dimensional array; None for one dimension.

    Raises:
        InvalidValue: If the shape is wrong, or if an element is text, a bool, NaN or infinite.
    """
    if type(values) is np.ndarray and values.dtype is _DOUBLE:
        array: FloatArray = values
    else:
        array = _doubles(values, name)
    wanted = "(n,)" if columns is None else f"(n, {columns})"
    if array.ndim != (1 if columns is None else 2) or (columns is not None and array.shape[1] != columns):
        raise InvalidValue(f"{name}: must have shape {wanted}, got {array.shape}")
    is_finite = np.isfinite(array)
    if not np.logical_and.reduce(is_finite, axis=None):
        bad = np.argwhere(~is_finite)[0]
        raise InvalidValue(f"{name}: must be finite, got {array[tuple(bad)]} at index {bad.tolist()}")
    return readonly(array)


def _doubles(values: ArrayLike, name: str) -> FloatArray:
    """Return numbers as an array; see `frozen_array`."""
    try:
        given = np.asarray(values)
        if given.dtype.kind == "O" and any(isinstance(one, str | bool) for one in given.ravel().tolist()):
            raise TypeError(given.dtype)
        if given.dtype.kind not in "iufO":
            raise TypeError(given.dtype)
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidValue(f"{name}: must be numbers, got {values!r}") from error


def vector(values: ArrayLike) -> FloatArray:
    """Return a number, or numbers of Shape (n,), as an array of Shape (n,); such an array is not copied."""
    if type(values) is np.ndarray and values.dtype is _DOUBLE and values.ndim == 1:
        return values
    return np.array(values, dtype=np.float64, ndmin=1)


def digest(*parts: ArrayLike | str) -> str:
    """Return a hexadecimal digest of numbers, arrays and strings; it depends on their order and shapes.

    Equal digests mean that all numbers are equal to the last bit, except that -0.0 has the digest of 0.0 and an integer
    has the digest of the equal float.
    """
    found = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    for part in parts:
        if isinstance(part, str):
            found.update(b"word" + part.encode() + b"\0")
        else:
            values = np.asarray(part, dtype=np.float64) + 0.0  # -0.0 + 0.0 is 0.0
            found.update(repr(values.shape).encode() + values.tobytes())
    return found.hexdigest()
