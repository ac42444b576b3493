"""Small dense convex programs through `casadi.conic`: DAQP first, PIQP where it fails.

min 0.5 z'Hz + g'z, lower <= z <= upper, row_lower <= Az <= row_upper. Programs are built per size and reused through
casadi's buffers, which read and write numpy memory without a copy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["UNBOUNDED", "DenseProgram", "ProgramPool"]

UNBOUNDED = 1e30  # how DAQP spells infinity
_ARGUMENTS = ("h", "g", "a", "lba", "uba", "lbx", "ubx")


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
        self._primary = self._plugin("daqp", {})
        self._buffer, self._run = self._bound()

    def _plugin(self, name: str, options: dict[str, object]) -> object:
        import casadi

        shapes = {"h": casadi.Sparsity.dense(*self.h.shape), "a": casadi.Sparsity.dense(*self.a.shape)}
        return casadi.conic(f"step_{name}", name, shapes, {"error_on_fail": False, **options})

    def _bound(self) -> tuple[object, object]:
        buffer, run = self._primary.buffer()
        for name in _ARGUMENTS:
            # A view in memory order: the buffer keeps the address, so the arrays must never be replaced.
            buffer.set_arg(self._primary.index_in(name), memoryview(getattr(self, name).ravel(order="K")))
        buffer.set_res(self._primary.index_out("x"), memoryview(self._solution))
        return buffer, run

    def solve(self) -> FloatArray | None:
        """The minimizer, or None where no solver finds one. Shape (size,)."""
        self._run()
        # On failure DAQP leaves the previous solution behind, and NaN input passes for a success.
        if self._buffer.stats()["success"] and np.all(np.isfinite(self._solution)):
            return self._solution.copy()
        return self._fallback()

    def _fallback(self) -> FloatArray | None:
        finite = all(np.all(np.isfinite(getattr(self, name))) for name in _ARGUMENTS)
        if not finite:
            return None
        solver = self._plugin("piqp", {"piqp": {"kkt_solver": "dense_cholesky"}})
        result = solver(**{name: getattr(self, name) for name in _ARGUMENTS})
        solution = np.array(result["x"]).ravel()
        return solution if solver.stats()["success"] and np.all(np.isfinite(solution)) else None


class ProgramPool:
    """Programs by size, built on first use. Not for concurrent use: one pool per smoother."""

    def __init__(self) -> None:
        self._programs: dict[tuple[int, int], DenseProgram] = {}

    def program(self, size: int, rows: int) -> DenseProgram:
        """The program of this size."""
        key = (size, rows)
        if key not in self._programs:
            self._programs[key] = DenseProgram(size, rows)
        return self._programs[key]
