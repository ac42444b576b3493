"""Dense convex quadratic programs of fixed size, filled in place and solved by DAQP [Arnstrom2022].

A program is built once per size, which takes as long as several solutions, and solved as often as its numbers change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from optdock.geometry.arrays import FloatArray

__all__ = ["UNBOUNDED", "DenseProgram"]

UNBOUNDED = 1e30  # how DAQP spells infinity
_ARGUMENTS = ("h", "g", "a", "lba", "uba", "lbx", "ubx")


class DenseProgram:
    """`min z'hz / 2 + g'z, lbx <= z <= ubx, lba <= az <= uba`, with `h` positive definite.

    Its arrays, named as in the formula, are in Fortran order; casadi's buffers read them without a copy, so they are to
    be filled, never replaced.

    Args:
        size: Number of variables.
        rows: Number of general constraints; unused ones keep zero rows and infinite bounds.
        most_iterations: Of the active set, after which DAQP gives up; None: DAQP's own bound.
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
            # casadi's stub knows the C form of the two setters only.
            buffer.set_arg(self._function.index_in(name), _memory(values))  # type: ignore[call-arg]
        buffer.set_res(self._function.index_out("x"), _memory(self._solution))  # type: ignore[call-arg]
        return buffer, run

    def solve(self) -> FloatArray | None:
        """The minimizer, Shape (size,); None where DAQP finds none."""
        try:
            self._run()
        except RuntimeError:  # casadi's one exception, for example where a lower bound exceeds its upper bound
            return None
        # On failure DAQP leaves the previous solution behind, and NaN input passes for a success.
        if not self._buffer.stats()["success"] or not bool(np.isfinite(self._solution).all()):
            return None
        solution: FloatArray = self._solution.copy()
        return solution

    def solve_slowly(self) -> FloatArray | None:
        """The minimizer by PIQP [Schwan2023], built anew for the rows in use; unused rows make it print warnings."""
        if not all(bool(np.isfinite(getattr(self, name)).all()) for name in _ARGUMENTS):
            return None
        if bool(np.any(self.lbx > self.ubx) or np.any(self.lba > self.uba)) or not casadi.has_conic("piqp"):
            return None
        used = (self.lba > -UNBOUNDED) | (self.uba < UNBOUNDED)
        values = {name: getattr(self, name) for name in _ARGUMENTS}
        values.update({name: values[name][used] for name in ("a", "lba", "uba")})
        solver = _plugin("piqp", self.g.size, int(used.sum()), {"piqp": {"kkt_solver": "dense_cholesky"}})
        solution = np.array(solver(**values)["x"]).ravel()
        found = bool(solver.stats()["success"]) and bool(np.isfinite(solution).all())
        return solution if found else None


def _plugin(name: str, size: int, rows: int, options: Mapping[str, Mapping[str, int | str]]) -> casadi.Function:
    shapes = {"h": casadi.Sparsity.dense(size, size), "a": casadi.Sparsity.dense(rows, size)}
    return casadi.conic(f"dense_{name}", name, shapes, {"error_on_fail": False, **options})


def _memory(values: FloatArray) -> memoryview:
    """Of an array in its own order: a view, whose address the buffer keeps."""
    return memoryview(values.ravel(order="K"))  # type: ignore[arg-type]  # numpy's stubs do not declare the buffer
