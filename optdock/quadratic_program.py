"""Dense convex quadratic programs, solved by dual active-set methods.

A `DenseProgram` has a fixed size and is solved in place by DAQP [Arnstrom2022]. Its construction takes as long as
several solutions, so each size is constructed once and solved repeatedly.

`minimizer` solves a `QuadraticProgram` of any size. DAQP, or a kernel in C that can begin with a guess, finds only the
active set; the solution is that of the linear equations of the active set, so it is the same for both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.kernels import Kernel, twin_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import casadi

    from optdock.geometry.arrays import FloatArray, IntArray

__all__ = [
    "AT_BOUND",
    "EXACT",
    "MOST_ROUNDS",
    "UNBOUNDED",
    "DenseProgram",
    "Minimizer",
    "QuadraticProgram",
    "minimizer",
]

UNBOUNDED = 1e30  # DAQP's value for infinity
EXACT = 1e-12  # primal tolerance that finds all active constraints; relative to the Hessian
_ARGUMENTS = ("h", "g", "a", "lba", "uba", "lbx", "ubx")
_ROUNDING = 1e-9  # tolerance where `EXACT` is too small for the rounding errors, as in the kernel
AT_BOUND = 1e-9  # distance of active constraints from their bounds
MOST_ROUNDS = 1000
_KERNEL = Kernel("optdock_minimizer", sizes=5, numbers=3)


class QuadraticProgram(NamedTuple):
    """Program `min z'hz / 2 + g'z` with bounds on the n variables and on the m rows `az`.

    Constraint i + 1 is the lower bound of variable i or, for i >= n, of row i - n; -(i + 1) is the upper bound.
    """

    h: FloatArray  # Shape (n, n), positive definite
    g: FloatArray  # Shape (n,)
    a: FloatArray  # Shape (m, n)
    bounds: FloatArray  # Shape (2, n + m), lower and upper bounds, those of the variables first; UNBOUNDED for none
    leading: int  # columns of `a` in which rows have one range of elements other than 0; those of the others are behind
    guess: IntArray  # constraints that are probably active; changes the time, and the solution by rounding errors only
    dense: Callable[[], DenseProgram]  # returns a program for DAQP, of n variables and m rows or more, `EXACT`


class Minimizer(NamedTuple):
    """Solution of a program, Shape (n,), and the constraints whose bounds it attains, in order of their numbers."""

    solution: FloatArray
    active: IntArray


class DenseProgram:
    """Program `min z'hz / 2 + g'z, lbx <= z <= ubx, lba <= az <= uba`, with `h` positive definite.

    The arrays have the names of the formula and are in Fortran order. They are filled in place and must not be
    replaced, because casadi's buffers read them without a copy.

    Args:
        size: Number of variables.
        rows: Number of general constraints; unused constraints keep zero rows and infinite bounds.
        most_iterations: Maximum number of active-set iterations; None for DAQP's default.
        tolerance: Largest violation of a constraint, relative to the Hessian; None for DAQP's default of 1e-6.
    """

    def __init__(
        self, size: int, rows: int, most_iterations: int | None = None, tolerance: float | None = None
    ) -> None:
        self.h, self.a = np.zeros((size, size), order="F"), np.zeros((rows, size), order="F")
        self.g, self.lbx, self.ubx = np.zeros(size), np.full(size, -UNBOUNDED), np.full(size, UNBOUNDED)
        self.lba, self.uba = np.full(rows, -UNBOUNDED), np.full(rows, UNBOUNDED)
        self._solution, self._multipliers = np.zeros(size), (np.zeros(size), np.zeros(rows))
        chosen = {"iter_limit": most_iterations, "primal_tol": tolerance}
        options = {name: value for name, value in chosen.items() if value is not None}
        self._function = _plugin("daqp", size, rows, {"daqp": options})
        self._buffer, self._run = self._bound()

    def _bound(self) -> tuple[casadi.FunctionBuffer, Callable[[], None]]:
        buffer, run = self._function.buffer()
        for name in _ARGUMENTS:
            values: FloatArray = getattr(self, name)
            # casadi's stub declares only the C form of the two setters.
            buffer.set_arg(self._function.index_in(name), _memory(values))  # type: ignore[call-arg]
        for name, values in zip(("x", "lam_x", "lam_a"), (self._solution, *self._multipliers), strict=True):
            buffer.set_res(self._function.index_out(name), _memory(values))  # type: ignore[call-arg]
        return buffer, run

    def fill(self, program: QuadraticProgram) -> None:
        """Set all arrays to those of a program, which may have fewer rows."""
        (m, n), (lower, upper) = program.a.shape, program.bounds
        self.h[:], self.g[:], self.lbx[:], self.ubx[:] = program.h, program.g, lower[:n], upper[:n]
        self.a[:m], self.lba[:m], self.uba[:m] = program.a, lower[n:], upper[n:]
        self.a[m:], self.lba[m:], self.uba[m:] = 0.0, -UNBOUNDED, UNBOUNDED

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

    @property
    def multipliers(self) -> FloatArray:
        """Multipliers of the latest solution, of the variables and then of the rows; negative at lower bounds."""
        return np.concatenate(self._multipliers)

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


def _plugin(name: str, size: int, rows: int, options: Mapping[str, Mapping[str, float | str]]) -> casadi.Function:
    import casadi

    shapes = {"h": casadi.Sparsity.dense(size, size), "a": casadi.Sparsity.dense(rows, size)}
    return casadi.conic(f"dense_{name}", name, shapes, {"error_on_fail": False, **options})


def _memory(values: FloatArray) -> memoryview:
    """Return the memory of an array in its storage order; the address is stored in casadi's buffer."""
    return memoryview(values.ravel(order="K"))  # type: ignore[arg-type]  # numpy's stubs do not declare the buffer


def _by_kernel(program: QuadraticProgram) -> Minimizer | None:
    (m, n), guess, (lower, upper) = program.a.shape, program.guess, program.bounds
    if (lower > upper).any():
        return None
    ints, doubles = 5 * n + 6 * m + 1, (n + 1) * (2 * n + 7) + 16 * n + 2 * m + 9 * n * n
    found, values = np.empty(ints, dtype=np.int64), np.empty(doubles)
    arrays = (
        (program.h, n * n),
        (program.g, n),
        (program.a, m * n),
        (program.bounds, 2 * (n + m)),
        (guess, guess.size),
        (found, ints),
        (values, doubles),
    )
    count = _KERNEL((n, m, program.leading, guess.size, MOST_ROUNDS), (UNBOUNDED, EXACT, AT_BOUND), arrays)
    solution = values[:n].copy()
    return Minimizer(solution, found[:count].copy()) if count >= 0 and np.isfinite(solution).all() else None


@twin_of(_by_kernel)
def minimizer(program: QuadraticProgram) -> Minimizer | None:
    """Return the minimizer of a program, or None if none is found."""
    solver = program.dense()
    solver.fill(program)
    if solver.solve() is None:
        # Rounding may leave one of several constraints violated that depend on each other, whichever are active.
        solver = DenseProgram(solver.g.size, solver.lba.size, tolerance=_ROUNDING)
        solver.fill(program)
        if solver.solve() is None:
            return None
    multipliers, (lower, upper) = solver.multipliers[: program.bounds.shape[1]], program.bounds
    active = np.flatnonzero((multipliers != 0.0) | (lower == upper))
    solution = _minimizer_on(program, active, np.where(multipliers[active] > 0.0, upper[active], lower[active]))
    if not bool(np.isfinite(solution).all()):
        return None
    values = np.concatenate((solution, np.einsum("ij,j->i", program.a, solution)))
    at_lower, at_upper = values - lower < AT_BOUND, upper - values < AT_BOUND
    attained = np.flatnonzero(at_lower | at_upper)
    return Minimizer(solution, np.where(at_lower[attained], attained + 1, -(attained + 1)))


def _minimizer_on(program: QuadraticProgram, active: IntArray, bound: FloatArray) -> FloatArray:
    """Return the solution of the linear equations of an active set: variables, then rows, at their bounds.

    The order of all sums is that of the kernel.
    """
    h, g, a, *_ = program
    count = int(np.searchsorted(active, g.size))
    fixed, rows = active[:count], a[active[count:] - g.size]
    free = np.delete(np.arange(g.size), fixed)
    size = free.size + len(rows)
    matrix, solution = np.zeros((size, size)), np.empty(g.size)
    matrix[: free.size, : free.size] = h[free[:, None], free]
    matrix[free.size :, : free.size] = rows[:, free]
    matrix[: free.size, free.size :] = rows[:, free].T
    known = np.concatenate((h[free[:, None], fixed], rows[:, fixed]))
    right = np.concatenate((-g[free], bound[count:])) - (known * bound[:count]).T.copy().sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):  # of dependent rows
        factor, pivot = _factors(matrix)
        solved = _solved(factor, pivot, right)
        left = right - (matrix * solved[:, None]).sum(axis=0)
        solution[free] = (solved + _solved(factor, pivot, left))[: free.size]
    solution[fixed] = bound[:count]
    return solution


def _factors(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return L, in the lower triangle, and D of the factors L D L'."""
    factor, pivot = matrix.copy(), np.empty(len(matrix))
    for j in range(len(matrix)):
        pivot[j], column = factor[j, j], factor[j + 1 :, j].copy()
        factor[j + 1 :, j] /= pivot[j]
        factor[j + 1 :, j + 1 :] -= factor[j + 1 :, j : j + 1] * column
    return factor, pivot


def _solved(factor: FloatArray, pivot: FloatArray, right: FloatArray) -> FloatArray:
    x: FloatArray = right.copy()
    for j in range(len(x)):
        x[j + 1 :] -= factor[j + 1 :, j] * x[j]
    x /= pivot
    for i in range(len(x) - 1, 0, -1):
        x[:i] -= factor[i, :i] * x[i]
    return x
