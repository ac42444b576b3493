"""Dense convex quadratic programs of fixed size, solved in place by DAQP [Arnstrom2022].

The construction of a program takes as long as several solutions, so each size is constructed once and solved
repeatedly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import casadi

    from optdock.geometry.arrays import FloatArray

__all__ = ["UNBOUNDED", "DenseProgram"]

UNBOUNDED = 1e30  # DAQP's value for infinity
_ARGUMENTS = ("h", "g", "a", "lba", "uba", "lbx", "ubx")


class DenseProgram:
    """Program `min z'hz / 2 + g'z, lbx <= z <= ubx, lba <= az <= uba`, with `h` positive definite.

    The arrays have the names of the formula and are in Fortran order. They are filled in place and must not be
    replaced, because casadi's buffers read them without a copy.

    Args:
        size: Number of variables.
        rows: Number of general constraints; unused constraints keep zero rows and infinite bounds.
        most_iterations: Maximum number of active-set iterations; None for DAQP's default.
    """

    def __init__(self, size: int, rows: int, most_iterations: int | None = None) -> None:
        self.h, self.a = np.zeros((size, size), order="F"), np.zeros((rows, size), order="F")
        self.g, self.lbx, self.ubx = np.zeros(size), np.full(size, -UNBOUNDED), np.full(size, UNBOUNDED)
        self.lba, self.uba = np.full(rows, -UNBOUNDED), np.full(rows, UNBOUNDED)
        self._solution = np.zeros(size)
        options: dict[str, dict[str, int | str]] = (
            {} if most_iterations is None else {"daqp": {"iter_limit": most_iterations}}
        )
        self._function = _plugin("daqp", size, rows, options)
        self._buffer, self._run = self._bound()

    def _bound(self) -> tuple[casadi.FunctionBuffer, Callable[[], None]]:
        buffer, run = self._function.buffer()
        for name in _ARGUMENTS:
            values: FloatArray = getattr(self, name)
            # casadi's stub declares only the C form of the two setters.
            buffer.set_arg(self._function.index_in(name), _memory(values))  # type: ignore[call-arg]
        buffer.set_res(self._function.index_out("x"), _memory(self._solution))  # type: ignore[call-arg]
        return buffer, run

    def solve(self) -> FloatArray | None:
        """Return the minimizer, Shape (size,), or None if DAQP does not find a solution."""
        try:
            self._run()
        except RuntimeError:  # casadi raises no other exception, e.g. if a lower bound exceeds its upper bound
            return None
        # On failure DAQP keeps the previous solution in the buffer, and it reports success for NaN input.
        if not self._buffer.stats()["success"] or not bool(np.isfinite(self._solution).all()):
            return None
        solution: FloatArray = self._solution.copy()
        return solution

    def solve_slowly(self) -> FloatArray | None:
        """Return the minimizer by PIQP [Schwan2023], set up for the rows in use (unused rows cause warnings)."""
        if not all(bool(np.isfinite(getattr(self, name)).all()) for name in _ARGUMENTS):
            return None
        if bool(np.any(self.lbx > self.ubx) or np.any(self.lba > self.uba)):
            return None
        import casadi

        if not casadi.has_conic("piqp"):
            return None
        used = (self.lba > -UNBOUNDED) | (self.uba < UNBOUNDED)
        values = {name: getattr(self, name) for name in _ARGUMENTS}
        values.update({name: values[name][used] for name in ("a", "lba", "uba")})
        solver = _plugin("piqp", self.g.size, int(used.sum()), {"piqp": {"kkt_solver": "dense_cholesky"}})
        solution = np.array(solver(**values)["x"]).ravel()
        found = bool(solver.stats()["success"]) and bool(np.isfinite(solution).all())
        return solution if found else None


def _plugin(name: str, size: int, rows: int, options: Mapping[str, Mapping[str, int | str]]) -> casadi.Function:
    import casadi

    shapes = {"h": casadi.Sparsity.dense(size, size), "a": casadi.Sparsity.dense(rows, size)}
    return casadi.conic(f"dense_{name}", name, shapes, {"error_on_fail": False, **options})


def _memory(values: FloatArray) -> memoryview:
    """Return the memory of an array in its storage order; the address is stored in casadi's buffer."""
    return memoryview(values.ravel(order="K"))  # type: ignore[arg-type]  # numpy's stubs do not declare the buffer
