"""Kernels: functions in C99 beside their NumPy twins, called by `ctypes` on arrays with documented shapes.

A kernel is a file `<module>_kernel.c` beside the module with its twin, which is the reference. The environment variable
`OPTDOCK_KERNELS` selects the lane of a process:

- `native`: the kernels; an error if the library cannot be used;
- `twin`: NumPy alone;
- `audit`: both, and `KernelMismatch` is raised where they differ by more than 1e-12.

By default the kernels are used if the library is there. It is rejected if its interface number is another, if it was
compiled from other sources than those beside the modules, or if its arithmetic is not that of NumPy. The first call of
every kernel in a process also runs its twin; a kernel that differs is replaced by its twin.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, ParamSpec, TypeAlias, TypeVar, get_args

import numpy as np

from optdock.build_kernels import LIBRARY, digest_of
from optdock.deadline import uncounted
from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

__all__ = ["ABI", "Kernel", "KernelMismatch", "Lane", "kernels_in_use", "kernels_lane", "twin_of", "using_kernels"]

logger = logging.getLogger(__name__)

Lane: TypeAlias = Literal["native", "twin", "audit"]

ABI = 1
_VARIABLE = "OPTDOCK_KERNELS"
_TOLERANCE = 1e-12  # relative to the larger of 1 and the value
_SELF_TESTED = (1.0 + 2.0**-27, float("nan"), 2.0, 2.0**-1040)
_FAILURES = ("contraction of products", "comparisons with NaN", "square roots", "subnormal numbers", "rounding")
_DOUBLE, _INT = np.dtype(np.float64), np.dtype(np.int64)
# Returns an empty array of `ctypes` at the address of a NumPy array.
_at_address_of: Callable[[object], object] = (ctypes.c_char * 0).from_buffer  # type: ignore[assignment]

_P = ParamSpec("_P")
_R = TypeVar("_R")


class KernelMismatch(RuntimeError):
    """A kernel and its NumPy twin differ, which is an error in one of them."""


class _Library(NamedTuple):
    """The loaded library, or None and the reason."""

    handle: ctypes.CDLL | None
    reason: str
    is_expected: bool  # whether the reason is that no library was compiled


def load_library(path: Path, root: Path) -> _Library:
    """Load and check the library of the kernels of the packages in the folder `root`."""
    if not path.is_file():
        return _Library(None, f"{path} was not compiled", is_expected=True)
    try:
        loaded = ctypes.CDLL(str(path))
        handle: ctypes.CDLL | None = loaded
        fault = _fault(loaded, root)
    except (OSError, AttributeError) as error:
        handle, fault = None, f"cannot be loaded ({error})"
    if fault:
        handle, fault = None, f"{path}: {fault}; compile it with `python -m optdock.build_kernels`"
    return _Library(handle, fault, is_expected=False)


def _fault(handle: ctypes.CDLL, root: Path) -> str:
    """Return why a library must not be used, or an empty string."""
    abi, digest, sources, test = (
        getattr(handle, f"optdock_kernels_{name}") for name in ("abi", "digest", "sources", "self_test")
    )
    abi.restype = test.restype = ctypes.c_int64
    digest.restype = sources.restype = ctypes.c_char_p
    test.argtypes = (ctypes.c_void_p,)
    if abi() != ABI:
        return f"has interface {abi()} instead of {ABI}"
    try:
        present = digest_of(root, [Path(name) for name in sources().decode().split()])
    except OSError as error:
        return f"its sources cannot be read ({error})"
    if present != digest().decode():
        return "was compiled from other sources than those beside the modules"
    failure = test((ctypes.c_double * len(_SELF_TESTED))(*_SELF_TESTED))
    return f"fails its self-test ({_FAILURES[failure - 1]})" if failure else ""


@functools.cache
def _library() -> _Library:
    root = Path(__file__).resolve().parents[1]
    found = load_library(root / LIBRARY, root)
    if found.handle is None and not found.is_expected:
        logger.warning("the kernels in C are not used: %s", found.reason)
    return found


class _OfProcess:
    lane: Lane | None = None  # None until the first kernel is called
    tested: set[str]
    replaced: set[str]


_OfProcess.tested, _OfProcess.replaced = set(), set()


def kernels_lane() -> Lane:
    """Return the lane of this process.

    Raises:
        InvalidValue: If the environment variable has an unknown value, or requires kernels that cannot be used.
    """
    if _OfProcess.lane is None:
        _OfProcess.lane = _checked(os.environ.get(_VARIABLE) or None)
    return _OfProcess.lane


def _checked(wanted: str | None) -> Lane:
    lanes: dict[str | None, Lane] = {lane: lane for lane in get_args(Lane)}
    if wanted is None:
        return "native" if _library().handle is not None else "twin"
    if wanted not in lanes:
        raise InvalidValue(f"{_VARIABLE}: must be one of {', '.join(get_args(Lane))}, got {wanted!r}")
    if wanted != "twin" and _library().handle is None:
        raise InvalidValue(f"{_VARIABLE}: {wanted} needs the kernels in C: {_library().reason}")
    return lanes[wanted]


@contextlib.contextmanager
def using_kernels(lane: Lane) -> Iterator[None]:
    """Use a lane in all threads of this process within the context, and then the previous lane again.

    Raises:
        InvalidValue: If the lane is unknown, or requires kernels that cannot be used.
    """
    before, _OfProcess.lane = _OfProcess.lane, _checked(lane)
    try:
        yield
    finally:
        _OfProcess.lane = before


def kernels_in_use() -> str:
    """Return a line that tells which kernels run, and why.

    Raises:
        InvalidValue: As `kernels_lane`.
    """
    lane = kernels_lane()
    if lane != "twin":
        also = " and NumPy twins, compared" if lane == "audit" else ""
        without = f", NumPy for {', '.join(sorted(_OfProcess.replaced))}" if _OfProcess.replaced else ""
        return f"kernels: C (interface {ABI}){also}{without}"
    reason = _library().reason or f"{_VARIABLE}=twin"
    return f"kernels: NumPy ({reason})"


class Kernel:
    """A function of the library.

    Args:
        symbol: Name of the function; its parameters are the sizes (int64_t), the numbers (double) and the arrays; it
            returns an int64_t.
        sizes: Number of sizes.
        numbers: Number of numbers.
    """

    def __init__(self, symbol: str, sizes: int, numbers: int) -> None:
        self._symbol = symbol
        self._counts = sizes, numbers
        self._function: ctypes._NamedFuncPointer | None = None

    def _with_types(self, sizes: tuple[int, ...], numbers: tuple[float, ...], arrays: int) -> ctypes._NamedFuncPointer:
        """Return the function with the types of its arguments, which are set by the first call."""
        if (len(sizes), len(numbers)) != self._counts:
            raise ValueError(f"{self._symbol}: {len(sizes)} sizes and {len(numbers)} numbers")
        handle = _library().handle
        assert handle is not None
        function = handle[self._symbol]
        function.restype = ctypes.c_int64
        function.argtypes = (
            *(ctypes.c_int64,) * len(sizes),
            *(ctypes.c_double,) * len(numbers),
            *(ctypes.c_void_p,) * arrays,
        )
        self._function = function  # now that its types are set, for calls in other threads
        return function

    def __call__(
        self,
        sizes: tuple[int, ...],
        numbers: tuple[float, ...],
        arrays: tuple[tuple[NDArray[np.float64] | NDArray[np.int64], int], ...],
    ) -> int:
        """Call the function.

        Args:
            sizes: Numbers of elements, and other integers.
            numbers: Floating-point numbers.
            arrays: Arrays, each with the number of elements that the function reads or writes.

        Raises:
            ValueError: If an array is not a contiguous array of doubles or int64, or has another number of elements;
                in the first call, if there are other numbers of `sizes` or `numbers`.
        """
        # `ctypes` passes the address of a `bytes` object and of an array of its own. `array.ctypes` takes four times as
        # long as each of the two others.
        arguments: list[object] = [*sizes, *numbers]
        for array, count in arrays:
            if array.size != count or array.dtype not in (_DOUBLE, _INT):
                raise self._wrong(array, count, arguments)
            base: object = array.base
            if type(base) is bytes and len(base) == array.nbytes and array.flags.c_contiguous:
                arguments += (base,)  # see `geometry.arrays.readonly`
                continue
            try:
                arguments += (_at_address_of(array),)
            except TypeError:  # of read-only arrays, and of those that are not contiguous
                if not array.flags.c_contiguous:
                    raise self._wrong(array, count, arguments) from None
                arguments += (array.ctypes.data,)
        function = self._function or self._with_types(sizes, numbers, len(arrays))
        return int(function(*arguments))

    def _wrong(self, array: NDArray[Any], count: int, before: list[object]) -> ValueError:
        """Return the error for an array, given the arguments before it."""
        place = len(before) - sum(self._counts)
        told = f"{array.dtype} {array.shape}, contiguous: {array.flags.c_contiguous}"
        return ValueError(f"{self._symbol}: array {place} must be contiguous with {count} elements, got {told}")


def twin_of(
    native: Callable[_P, _R], copied: Callable[..., tuple[object, ...]] | None = None
) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Return a decorator for the NumPy twin of `native`; the decorated function runs what the lane requires.

    `native` calls a `Kernel` and has the arguments and results of the twin. In an audit the decorated function raises
    `KernelMismatch` if they differ.

    Args:
        native: The function in C.
        copied: Returns the positional arguments for the twin, where `native` changes its own; None if it changes none.
    """

    def decorate(twin: Callable[_P, _R]) -> Callable[_P, _R]:
        name = f"{twin.__module__}.{twin.__qualname__}"

        @functools.wraps(twin)
        def chosen(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            lane = _OfProcess.lane or kernels_lane()
            if lane == "twin" or name in _OfProcess.replaced:
                return twin(*args, **kwargs)
            if lane == "native" and name in _OfProcess.tested:
                return native(*args, **kwargs)
            given: Any = args if copied is None else copied(*args)
            other = native(*args, **kwargs)
            # The twin is not run in later calls. It comes second, because it may fill caches that the kernel uses too.
            with uncounted():
                found = twin(*given, **kwargs)
            _judge(name, lane, _difference(found, other))
            return found if lane == "audit" or name in _OfProcess.replaced else other  # as in later calls

        return chosen

    return decorate


def _judge(name: str, lane: Lane, differs: str) -> None:
    """Note that a kernel was compared with its twin; raise `KernelMismatch` or replace it if they differ."""
    if differs and lane == "audit":
        raise KernelMismatch(f"{name}: {differs}")
    if differs:
        logger.warning("%s: the kernel in C is not used, it differs from NumPy: %s", name, differs)
        _OfProcess.replaced.add(name)
    _OfProcess.tested.add(name)


def _difference(first: object, second: object) -> str:
    """Return how two results differ, or an empty string."""
    if isinstance(first, tuple) and isinstance(second, tuple):
        parts = [_difference(a, b) for a, b in zip(first, second, strict=False)]
        told = [f"part {i}: {part}" for i, part in enumerate(parts) if part]
        return "; ".join(told) if len(first) == len(second) else f"{len(first)} and {len(second)} parts"
    if isinstance(first, tuple) or isinstance(second, tuple):  # the other is None
        return f"{type(first).__name__} and {type(second).__name__}"
    a, b = np.asarray(first), np.asarray(second)
    if a.shape != b.shape or a.dtype != b.dtype:
        return f"{a.dtype} {a.shape} and {b.dtype} {b.shape}"
    if a.dtype.kind != "f":
        same = a == b
    else:
        with np.errstate(invalid="ignore"):
            close = np.isfinite(a) & (np.abs(a - b) <= _TOLERANCE * np.maximum(1.0, np.abs(a)))
        same = close | (a == b) | (np.isnan(a) & np.isnan(b))
    if np.all(same):
        return ""
    at = tuple(np.argwhere(~same)[0].tolist())
    return f"{a[at]} and {b[at]} at {at}"
