"""The convex step: a quadratic program within a trust region, with L1 penalties.

    minimize    g'd + d'(H + mu M)d / 2 + rho_T (e+ + e-) + rho sum_z t_z          over step d and slacks e, t >= 0
    subject to  lower <= z + d <= upper                       box of curvatures and lengths, trust region of lengths
                E d + e+ - e- = -(end - target)               goal
                |T d| <= trust region                         headings at twelve nodes
                +-(K_(j+1) - K_j) - (s_max / q) L <= 0        curvature rate, exact
                G d + t_zone >= buffer - gap                  clearance

Columns and rows are in named blocks. The constraints that are active in one step are a guess for those of the next
step.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections import OrderedDict
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import readonly
from optdock.kernels import Kernel, kernels_lane, twin_of
from optdock.quadratic_program import (
    AT_BOUND,
    EXACT,
    MOST_ROUNDS,
    UNBOUNDED,
    DenseProgram,
    QuadraticProgram,
    minimizer,
)
from smoothers.scp.basis import basis_for
from smoothers.scp.collision.linearization import ClearanceRows
from smoothers.scp.cost import Quadratic
from smoothers.scp.rollout import Variables, in_order

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers.scp.basis import Basis
    from smoothers.scp.loop import Iterate
    from smoothers.scp.nlp import NonlinearProgram, VariableBounds
    from smoothers.scp.settings import StepSettings

__all__ = [
    "NOTHING_ADDED",
    "Additions",
    "Blocks",
    "Linearization",
    "Penalties",
    "ProgramPool",
    "QpStep",
    "StepBounds",
    "Subproblem",
    "blocks_for",
    "linearize_and_solve_natively",
    "numbers_before_rows",
    "pool_of_this_thread",
    "prepare_programs",
    "solve_natively",
    "solve_step",
    "step_program",
    "trusted_nodes",
    "zone_of",
]

# With its workspace, a program takes up to 0.35 MB and is built in 0.2 to 0.5 ms.
_MOST_PROGRAMS = 16
_KERNEL = Kernel("optdock_step", sizes=4, numbers=8)
_LINEARIZED = Kernel("optdock_linearized_step", sizes=6, numbers=9)


class Penalties(NamedTuple):
    """Weights [1/m] of the clearance shortfalls and the goal error."""

    clearance: float
    goal: float


class StepBounds(NamedTuple):
    """What keeps a step short, and what it pays for violated constraints."""

    trust_region: float  # bound of the heading changes [rad]; times the smallest radius, also of the length changes [m]
    proximal: float  # weight of the squared motion
    penalties: Penalties


class QpStep(NamedTuple):
    """Change of the variables, Shape (size,), and the decrease of the cost that the model predicts."""

    change: FloatArray
    gain: float


class Blocks(NamedTuple):
    """Columns and rows of a program."""

    path: slice  # columns of the step: knot curvatures, then gear lengths
    goal_above: slice  # columns of the three slacks e+ and e-
    goal_below: slice
    clearance_slack: slice  # columns of the slacks of clearance, one per zone of the path
    goal: slice  # rows of the pose at the end
    trust_region: slice  # rows of the headings
    rate_up: slice  # rows of the curvature rate and its negative, none where it is unlimited
    rate_down: slice
    clearance: slice  # rows of clearance; unused ones are empty

    @property
    def size(self) -> tuple[int, int]:
        """Numbers of columns and of rows."""
        return int(self.clearance_slack.stop), int(self.clearance.stop)


def blocks_for(basis: Basis, rate_spans: int, clearance_rows: int, settings: StepSettings) -> Blocks:
    """Return the blocks of a program with the given numbers of rate-bounded spans and clearance rows."""
    path, above, below, slack = _consecutive(basis.size, 3, 3, settings.zones)
    rows = _consecutive(3, _trust_rows(basis, settings), rate_spans, rate_spans, clearance_rows)
    return Blocks(path, above, below, slack, *rows)


def _consecutive(*counts: int) -> list[slice]:
    return [slice(end - count, end) for count, end in zip(counts, itertools.accumulate(counts), strict=True)]


def zone_of(basis: Basis, node: IntArray, zones: int) -> IntArray:
    """Return the index of the penalty zone of each node."""
    return np.minimum(zones - 1, node * zones // basis.num_nodes)


def trusted_nodes(basis: Basis, settings: StepSettings) -> IntArray:
    """Return nodes spaced evenly over the path, whose headings are bounded by the trust region.

    Twelve nodes are enough for 24 spans. With more spans, curvatures oscillate unless there is one node per span.
    """
    return _spaced_nodes(basis.num_nodes, _trust_rows(basis, settings))


@lru_cache(maxsize=16)  # as many as bases
def _spaced_nodes(nodes: int, count: int) -> IntArray:
    return readonly(np.linspace(1, nodes - 1, count).astype(np.int64))


def _trust_rows(basis: Basis, settings: StepSettings) -> int:
    spans = basis.span_gear.size
    return settings.trust_nodes if spans <= 2 * settings.trust_nodes else spans


class Subproblem(NamedTuple):
    """The parts of a linearization."""

    variables: Variables  # point of the linearization
    quadratic: Quadratic
    motion: FloatArray  # Shape (size, size), squared motion of the nodes
    goal: tuple[FloatArray, FloatArray]  # derivatives of the last pose, Shape (3, size), and its error, Shape (3,)
    headings: FloatArray  # Shape (trust nodes, size), derivatives of the headings that the trust region bounds
    rows: ClearanceRows  # clearance


class Additions(NamedTuple):
    """What the required view and terms add to a linearization."""

    costs: FloatArray  # gradient and Hessian, Shape (size + size^2,), or nothing, Shape (0,)
    rows: FloatArray  # gap and gradient of each row, Shape (r, 1 + size)
    node: IntArray  # nodes of the rows, Shape (r,)

    def with_rows(self, rows: ClearanceRows) -> Additions:
        """Return the additions with further rows."""
        packed, node = np.column_stack((rows.gap, rows.gradient)), rows.node
        if self.node.size:
            packed, node = np.concatenate((self.rows, packed)), np.concatenate((self.node, node))
        return Additions(self.costs, packed, node)

    def to(self, quadratic: Quadratic, rows: ClearanceRows) -> tuple[Quadratic, ClearanceRows]:
        """Return a model and rows with the additions."""
        if self.costs.size:
            size = quadratic.gradient.size
            quadratic = quadratic.plus(Quadratic(self.costs[:size], self.costs[size:].reshape(size, size)))
        if self.node.size:
            rows = rows.joined(ClearanceRows(self.rows[:, 1:], self.rows[:, 0], self.node))
        return quadratic, rows


NOTHING_ADDED = Additions(readonly(np.empty(0)), readonly(np.empty((0, 1))), readonly(np.empty(0, dtype=np.int64)))


class Linearization(NamedTuple):
    """One linearization, which is reused after a rejected step, in the memory of the kernels.

    `values` has, in this order: variables (size,), end error (3,), gradient (size,), Hessian and squared motion (size,
    size) each, derivatives of the last pose (3, size) and of the trusted headings (trusted, size), and the rows of
    clearance, each a gap and a gradient, (r, 1 + size).
    """

    values: FloatArray
    node: IntArray  # nodes of the rows, Shape (r,)
    basis: Basis
    trusted: int

    @classmethod
    def of(cls, basis: Basis, parts: Subproblem) -> Linearization:
        """Return the linearization of these parts."""
        (jacobian, error), rows = parts.goal, parts.rows
        given = *parts.variables, error, *parts.quadratic, parts.motion, jacobian, parts.headings
        values = np.concatenate((*given, np.column_stack((rows.gap, rows.gradient))), axis=None)
        return cls(values, rows.node, basis, len(parts.headings))

    @property
    def start(self) -> int:
        """Index of the first row in `values`."""
        return numbers_before_rows(self.basis.size, self.trusted)

    def tighten(self, shortfalls: FloatArray) -> None:
        """Require more clearance in all rows of each zone, Shape (zones,) [m]."""
        rows = self.values[self.start :].reshape(-1, 1 + self.basis.size)
        rows[:, 0] -= shortfalls[zone_of(self.basis, self.node, shortfalls.size)]

    @property
    def parts(self) -> Subproblem:
        """The parts, as views."""
        basis, size = self.basis, self.basis.size
        counts = basis.num_knots, basis.num_gears, 3, size, size * size, size * size, 3 * size, self.trusted * size
        curvature, lengths, error, gradient, *matrices, rows = np.split(self.values, np.cumsum(counts))
        hessian, motion, jacobian, headings = (elements.reshape(-1, size) for elements in matrices)
        rows = rows.reshape(-1, 1 + size)
        bounded = ClearanceRows(rows[:, 1:], rows[:, 0], self.node)
        model = Quadratic(gradient, hessian)
        return Subproblem(Variables(curvature, lengths), model, motion, (jacobian, error), headings, bounded)


def solve_natively(
    nlp: NonlinearProgram, around: Linearization, pool: ProgramPool, within: StepBounds
) -> QpStep | None:
    """Return the result of `solve_step`, whose arguments are the same, by the kernel."""
    packed, count = nlp.packed, around.node.size
    guess, last = _guess(pool.latest, nlp, around, packed.columns, packed.rows)
    numbers, integers = packed.of_step
    work, indices = pool.work(numbers, integers + guess.size)
    arrays = (
        (packed.counts, packed.counts.size),
        (packed.numbers, packed.numbers.size),
        (around.values, packed.before_rows + count * (1 + nlp.basis.size)),
        (around.node, count),
        (guess, guess.size),
        (indices, indices.size),
        (work, work.size),
    )
    trust_region, proximal, penalties = within
    bounds = trust_region, trust_region * nlp.radius, proximal, *penalties, UNBOUNDED, EXACT, AT_BOUND
    found = _KERNEL((count, guess.size, last, MOST_ROUNDS), bounds, arrays)
    if found < 0:
        return _solve_slowly(step_program(nlp, around, pool, within), around)
    return _kept(nlp, around, pool, work, indices[:found])


def linearize_and_solve_natively(
    current: Iterate, buffer: float, more: Additions, pool: ProgramPool, within: StepBounds
) -> tuple[Linearization, QpStep | None]:
    """Return the result of `loop.linearized_step`, whose arguments are the same, by the kernel."""
    nlp, basis, scene = current.nlp, current.nlp.basis, current.nlp.scene
    packed, size, nodes = nlp.packed, basis.size, basis.num_nodes
    room, most = packed.room, nlp.settings.step.clearance_rows[-1]
    parts, obstacles = scene.body.vertices.shape[0], scene.obstacles.vertices.shape[0]
    p = (current.pairs.size - nodes) // 3
    rows, discs = (3 + 2 * scene.settings.discs_per_node) * p, scene.settings.most_discs
    start, added, costs = packed.before_rows, more.node.size, more.costs
    node, values = np.empty(most + added + 1, dtype=np.int64), np.empty(start + (min(most, rows) + added) * (1 + size))
    guess, last = _guess(pool.latest, nlp, None, packed.columns, packed.rows)
    numbers, integers = packed.of_step
    work, indices = pool.work(
        max(
            numbers, size * (3 * nodes + 4) + rows * (size + 2) + 3 * discs + 9 * p + 2 * room.width, 2 * (most + added)
        ),
        max(integers + guess.size, 15 * p + (parts + nodes) * obstacles + 2 * rows, most + added),
    )
    arrays = (
        (packed.counts, packed.counts.size),
        (packed.numbers, packed.numbers.size),
        (basis.packed, 2 * (basis.num_intervals + nodes) * basis.num_knots),
        (scene.packed, room.scene),
        (current.values, packed.results + 6 + 4 * nodes + room.width * p + packed.points),
        (current.pairs, nodes + 3 * p),
        (costs, costs.size),
        (more.node, added),
        (more.rows, added * (1 + size)),
        (guess, guess.size),
        (node, most + added + 1),
        (values, values.size),
        (indices, indices.size),
        (work, work.size),
    )
    sizes = p, costs.size, added, guess.size, last, MOST_ROUNDS
    trust_region, proximal, penalties = within
    bounds = trust_region, trust_region * nlp.radius, proximal, *penalties, UNBOUNDED, EXACT, AT_BOUND
    found = _LINEARIZED(sizes, (buffer, *bounds), arrays)
    count = node.item(most + added)
    around = Linearization(values[: start + count * (1 + size)], node[:count], basis, packed.trusted)
    if found < 0:
        return around, _solve_slowly(step_program(nlp, around, pool, within), around)
    return around, _kept(nlp, around, pool, work, indices[:found])


def numbers_before_rows(size: int, trusted: int) -> int:
    """Return how many numbers of `Linearization.values` precede the rows."""
    return size * (2 * size + 5 + trusted) + 3


def _kept(
    nlp: NonlinearProgram, around: Linearization, pool: ProgramPool, work: FloatArray, active: IntArray
) -> QpStep:
    """Return the step that the kernel has found, and keep the active constraints for the next step."""
    size = nlp.basis.size
    pool.latest = _ActiveRows(nlp.inner_bounds, around, active.copy())
    solved = work[: size + 1].copy()
    return QpStep(solved[:size], solved.item(size))


@twin_of(solve_natively)
def solve_step(nlp: NonlinearProgram, around: Linearization, pool: ProgramPool, within: StepBounds) -> QpStep | None:
    """Return the best step within the trust region, or None if both solvers fail.

    Args:
        nlp: Bounds and constants.
        around: Linearization.
        pool: Programs.
        within: Trust region, proximal weight and penalties.
    """
    program = step_program(nlp, around, pool, within)
    found = minimizer(program)
    if found is None:
        return _solve_slowly(program, around)
    pool.latest = _ActiveRows(nlp.inner_bounds, around, found.active)
    return _step_of(found.solution, around)


def _solve_slowly(program: QuadraticProgram, around: Linearization) -> QpStep | None:
    dense = program.dense()
    dense.fill(program)
    solution = dense.solve_slowly()
    return None if solution is None else _step_of(solution, around)


def _step_of(solution: FloatArray, around: Linearization) -> QpStep:
    model = around.parts.quadratic
    change = solution[: model.gradient.size]
    bent = in_order(change * in_order(model.hessian * change, 1))
    return QpStep(change, -float(in_order(model.gradient * change) + 0.5 * bent))


def step_program(
    nlp: NonlinearProgram, around: Linearization, pool: ProgramPool, within: StepBounds
) -> QuadraticProgram:
    """Return the program of `solve_step`, whose arguments are the same."""
    basis, settings, spans, parts = nlp.basis, nlp.settings.step, nlp.basis.span_gear.size, around.parts
    is_limited, count = bool(np.isfinite(nlp.inner_bounds.rate)), around.node.size
    blocks = blocks_for(basis, spans if is_limited else 0, count, settings)

    def dense() -> DenseProgram:
        room = next(room for room in settings.clearance_rows if room >= count)
        return pool.program(blocks.size[0], blocks.clearance.start + room)

    (n, m), (h, a) = blocks.size, _constant_elements(basis, nlp.inner_bounds.rate, settings)
    bounds = np.full((2, n + m), ((-UNBOUNDED,), (UNBOUNDED,)))
    guess, last = _guess(pool.latest, nlp, around, n, blocks.clearance.start)
    guess = guess[np.abs(guess) <= last]
    program = QuadraticProgram(h.copy(), np.empty(n), np.empty((m, n)), bounds, basis.num_knots, guess, dense)
    program.a[: len(a)] = a
    _fill_cost(program, blocks, parts, within, settings.ridge)
    _fill_box(program, blocks, nlp, parts.variables, within.trust_region * nlp.radius)
    rows = _Rows(program.a, *bounds[:, n:])
    _fill_goal_and_trust_region(rows, blocks, parts, within.trust_region)
    if is_limited:
        _fill_rate(rows, blocks, nlp, parts.variables)
    _fill_clearance(rows, blocks, parts.rows, zone_of(basis, parts.rows.node, settings.zones))
    return program


class _Rows(NamedTuple):
    """Views of the rows of a program and their bounds."""

    a: FloatArray
    lower: FloatArray
    upper: FloatArray


@lru_cache(maxsize=16)  # as many as there are bases in the cache of bases
def _constant_elements(basis: Basis, rate: float, settings: StepSettings) -> tuple[FloatArray, FloatArray]:
    """Return the elements of H, and of the rows before those of clearance, that are the same in all steps."""
    blocks = blocks_for(basis, basis.span_gear.size if np.isfinite(rate) else 0, 0, settings)
    (n, m), gear = blocks.size, basis.num_knots + basis.span_gear
    diagonal, a = np.zeros(n), np.zeros((m, n))
    diagonal[blocks.goal_above] = diagonal[blocks.goal_below] = settings.curved_goal_slack
    diagonal[blocks.clearance_slack] = settings.curved_clearance_slack
    a[blocks.goal, blocks.goal_above], a[blocks.goal, blocks.goal_below] = np.eye(3), -np.eye(3)
    if np.isfinite(rate):
        a[blocks.rate_up, : basis.num_knots] = basis.span_slopes
        a[blocks.rate_down, : basis.num_knots] = -basis.span_slopes
        for block in (blocks.rate_up, blocks.rate_down):
            a[np.arange(block.start, block.stop), gear] = -rate
    return readonly(np.diag(diagonal)), readonly(a)


def _fill_cost(program: QuadraticProgram, blocks: Blocks, around: Subproblem, within: StepBounds, ridge: float) -> None:
    penalties = within.penalties
    program.h[blocks.path, blocks.path] = around.quadratic.hessian + within.proximal * around.motion
    np.einsum("ii->i", program.h)[blocks.path] += ridge  # a view, not a copy
    program.g[blocks.path] = around.quadratic.gradient
    program.g[blocks.goal_above] = program.g[blocks.goal_below] = penalties.goal
    program.g[blocks.clearance_slack] = penalties.clearance


def _fill_box(
    program: QuadraticProgram, blocks: Blocks, nlp: NonlinearProgram, variables: Variables, stretch: float
) -> None:
    """Set the bounds of the variables; lengths change by at most `stretch` [m]."""
    knots, flat = nlp.basis.num_knots, np.concatenate(variables)
    lower, upper = nlp.inner_bounds.lower - flat, nlp.inner_bounds.upper - flat
    lower[knots:] = np.maximum(lower[knots:], -stretch)
    upper[knots:] = np.minimum(upper[knots:], stretch)
    program.bounds[0, blocks.path.stop : blocks.clearance_slack.stop] = 0.0
    program.bounds[0, blocks.path] = np.minimum(lower, upper)
    program.bounds[1, blocks.path] = np.maximum(lower, upper)


def _fill_goal_and_trust_region(rows: _Rows, blocks: Blocks, around: Subproblem, trust_region: float) -> None:
    jacobian, error = around.goal
    rows.a[blocks.goal, blocks.path] = jacobian
    rows.lower[blocks.goal] = rows.upper[blocks.goal] = -error
    rows.a[blocks.trust_region, blocks.path] = around.headings
    rows.lower[blocks.trust_region], rows.upper[blocks.trust_region] = -trust_region, trust_region


def _fill_rate(rows: _Rows, blocks: Blocks, nlp: NonlinearProgram, variables: Variables) -> None:
    basis, bound = nlp.basis, nlp.inner_bounds.rate
    slopes, allowed = basis.slopes(variables.curvature), bound * variables.lengths[basis.span_gear]
    rows.upper[blocks.rate_up], rows.upper[blocks.rate_down] = allowed - slopes, allowed + slopes


def _fill_clearance(rows: _Rows, blocks: Blocks, bounded: ClearanceRows, zone: IntArray) -> None:
    rows.a[blocks.clearance, blocks.path], rows.a[blocks.clearance, blocks.path.stop :] = bounded.gradient, 0.0
    rows.a[np.arange(blocks.clearance.start, blocks.clearance.stop), blocks.clearance_slack.start + zone] = 1.0
    rows.lower[blocks.clearance] = -bounded.gap


class _ActiveRows(NamedTuple):
    """The constraints that are active in a step, and the programs in which they have the same numbers."""

    bounds: VariableBounds  # of all steps of a search
    around: Linearization
    active: IntArray


def _guess(
    latest: _ActiveRows | None, nlp: NonlinearProgram, around: Linearization | None, variables: int, fixed: int
) -> tuple[IntArray, int]:
    """Return the constraints that are probably active, and the last one of them that is in this program.

    They are those of the step before, or the bounds of the slacks; `around`: None for a new linearization; `fixed`:
    number of rows before those of clearance.
    """
    if latest is None or latest.bounds is not nlp.inner_bounds:
        return np.arange(nlp.basis.size + 1, variables + 1), variables
    rows = around.node.size if around is not None and latest.around is around else 0
    return latest.active, variables + fixed + rows


class ProgramPool:
    """Programs of DAQP by size, built on first use; the latest ones are kept.

    A pool must not be used concurrently; see `pool_of_this_thread`.

    Attributes:
        latest: Active constraints of the latest step, or None.
        build_time: Total time for building programs [s].
        pace: Time of an iteration relative to the benchmark machine, measured by `warm_up`.
    """

    def __init__(self) -> None:
        self._programs: OrderedDict[tuple[int, int], DenseProgram] = OrderedDict()  # the latest one last
        self.latest: _ActiveRows | None = None
        self.build_time = 0.0
        self.pace = 1.0
        self._work, self._indices = np.empty(0), np.empty(0, dtype=np.int64)

    def program(self, size: int, rows: int) -> DenseProgram:
        """Return the program with these numbers of columns and rows."""
        key = (size, rows)
        if key not in self._programs:
            began = time.perf_counter()
            self._programs[key] = DenseProgram(size, rows, tolerance=EXACT)
            self.build_time += time.perf_counter() - began
            if len(self._programs) > _MOST_PROGRAMS:
                self._programs.popitem(last=False)
        self._programs.move_to_end(key)
        return self._programs[key]

    def work(self, numbers: int, integers: int) -> tuple[FloatArray, IntArray]:
        """Return arrays of these sizes for the work of a kernel, which the next call overwrites."""
        if self._work.size < numbers:
            self._work = np.empty(numbers)
        if self._indices.size < integers:
            self._indices = np.empty(integers, dtype=np.int64)
        return self._work[:numbers], self._indices[:integers]

    def load_fallback(self) -> None:
        """Load the library of the fallback solver, which takes a few milliseconds."""
        program = DenseProgram(2, 1)
        program.h[:] = np.eye(2)
        program.lba[0], program.uba[0], program.a[0, 0] = 0.0, 1.0, 1.0
        program.lbx[:], program.ubx[:] = -1.0, 1.0
        program.solve_slowly()


class _Pools(threading.local):
    def __init__(self) -> None:
        self.pool = ProgramPool()


_POOLS = _Pools()


def pool_of_this_thread() -> ProgramPool:
    """Return the pool of the calling thread, which its smoothers share to avoid building programs more than once."""
    return _POOLS.pool


def prepare_programs(pool: ProgramPool, settings: StepSettings) -> None:
    """Build the usual bases and, where DAQP solves them, programs, for one to three gears; load the solvers."""
    for shape in settings.usual_shapes:
        basis = basis_for(shape)
        if kernels_lane() == "native":
            continue
        for room in settings.clearance_rows[: settings.usual_clearance_rows]:
            pool.program(*blocks_for(basis, basis.span_gear.size, room, settings).size)
    pool.load_fallback()
