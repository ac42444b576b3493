"""Reference of `CasadiSmoother`: the whole problem as one nonlinear program for ipopt, with free separating lines.

Every near pair of interval and obstacle has a separate line (an angle and an offset) that must have the swept vertices
on one side and the obstacle on the other. Unlike in the sequential steps, nothing is linearized and no line is fixed,
so a local optimum of the program is a local optimum of the problem. Slow: for comparison only. Its symbolic roll-out
and cost are also the reference of the hand-written derivatives.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import casadi
import numpy as np

from optdock.deadline import Deadline
from optdock.plugins.interfaces import SmoothingReport, SmoothingResult, SmoothingStatus, never_cancelled
from optdock.verification import certify_path
from smoothers.casadi_smoother import CasadiSmoother
from smoothers.scp.basis import basis_for
from smoothers.scp.collision.broad_phase import Pairs, broad_phase
from smoothers.scp.collision.collision_scene import body_at_nodes
from smoothers.scp.collision.narrow_phase import narrow_phase
from smoothers.scp.goal_projection import clipped, exact_path, onto_goal
from smoothers.scp.loop import judged
from smoothers.scp.qp_step import pool_of_this_thread
from smoothers.scp.refusals import refuse_search
from smoothers.scp.rollout import Variables, roll_out
from smoothers.scp.search import Solver

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from smoothers.scp.basis import Basis, Shape
    from smoothers.scp.collision.narrow_phase import Clearance
    from smoothers.scp.cost import CostModel
    from smoothers.scp.loop import Iterate
    from smoothers.scp.nlp import NonlinearProgram

__all__ = ["SymbolicModel", "cost_expression", "model_for", "smooth_by_ipopt", "solve_reference"]

_ROUNDS = 8  # the near pairs and the dips between nodes are updated after each round
_REACH = 0.12  # [m]
_SETTLED = 1e-4  # relative change of the cost
_SHORTEST = 0.05  # [s], minimum time of a round
_BUFFER = 2e-5  # [m]


_Option: TypeAlias = "bool | float | str | Mapping[str, float | str]"


def smooth_by_ipopt(path: Path, max_time: float, problem: DockingProblem, **parameters: object) -> SmoothingResult:
    """Solve the problem that `CasadiSmoother(**parameters).smooth(path, max_time, problem=problem)` approximates.

    Raises:
        FailedToSmoothPath: If ipopt ends with a path that is not certified.
    """
    smoother = CasadiSmoother(**parameters)
    deadline = Deadline(max_time)
    path = path.with_frame(problem.frame)
    solver = Solver(pool_of_this_thread(), deadline, never_cancelled, smoother.settings)
    nlp, guesses = solver.prepared(smoother.call_for(path, problem))
    straight = problem.dock.final_straight
    iterate, settled = solve_reference(nlp, guesses.first.variables, deadline)
    found = exact_path(nlp, iterate.variables, straight).with_frame(problem.frame)
    certificate = certify_path(found, problem)
    if not certificate.certified:
        refusal = refuse_search(nlp, iterate, problem)
        raise refusal._replace(more={**refusal.more, "certificate": certificate.reason}).error()
    status = SmoothingStatus.CONVERGED if settled else SmoothingStatus.STOPPED
    report = SmoothingReport(status, iterate.cost, total_s=deadline.elapsed, certificate=certificate)
    return SmoothingResult(found, settled, report)


def solve_reference(nlp: NonlinearProgram, guess: Variables, deadline: Deadline) -> tuple[Iterate, bool]:
    """Return the best iterate of ipopt, and whether the rounds converged.

    Args:
        nlp: The problem.
        guess: Initial iterate.
        deadline: Seconds left; the last round may exceed it by one iteration of ipopt and the symbolic set-up.
    """
    ends = nlp.ends
    variables = onto_goal(nlp.basis, clipped(guess, nlp.bounds), ends, nlp.bounds, nlp.settings.projection)
    current = _judged(nlp, variables)
    settled = False
    seen: IntArray = np.zeros((0, 3), dtype=np.int64)
    for _ in range(_ROUNDS):
        body = body_at_nodes(nlp.scene, current.rollout.poses)
        near = broad_phase(nlp.scene, nlp.basis, current.rollout, body, _REACH + nlp.scene.rule.required)
        # Near pairs stay active, because otherwise two rounds could alternate between ignoring different obstacles.
        seen = np.unique(np.concatenate((seen, np.column_stack(near))), axis=0)
        found = narrow_phase(nlp.scene, nlp.basis, current.rollout, ends.signs, body, Pairs(*seen.T))
        solved, success = _round(nlp, current, found, max(_SHORTEST, deadline.left))
        settled = success and solved.feasible and abs(solved.cost - current.cost) < _SETTLED * current.cost
        current = solved
        if settled or deadline.left <= 0.0:
            break
    return current, settled


def _judged(nlp: NonlinearProgram, variables: Variables) -> Iterate:
    return judged(nlp, variables, roll_out(nlp.basis, variables, nlp.ends.start, nlp.ends.signs), _REACH)


class _Program(NamedTuple):
    """Symbols and constraints `lower <= value <= upper`."""

    value: casadi.SX
    lower: FloatArray
    upper: FloatArray


def _round(nlp: NonlinearProgram, current: Iterate, found: Clearance, max_time: float) -> tuple[Iterate, bool]:
    basis, model = nlp.basis, model_for(nlp.basis.shape)
    count = found.margin.size
    angles, offsets = casadi.SX.sym("angle", count), casadi.SX.sym("offset", count)
    parts = [_path_constraints(nlp, model)]
    if count:
        parts.append(_line_constraints(nlp, current, found, (angles, offsets)))
    symbols = {
        "x": casadi.vertcat(model.variables, angles, offsets),
        "p": casadi.vertcat(model.start, model.signs),
        "f": cost_expression(model, nlp.cost),
        "g": casadi.vertcat(*(part.value for part in parts)),
    }
    solver = casadi.nlpsol("reference", "ipopt", symbols, _options(max_time))
    free = np.full(2 * count, np.inf)
    result = solver(
        x0=np.concatenate((*current.variables, np.arctan2(found.axis.y[0], found.axis.x[0]), found.top)),
        p=np.concatenate((nlp.ends.start, nlp.ends.signs)),
        lbx=np.concatenate((nlp.bounds.lower, -free)),
        ubx=np.concatenate((nlp.bounds.upper, free)),
        lbg=np.concatenate([part.lower for part in parts]),
        ubg=np.concatenate([part.upper for part in parts]),
    )
    flat = np.array(result["x"]).ravel()[: basis.size]
    if not np.all(np.isfinite(flat)):
        return current, False
    variables = clipped(Variables(flat[: basis.num_knots], flat[basis.num_knots :]), nlp.bounds)
    return _judged(nlp, variables), bool(solver.stats()["success"])


def _options(max_time: float) -> dict[str, _Option]:
    """Return options: silent, with a small initial barrier that keeps the first step in its basin."""
    return {
        "print_time": False,
        "error_on_fail": False,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "tol": 1e-7,
            "max_iter": 400,
            "max_cpu_time": max_time,
            "mu_init": 1e-3,
            "bound_push": 1e-4,
            "bound_frac": 1e-4,
        },
    }


def _path_constraints(nlp: NonlinearProgram, model: SymbolicModel) -> _Program:
    """Add the constraints of goal pose and curvature rate."""
    basis = nlp.basis
    goal = model.poses[-1, :].T
    if not np.isfinite(nlp.bounds.rate):
        return _Program(goal, nlp.ends.target, nlp.ends.target)
    lengths = model.variables[basis.num_knots :]
    allowed = nlp.bounds.rate * lengths[basis.span_gear.tolist(), :]
    value = casadi.vertcat(goal, model.slopes - allowed, -model.slopes - allowed)
    count = 2 * basis.span_gear.size
    lower = np.concatenate((nlp.ends.target, np.full(count, -np.inf)))
    return _Program(value, lower, np.concatenate((nlp.ends.target, np.zeros(count))))


def _line_constraints(
    nlp: NonlinearProgram, current: Iterate, found: Clearance, lines: tuple[casadi.SX, casadi.SX]
) -> _Program:
    """Keep swept vertices above their line by requirement and dip, obstacle vertices below it."""
    model, (angles, offsets) = model_for(nlp.basis.shape), lines
    count = found.hull.x.shape[0] // 2
    left = nlp.basis.left[found.pairs.interval]
    x, y = casadi.cos(angles), casadi.sin(angles)
    dips = found.hull.along(found.axis) - found.heights  # requirement and dip, Shape (2v, p)
    values = []
    for side, node in enumerate((left, left + 1)):
        required = found.required.value[node]
        pose = model.poses[node.tolist(), :]
        c, s = casadi.cos(pose[:, 2]), casadi.sin(pose[:, 2])
        moving = _required_expression(current, found, node, pose)
        for v in range(count):
            arm = nlp.scene.body.vertices[found.pairs.part, v]
            px = pose[:, 0] + c * arm[:, 0] - s * arm[:, 1]
            py = pose[:, 1] + s * arm[:, 0] + c * arm[:, 1]
            fixed = casadi.DM(dips[side * count + v] - required + _BUFFER)
            values.append(x * px + y * py - offsets - moving - fixed)
    corners = zip(found.outline.x, found.outline.y, strict=True)
    values.extend(offsets - x * casadi.DM(corner_x) - y * casadi.DM(corner_y) for corner_x, corner_y in corners)
    total = casadi.vertcat(*values)
    return _Program(total, np.zeros(total.shape[0]), np.full(total.shape[0], np.inf))


def _required_expression(current: Iterate, found: Clearance, node: IntArray, pose: casadi.SX) -> casadi.SX:
    """Return the required clearance at nodes, to first order in their positions around those of the last round."""
    value, gradient = casadi.DM(found.required.value[node]), casadi.DM(found.required.gradient[node])
    return value + casadi.sum2(gradient * (pose[:, :2] - casadi.DM(current.rollout.poses[node, :2])))


class SymbolicModel(NamedTuple):
    """Symbolic path of one shape.

    Attributes:
        variables: Knot curvatures, then gear lengths, Shape (size, 1).
        start: Start pose, Shape (3, 1).
        signs: Gears, Shape (num_gears, 1).
        poses: Node poses, Shape (num_nodes, 3).
        slopes: Curvature rate times gear length of every span, Shape (number of spans, 1).
        roll_out: Function of variables, start and signs that returns `poses`.
    """

    variables: casadi.SX
    start: casadi.SX
    signs: casadi.SX
    poses: casadi.SX
    slopes: casadi.SX
    roll_out: casadi.Function


@lru_cache(maxsize=16)
def model_for(shape: Shape) -> SymbolicModel:
    """Return the model of a shape, cached."""
    basis = basis_for(shape)
    variables = casadi.SX.sym("z", basis.size)
    start, signs = casadi.SX.sym("start", 3), casadi.SX.sym("signs", basis.num_gears)
    curvature, lengths = variables[: basis.num_knots], variables[basis.num_knots :]
    turned = _spread(basis.knot_members) @ lengths * curvature
    yaw = start[2] + _spread(basis.gauss_headings) @ turned
    weight = _spread(basis.gauss_shares) @ (lengths * signs)
    pairs = _spread(np.repeat(np.eye(basis.num_intervals), 2, axis=1))
    columns = []
    for i, move in enumerate((weight * casadi.cos(yaw), weight * casadi.sin(yaw))):
        path = casadi.vertcat(start[i], start[i] + casadi.cumsum(pairs @ move))
        columns.append(path[basis.position_of.tolist(), :])
    columns.append(start[2] + _spread(basis.node_headings) @ turned)
    poses = casadi.horzcat(*columns)
    slopes = _spread(basis.span_slopes) @ curvature
    roll_out = casadi.Function("roll_out", [variables, start, signs], [poses], ["z", "start", "signs"], ["poses"])
    return SymbolicModel(variables, start, signs, poses, slopes, roll_out)


def _spread(matrix: FloatArray) -> casadi.DM:
    """Return a constant matrix in sparse form."""
    return casadi.sparsify(casadi.DM(matrix))


def cost_expression(model: SymbolicModel, cost: CostModel) -> casadi.SX:
    """Return the cost of `smoothers.scp.cost` as an expression in the model's symbols."""
    basis: Basis = cost.basis
    bend, jerk = cost.factors
    curvature, lengths = model.variables[: basis.num_knots], model.variables[basis.num_knots :]
    total = casadi.sum1(lengths)
    value = cost.weights.length * total
    per_knot = _spread(basis.knot_members) @ lengths
    value += bend * casadi.dot(per_knot * curvature, _spread(basis.mass) @ curvature)
    value += jerk * casadi.dot(curvature / per_knot, _spread(basis.stiffness) @ curvature)
    normals, positions = casadi.DM(cost.reference.normals), casadi.DM(cost.reference.positions)
    lateral = casadi.sum2(normals * (model.poses[:, :2] - positions))
    return value + cost.weights.tracking * total / basis.num_intervals * casadi.dot(lateral, lateral)
