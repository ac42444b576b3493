"""One convex step: linearized constraints, assembled into a dense program and solved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from smoothers._ck.discs import disc_rows
from smoothers._ck.layout import Shape, layout_for
from smoothers._ck.qp import UNBOUNDED
from smoothers._ck.rollout import end_sensitivity
from smoothers._ck.rows import Rows, empty_rows, joined, witness_rows
from smoothers._ck.watched import watched_pairs

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers._ck.layout import Layout
    from smoothers._ck.planes import Clearance
    from smoothers._ck.qp import DenseProgram, ProgramPool
    from smoothers._ck.rollout import Rollout, Sensitivity, Variables
    from smoothers._ck.task import Task
    from smoothers._ck.terms import Quadratic

__all__ = ["ZONES", "Penalties", "Step", "StepProblem", "prepare_programs", "solve_step", "zone_of"]

ZONES = 6
_TRUST_NODES = 12
_USUAL_SHAPES: tuple[Shape, ...] = (((24, 2),), ((24, 3),), ((24, 4),), ((12, 3), (12, 3)), ((8, 3), (8, 3), (8, 3)))
_BUCKETS = (48, 96, 160, 256, 400)
_BUFFER_TAPER = 0.1  # [m]: less near the fixed ends
_SOFT_CLEARANCE, _SOFT_GOAL, _RIDGE = 10.0, 100.0, 1e-6


class Penalties(NamedTuple):
    """Weights of shortfalls [1/m]."""

    clearance: float = 300.0
    goal: float = 1000.0

    def raised(self) -> Penalties:
        """Six times the weight of clearance."""
        clearance = 6.0 * self.clearance
        return Penalties(clearance, max(self.goal, 3.0 * clearance))


class Step(NamedTuple):
    """Change of the variables, Shape (size,), and how much the model says the cost falls."""

    change: FloatArray
    gain: float


def zone_of(layout: Layout, node: IntArray) -> IntArray:
    """Zone of the path in which nodes lie."""
    return np.minimum(ZONES - 1, node * ZONES // layout.num_nodes)


@dataclass(frozen=True, eq=False)
class StepProblem:
    """Everything about one linearization that does not change when a step is rejected.

    Attributes:
        variables: Where it is.
        quadratic: Cost model.
        prox: Shape (size, size), squared motion of the nodes.
        end: Derivatives of the last pose, Shape (3, size), and its error, Shape (3,).
        turns: Shape (12, size), derivatives of the headings that the trust region bounds.
        rows: Clearance.
        away: Shape (num_nodes,), share of a buffer that is asked for: none at the ends, where the pose cannot move.
    """

    variables: Variables
    quadratic: Quadratic
    prox: FloatArray
    end: tuple[FloatArray, FloatArray]
    turns: FloatArray
    rows: Rows
    away: FloatArray

    @classmethod
    def around(
        cls,
        task: Task,
        variables: Variables,
        rollout: Rollout,
        found: Clearance,
        by: Sensitivity,
        quadratic: Quadratic,
    ) -> StepProblem:
        """Linearize at a driven path."""
        share = float(variables.lengths.sum()) / task.layout.num_intervals
        prox = share * (by.x.T @ by.x + by.y.T @ by.y + 0.3 * (by.yaw.T @ by.yaw))
        end = end_sensitivity(task.layout, variables, rollout.moves), task.ends.error(rollout)
        nodes = np.linspace(1, task.layout.num_nodes - 1, _TRUST_NODES).astype(np.int64)
        rows = _clearance_rows(task, rollout, found, by)
        return cls(variables, quadratic, prox, end, by.yaw[nodes], rows, _away_from_ends(task, rollout))

    def aiming(self, buffer: float) -> StepProblem:
        """The same, with steps that aim at `buffer` [m] more clearance than required."""
        return replace(self, rows=self.rows._replace(gap=self.rows.gap - buffer * self.away[self.rows.node]))


def _clearance_rows(task: Task, rollout: Rollout, found: Clearance, by: Sensitivity) -> Rows:
    """Witness rows; disc rows where the body overlaps an obstacle deeply."""
    layout, world = task.layout, task.world
    if found.margin.size == 0:
        return empty_rows(layout.size)
    watched = watched_pairs(world, found, layout.num_intervals, _BUCKETS[-1] // 3)
    rows = witness_rows(layout, rollout, by, found, watched.planes)
    if watched.discs.size:
        rows = joined(rows, disc_rows(world, layout, rollout, by, found, watched.discs))
    fixed = rows.node <= 0
    still = np.abs(rows.gradient).max(axis=1, initial=0.0) < 1e-9
    rows = rows.subset(~(fixed & still))
    if rows.gap.size > _BUCKETS[-1]:
        keep = np.argpartition(rows.gap, _BUCKETS[-1])[: _BUCKETS[-1]]
        rows = rows.subset(keep)
    return rows


def _away_from_ends(task: Task, rollout: Rollout) -> FloatArray:
    """0 at the ends to 1 further than `_BUFFER_TAPER` away. Shape (num_nodes,)."""
    away = [np.hypot(*(rollout.poses[:, :2] - point[:2]).T) for point in (task.ends.start, task.ends.target)]
    share: FloatArray = np.minimum(1.0, np.minimum(away[0], away[1]) / _BUFFER_TAPER)
    return share


def solve_step(
    task: Task, problem: StepProblem, pool: ProgramPool, trust: float, prox: float, penalties: Penalties
) -> Step | None:
    """The best step within the trust region, or None."""
    layout = task.layout
    spans = layout.span_gear.size if np.isfinite(task.inner.rate) else 0
    bucket = next(b for b in _BUCKETS if b >= problem.rows.gap.size)
    program = pool.program(layout.size + 6 + ZONES, 3 + _TRUST_NODES + 2 * spans + bucket)
    _fill_cost(program, problem, prox, penalties)
    _fill_box(program, task, problem.variables, trust)
    program.a[:] = 0.0
    program.lba[:], program.uba[:] = -UNBOUNDED, UNBOUNDED
    _fill_path_rows(program, task, problem, trust, spans)
    _fill_clearance(program, layout, problem.rows, 3 + _TRUST_NODES + 2 * spans)
    solution = program.solve()
    if solution is None:
        return None
    change = solution[: layout.size]
    model = problem.quadratic
    gain = -float(model.gradient @ change + 0.5 * change @ model.hessian @ change)
    return Step(change, gain)


def _fill_cost(program: DenseProgram, problem: StepProblem, prox: float, penalties: Penalties) -> None:
    size = problem.quadratic.gradient.size
    program.h[:] = 0.0
    program.h[:size, :size] = problem.quadratic.hessian + prox * problem.prox
    diagonal = np.arange(program.g.size)
    program.h[diagonal[:size], diagonal[:size]] += _RIDGE
    program.h[diagonal[size : size + 6], diagonal[size : size + 6]] = _SOFT_GOAL
    program.h[diagonal[size + 6 :], diagonal[size + 6 :]] = _SOFT_CLEARANCE
    program.g[:size] = problem.quadratic.gradient
    program.g[size : size + 6] = penalties.goal
    program.g[size + 6 :] = penalties.clearance


def _fill_box(program: DenseProgram, task: Task, variables: Variables, trust: float) -> None:
    size, knots = task.layout.size, task.layout.num_knots
    flat = np.concatenate(variables)
    lower, upper = task.inner.lower - flat, task.inner.upper - flat
    stretch = trust * task.stretch
    lower[knots:] = np.maximum(lower[knots:], -stretch)
    upper[knots:] = np.minimum(upper[knots:], stretch)
    program.lbx[:size] = np.minimum(lower, upper)
    program.ubx[:size] = np.maximum(lower, upper)
    program.lbx[size:], program.ubx[size:] = 0.0, UNBOUNDED


def _fill_path_rows(program: DenseProgram, task: Task, problem: StepProblem, trust: float, spans: int) -> None:
    layout = task.layout
    size, knots = layout.size, layout.num_knots
    jacobian, error = problem.end
    program.a[:3, :size] = jacobian
    program.a[:3, size : size + 3], program.a[:3, size + 3 : size + 6] = np.eye(3), -np.eye(3)
    program.lba[:3] = program.uba[:3] = -error
    turns = slice(3, 3 + _TRUST_NODES)
    program.a[turns, :size] = problem.turns
    program.lba[turns], program.uba[turns] = -trust, trust
    if not spans:
        return
    curvature, lengths = problem.variables
    slopes, allowed = layout.span_rows @ curvature, task.inner.rate * lengths[layout.span_gear]
    for first, sign in ((3 + _TRUST_NODES, 1.0), (3 + _TRUST_NODES + spans, -1.0)):
        block = slice(first, first + spans)
        program.a[block, :knots] = sign * layout.span_rows
        program.a[np.arange(first, first + spans), knots + layout.span_gear] = -task.inner.rate
        program.uba[block] = allowed - sign * slopes


def _fill_clearance(program: DenseProgram, layout: Layout, rows: Rows, first: int) -> None:
    count = rows.gap.size
    block = slice(first, first + count)
    program.a[block, : layout.size] = rows.gradient
    program.a[np.arange(first, first + count), layout.size + 6 + zone_of(layout, rows.node)] = 1.0
    program.lba[block] = -rows.gap


def prepare_programs(pool: ProgramPool) -> None:
    """Build the usual programs and layouts, for one to three gears, and load the solvers."""
    for shape in _USUAL_SHAPES:
        layout = layout_for(shape)
        for bucket in _BUCKETS[:3]:
            pool.program(layout.size + 6 + ZONES, 3 + _TRUST_NODES + 2 * layout.span_gear.size + bucket)
    pool.load_fallback()
