"""Reference of `CasadiSmoother`: the whole problem as one nonlinear program for ipopt, with free separating lines.

Every near pair of interval and obstacle has a separate line (an angle and an offset) that must have the swept vertices
on one side and the obstacle on the other. Unlike in the sequential steps, nothing is linearized and no line is fixed,
so a local optimum of the program is a local optimum of the problem. Slow: for comparison only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import casadi
import numpy as np

from experiments.benchmarks.symbolic_program import cost_expression, end_error, model_for, rate_rows, term_expressions
from optdock.deadline import Deadline
from optdock.plugins.interfaces import SmoothingReport, SmoothingResult, SmoothingStatus, never_cancelled
from optdock.verification import certify_path
from smoothers.casadi_smoother import CasadiSmoother
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
    from collections.abc import Iterable, Mapping

    from experiments.benchmarks.symbolic_program import SymbolicModel
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from smoothers.scp.collision.narrow_phase import Clearance
    from smoothers.scp.loop import Iterate
    from smoothers.scp.nlp import NonlinearProgram
    from smoothers.terms import PathTerm

__all__ = ["smooth_by_ipopt", "solve_reference"]

_ROUNDS = 8  # the near pairs and the dips between nodes are updated after each round
_REACH = 0.12  # [m]
_SETTLED = 1e-4  # relative change of the cost
_SHORTEST = 0.05  # [s], minimum time of a round
_BUFFER = 2e-5  # [m]
_ROUNDING = 1e-9  # of hard terms at the start, which is given


_Option: TypeAlias = "bool | float | str | Mapping[str, float | str]"


def smooth_by_ipopt(
    path: Path, max_time: float, problem: DockingProblem, terms: Iterable[PathTerm] = (), **parameters: object
) -> SmoothingResult:
    """Solve the problem that `CasadiSmoother(terms=terms, **parameters).smooth(...)` approximates.

    Raises:
        FailedToSmoothPath: If ipopt ends with a path that is not certified, or violates a hard term at a sample.
    """
    smoother = CasadiSmoother(terms=terms, **parameters)
    deadline = Deadline(max_time)
    path = path.with_frame(problem.frame)
    solver = Solver(pool_of_this_thread(), deadline, never_cancelled, smoother.settings)
    nlp, guesses = solver.prepared(smoother.call_for(path, problem))
    straight = problem.dock.final_straight
    iterate, settled = solve_reference(nlp, guesses.first.variables, deadline)
    found = exact_path(nlp, iterate.variables, straight, problem.frame)
    certificate = certify_path(found, problem)
    if not certificate.certified:
        refusal = refuse_search(nlp, iterate, problem)
        raise refusal._replace(more={**refusal.more, "certificate": certificate.reason}).error()
    sampled = smoother.sampled_bounds(found)
    broken = next((bound for bound in sampled if not bound.holds), None)
    if broken is not None:
        raise broken.failure(found)
    status = SmoothingStatus.CONVERGED if settled else SmoothingStatus.STOPPED
    report = SmoothingReport(status, iterate.cost, total_s=deadline.elapsed, certificate=certificate, sampled=sampled)
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
    cost, parts = cost_expression(model, nlp.cost), [_path_constraints(nlp, model)]
    if nlp.terms is not None:
        added, hard = term_expressions(model, nlp.terms)
        cost += added
        parts.append(_term_constraints(nlp, current, hard))
    if count:
        parts.append(_line_constraints(nlp, current, found, (angles, offsets)))
    symbols = {
        "x": casadi.vertcat(model.variables, angles, offsets),
        "p": casadi.vertcat(model.start, model.signs),
        "f": cost,
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
    goal, zero = end_error(model, nlp.ends.target), np.zeros(3)
    if not np.isfinite(nlp.bounds.rate):
        return _Program(goal, zero, zero)
    rates = rate_rows(model, nlp.bounds.rate)
    lower = np.concatenate((zero, np.full(rates.shape[0], -np.inf)))
    return _Program(casadi.vertcat(goal, rates), lower, np.zeros(lower.size))


def _term_constraints(nlp: NonlinearProgram, current: Iterate, hard: casadi.SX) -> _Program:
    """Keep hard terms above the buffer of the sequential steps, which vanishes at the ends."""
    settings, ends = nlp.settings.step, (nlp.ends.start, nlp.ends.target)
    away = np.min([np.hypot(*(current.rollout.poses[:, :2] - end[:2]).T) for end in ends], axis=0)
    buffer = settings.buffer * np.minimum(1.0, away / settings.buffer_taper) - _ROUNDING
    return _Program(casadi.vec(hard), np.tile(buffer, hard.shape[1]), np.full(hard.numel(), np.inf))


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
