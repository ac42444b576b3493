"""Values and derivatives of terms at points of a path, by CasADi's virtual machine.

All terms of a smoother are one function of a point, which is mapped over blocks of points. The functions are built once
per thread and set of terms, in 2 to 5 ms, and share their buffers with NumPy arrays. A block of 32 points with
derivatives takes 1 to 3 us per term. Code in C would save little of that, so none is generated.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import instance
from optdock.geometry.lazy import cached_property
from smoothers.terms import SYMBOLS, HardTerm, PathTerm, SoftTerm

if TYPE_CHECKING:
    import casadi

    from optdock.geometry.arrays import FloatArray
    from smoothers.terms import TermFunction

__all__ = ["DERIVATIVES", "TermFunctions", "TermSet", "term_set"]

DERIVATIVES = len(SYMBOLS) - 1  # by all symbols except the gear, which is the last one
_BLOCK = 32  # points per evaluation: larger blocks of instructions leave the caches, smaller ones need more calls
_MOST_BLOCKS = 128  # in memory at once
_MOST_UNROLLED = 10_000  # instructions, which take 10 ms to build
_MOST_KEPT = 16  # sets of terms per thread


@dataclass(frozen=True, eq=False)
class TermSet:
    """Terms of a smoother: first the hard ones, then the soft ones."""

    hard: tuple[HardTerm, ...]
    soft: tuple[SoftTerm, ...]

    def values(self, points: FloatArray) -> FloatArray:
        """Return the values of all terms at `points`, Shape (n, 7), in the order of `SYMBOLS`. Shape (n, terms).

        A value that is not finite is NaN. Columns of symbols that are not in `reads` may have any value.
        """
        return self._functions.values.evaluated(points, self._parameters)

    def with_slopes(self, points: FloatArray) -> FloatArray:
        """Return the values of all terms, followed by their derivatives by each symbol in turn.

        Shape (n, (1 + `DERIVATIVES`) terms). A derivative may be not finite at a kink.
        """
        return self._functions.with_slopes.evaluated(points, self._parameters)

    @cached_property
    def reads(self) -> frozenset[str]:
        """Names of the symbols on which the values depend."""
        return frozenset[str]().union(*(term.function.reads for term in (*self.hard, *self.soft)))

    @cached_property
    def bounds_places(self) -> bool:
        """Whether a hard term depends on a symbol."""
        return bool(self.only_hard.reads)

    @cached_property
    def only_hard(self) -> TermSet:
        """The set of the hard terms."""
        return TermSet(self.hard, ()) if self.soft else self

    @cached_property
    def count(self) -> int:
        """Number of terms."""
        return len(self.hard) + len(self.soft)

    @cached_property
    def weights(self) -> FloatArray:
        """Weights of the soft terms [1/m]."""
        return np.array([term.weight for term in self.soft])

    @cached_property
    def _parameters(self) -> FloatArray:
        return np.array([*(value for term in (*self.hard, *self.soft) for value in term.values.values()), 0.0])

    @cached_property
    def _key(self) -> tuple[TermFunction, ...]:
        return tuple(term.function for term in (*self.hard, *self.soft))

    @property
    def _functions(self) -> TermFunctions:
        key, known = self._key, _KEPT.functions
        if key not in known:
            if len(known) >= _MOST_KEPT:
                known.clear()
            known[key] = TermFunctions(key)
        return known[key]


def term_set(terms: Iterable[PathTerm]) -> TermSet | None:
    """Return the set of some terms, or None if there are none.

    Raises:
        InvalidValue: If there is anything else than hard and soft terms, or two terms have the same name.
    """
    if isinstance(terms, PathTerm) or not isinstance(terms, Iterable):
        raise InvalidValue(f"terms: must be a list of terms, got {terms!r}; write terms=[...]")
    known: dict[str, PathTerm] = {}
    for i, term in enumerate(terms):
        name = instance(PathTerm, term, f"terms[{i}]").name
        if not isinstance(term, HardTerm | SoftTerm):
            raise InvalidValue(f"terms[{i}]: must be a HardTerm or a SoftTerm, got a {type(term).__name__}")
        if name in known:
            raise InvalidValue(f"terms[{i}]: there is another term {name!r}")
        known[name] = term
    hard = tuple(term for term in known.values() if isinstance(term, HardTerm))
    soft = tuple(term for term in known.values() if isinstance(term, SoftTerm))
    return TermSet(hard, soft) if known else None


class TermFunctions:
    """Functions of several terms with buffers, for one thread at a time.

    A last parameter, 0, is multiplied by the value and the hidden value (see `TermFunction`), so that the result is NaN
    where one of them is not finite.
    """

    def __init__(self, functions: tuple[TermFunction, ...]) -> None:
        import casadi

        point = casadi.SX.sym("point", len(SYMBOLS))
        sizes = [*(one.function.size1_in(1) for one in functions), 1]
        parameters = casadi.SX.sym("parameters", sum(sizes))
        *parts, zero = casadi.vertsplit(parameters, np.concatenate(([0], np.cumsum(sizes))).tolist())
        found = [one.function(point, part) for one, part in zip(functions, parts, strict=True)]
        value, hidden = (casadi.densify(casadi.vertcat(*column)) for column in zip(*found, strict=True))
        slopes = casadi.densify(casadi.jacobian(value, point[:DERIVATIVES]))
        shown = value + zero * (value + hidden)
        self._one = casadi.Function("value", [point, parameters], [shown])
        self._one_with_slopes = casadi.Function(
            "both", [point, parameters], [casadi.vertcat(shown, casadi.vec(slopes))]
        )

    @cached_property
    def values(self) -> _Blocks:
        """The values."""
        return _Blocks(self._one)

    @cached_property
    def with_slopes(self) -> _Blocks:
        """The values and then the derivatives."""
        return _Blocks(self._one_with_slopes)


class _Blocks:
    """A function of a point and of parameters, evaluated at blocks of points in its own memory."""

    def __init__(self, function: casadi.Function) -> None:
        mapped = function.map("blocks", "serial", _BLOCK, [1], [])
        if _BLOCK * function.n_instructions() <= _MOST_UNROLLED:  # one list of instructions is ten times faster
            mapped = mapped.expand()
        self._mapped = mapped
        self._parameters = np.zeros(function.size1_in(1))
        self._known: FloatArray | None = None  # the array with these parameters
        self._enlarge(1)

    def _enlarge(self, blocks: int) -> None:
        """Provide memory for some blocks, each with a buffer that has its addresses."""
        function, size = self._mapped, _BLOCK
        self._points = np.zeros((blocks * size, function.size1_in(0)))
        self._results = np.zeros((blocks * size, function.nnz_out(0) // size))
        self._buffers = [function.buffer() for _ in range(blocks)]
        for k, (buffer, _) in enumerate(self._buffers):
            own = slice(k * size, (k + 1) * size)
            buffer.set_arg(0, _memory(self._points[own]))  # type: ignore[call-arg]  # the stub declares only the C form
            buffer.set_arg(1, _memory(self._parameters))  # type: ignore[call-arg]
            buffer.set_res(0, _memory(self._results[own]))  # type: ignore[call-arg]

    def evaluated(self, points: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the output at the points, one row per point."""
        count, most = len(points), _BLOCK * _MOST_BLOCKS
        if count > most:
            parts = [self.evaluated(points[begin : begin + most], parameters) for begin in range(0, count, most)]
            return np.concatenate(parts)
        blocks = -(-count // _BLOCK)
        if blocks > len(self._buffers):
            self._enlarge(min(2 * blocks, _MOST_BLOCKS))
        if parameters is not self._known:
            self._parameters[:], self._known = parameters, parameters
        self._points[:count] = points  # the points behind are those of an earlier evaluation
        for _, run in self._buffers[:blocks]:
            run()
        results: FloatArray = self._results[:count].copy()
        return results


def _memory(values: FloatArray) -> memoryview:
    """Return the memory of an array in its storage order; the address is stored in casadi's buffer."""
    return memoryview(values.ravel(order="K"))  # type: ignore[arg-type]  # numpy's stubs do not declare the buffer


class _Kept(threading.local):
    def __init__(self) -> None:
        self.functions: dict[tuple[TermFunction, ...], TermFunctions] = {}


_KEPT = _Kept()
