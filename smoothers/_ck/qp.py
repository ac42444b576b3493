"""Small dense convex programs through `casadi.conic`: DAQP first, PIQP where it fails.

min 0.5 z'Hz + g'z, lower <= z <= upper, row_lower <= Az <= row_upper. Programs are built per size and reused through
casadi's buffers, which read and write numpy memory without a copy.
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

import casadi
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from optdock.geometry.arrays import FloatArray

__all__ = ["UNBOUNDED", "DenseProgram", "ProgramPool", "pool_of_this_thread"]

UNBOUNDED = 1e30  # how DAQP spells infinity
_ARGUMENTS = ("h", "g", "a", "lba", "uba", "lbx", "ubx")


def _plugin(name: str, size: int, rows: int, options: Mapping[str, Mapping[str, str]]) -> casadi.Function:
    shapes = {"h": casadi.Sparsity.dense(size, size), "a": casadi.Sparsity.dense(rows, size)}
    return casadi.conic(f"step_{name}", name, shapes, {"error_on_fail": False, **options})


def _memory(values: FloatArray) -> memoryview:
    return memoryview(values.ravel(order="K"))  # type: ignore[arg-type]  # numpy's stubs do not declare the buffer


class DenseProgram:
    """A program of fixed size whose arrays are filled in place, in Fortran order, and solved.

    Args:
        size: Number of variables.
        rows: Number of general constraints; unused ones keep zero rows and infinite bounds.
    """

    def __init__(self, size: int, rows: int) -> None:
        self.h, self.a = np.zeros((size, size), order="F"), np.zeros((rows, size), order="F")
        self.g, self.lbx, self.ubx = np.zeros(size), np.zeros(size), np.zeros(size)
        self.lba, self.uba = np.full(rows, -UNBOUNDED), np.full(rows, UNBOUNDED)
        self._solution = np.zeros(size)
        self._primary = _plugin("daqp", size, rows, {})
        self._buffer, self._run = self._bound()

    def _bound(self) -> tuple[casadi.FunctionBuffer, Callable[[], None]]:
        buffer, run = self._primary.buffer()
        for name in _ARGUMENTS:
            # A view in memory order: the buffer keeps the address, so the arrays must never be replaced.
            values: FloatArray = getattr(self, name)
            # casadi's stub knows the C form of the two setters only.
            buffer.set_arg(self._primary.index_in(name), _memory(values))  # type: ignore[call-arg]
        buffer.set_res(self._primary.index_out("x"), _memory(self._solution))  # type: ignore[call-arg]
        return buffer, run

    def solve(self) -> FloatArray | None:
        """The minimizer, or None where no solver finds one. Shape (size,)."""
        try:
            self._run()
        except RuntimeError:  # casadi's one exception, for example where a lower bound exceeds its upper bound
            return None
        # On failure DAQP leaves the previous solution behind, and NaN input passes for a success.
        if self._buffer.stats()["success"] and bool(np.isfinite(self._solution).all()):
            solution: FloatArray = self._solution.copy()
            return solution
        return self.solve_slowly()

    def solve_slowly(self) -> FloatArray | None:
        """The minimizer by PIQP, built anew for the rows in use; unused rows make it print warnings."""
        if not all(bool(np.isfinite(getattr(self, name)).all()) for name in _ARGUMENTS):
            return None
        if not casadi.has_conic("piqp"):
            return None
        used = (self.lba > -UNBOUNDED) | (self.uba < UNBOUNDED)
        values = {name: getattr(self, name) for name in _ARGUMENTS}
        values.update({name: values[name][used] for name in ("a", "lba", "uba")})
        solver = _plugin("piqp", self.g.size, int(used.sum()), {"piqp": {"kkt_solver": "dense_cholesky"}})
        solution = np.array(solver(**values)["x"]).ravel()
        found = bool(solver.stats()["success"]) and bool(np.isfinite(solution).all())
        return solution if found else None


class ProgramPool:
    """Programs by size, built on first use. Not for concurrent use; see `pool_of_this_thread`.

    Attributes:
        build_time: Seconds spent on building, over the pool's life.
    """

    def __init__(self) -> None:
        self._programs: dict[tuple[int, int], DenseProgram] = {}
        self.build_time = 0.0

    def program(self, size: int, rows: int) -> DenseProgram:
        """The program of this size."""
        key = (size, rows)
        if key not in self._programs:
            began = time.perf_counter()
            self._programs[key] = DenseProgram(size, rows)
            self.build_time += time.perf_counter() - began
        return self._programs[key]

    def load_fallback(self) -> None:
        """Load the second solver's library, which takes some milliseconds."""
        program = DenseProgram(2, 1)
        program.h[:] = np.eye(2)
        program.lba[0], program.uba[0], program.a[0, 0] = 0.0, 1.0, 1.0
        program.lbx[:], program.ubx[:] = -1.0, 1.0
        program.solve_slowly()


class _Pools(threading.local):
    """One pool per thread."""

    def __init__(self) -> None:
        self.pool = ProgramPool()


_POOLS = _Pools()


def pool_of_this_thread() -> ProgramPool:
    """The programs of the calling thread: building one takes as long as several steps, so all smoothers share them."""
    return _POOLS.pool
