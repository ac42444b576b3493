"""The reference: the whole problem as one nonlinear program for ipopt, with free separating lines.

Every near pair of interval and obstacle gets a line of its own (an angle and an offset) that must have the swept
vertices on one side and the obstacle on the other. Unlike the sequential steps, nothing is linearized and no line is
fixed, so a local optimum of the program is a local optimum of the problem. Slow: for comparison only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import casadi
import numpy as np

from smoothers._ck.closing import clipped, close_goal
from smoothers._ck.nearby import Pairs
from smoothers._ck.planes import clearance, clearance_of
from smoothers._ck.rollout import Variables, roll_out
from smoothers._ck.scp import evaluate
from smoothers._ck.symbolic import cost_expression, model_for

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.arrays import FloatArray, IntArray
    from smoothers._ck.budget import Budget
    from smoothers._ck.planes import Clearance
    from smoothers._ck.scp import Iterate
    from smoothers._ck.symbolic import SymbolicModel
    from smoothers._ck.task import Task

__all__ = ["solve_reference"]

_ROUNDS = 8  # the set of near pairs and the dips between nodes are renewed after each
_REACH = 0.12  # [m]
_SETTLED = 1e-4  # relative change of the cost
_SHORTEST = 0.05  # [s], of a round
_BUFFER = 2e-5  # [m]


_Option: TypeAlias = "bool | float | str | Mapping[str, float | str]"


class _Program(NamedTuple):
    """Symbols and constraints `lower <= value <= upper`."""

    value: casadi.SX
    lower: FloatArray
    upper: FloatArray


def solve_reference(task: Task, budget: Budget) -> tuple[Iterate, bool]:
    """The best iterate ipopt finds, and whether the rounds settled.

    Args:
        task: The problem.
        budget: Seconds left; the last round may overrun it by one of ipopt's iterations and the symbolic set-up.
    """
    layout, ends = task.layout, task.ends
    variables = close_goal(layout, clipped(task.initial, task.bounds), ends, task.bounds)
    rollout = roll_out(layout, variables, ends.start, ends.signs)
    current = evaluate(task, variables, rollout, _REACH)
    settled = False
    watched: IntArray = np.zeros((0, 3), dtype=np.int64)
    for _ in range(_ROUNDS):
        near = clearance(task.world, layout, current.rollout, ends.signs, _REACH + task.world.rule.required)
        # What was near once stays watched, or two rounds could take turns in overlooking each other's obstacles.
        watched = np.unique(np.concatenate((watched, np.column_stack(near.pairs))), axis=0)
        found = clearance_of(task.world, layout, current.rollout, ends.signs, Pairs(*watched.T))
        solved, success = _round(task, current, found, max(_SHORTEST, budget.left))
        settled = success and solved.feasible and abs(solved.cost - current.cost) < _SETTLED * current.cost
        current = solved
        if settled or budget.left <= 0.0:
            break
    return current, settled


def _round(task: Task, current: Iterate, found: Clearance, max_time: float) -> tuple[Iterate, bool]:
    layout, model = task.layout, model_for(task.layout.shape)
    count = found.margin.size
    angles, offsets = casadi.SX.sym("angle", count), casadi.SX.sym("offset", count)
    parts = [_path_constraints(task, model)]
    if count:
        parts.append(_line_constraints(task, current, found, (angles, offsets)))
    symbols = {
        "x": casadi.vertcat(model.variables, angles, offsets),
        "p": casadi.vertcat(model.start, model.signs),
        "f": cost_expression(model, task.cost),
        "g": casadi.vertcat(*(part.value for part in parts)),
    }
    solver = casadi.nlpsol("reference", "ipopt", symbols, _options(max_time))
    free = np.full(2 * count, np.inf)
    result = solver(
        x0=np.concatenate((*current.variables, np.arctan2(found.axis.y[0], found.axis.x[0]), found.top)),
        p=np.concatenate((task.ends.start, task.ends.signs)),
        lbx=np.concatenate((task.bounds.lower, -free)),
        ubx=np.concatenate((task.bounds.upper, free)),
        lbg=np.concatenate([part.lower for part in parts]),
        ubg=np.concatenate([part.upper for part in parts]),
    )
    flat = np.array(result["x"]).ravel()[: layout.size]
    if not np.all(np.isfinite(flat)):
        return current, False
    variables = clipped(Variables(flat[: layout.num_knots], flat[layout.num_knots :]), task.bounds)
    rollout = roll_out(layout, variables, task.ends.start, task.ends.signs)
    return evaluate(task, variables, rollout, _REACH), bool(solver.stats()["success"])


def _options(max_time: float) -> dict[str, _Option]:
    """Silent, and with a small first barrier: a large one throws the first step into another basin."""
    return {
        "print_time": False,
        "error_on_fail": False,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "tol": 1e-7,
            "max_iter": 400,
            "max_wall_time": max_time,
            "mu_init": 1e-3,
            "bound_push": 1e-4,
            "bound_frac": 1e-4,
        },
    }


def _path_constraints(task: Task, model: SymbolicModel) -> _Program:
    """Goal pose and curvature rate."""
    layout = task.layout
    goal = model.poses[-1, :].T
    if not np.isfinite(task.bounds.rate):
        return _Program(goal, task.ends.target, task.ends.target)
    lengths = model.variables[layout.num_knots :]
    allowed = task.bounds.rate * lengths[layout.span_gear.tolist(), :]
    value = casadi.vertcat(goal, model.slopes - allowed, -model.slopes - allowed)
    count = 2 * layout.span_gear.size
    lower = np.concatenate((task.ends.target, np.full(count, -np.inf)))
    return _Program(value, lower, np.concatenate((task.ends.target, np.zeros(count))))


def _line_constraints(task: Task, current: Iterate, found: Clearance, lines: tuple[casadi.SX, casadi.SX]) -> _Program:
    """Swept vertices above their line by the requirement and the dip, obstacle vertices below it."""
    model, (angles, offsets) = model_for(task.layout.shape), lines
    count = found.hull.x.shape[0] // 2
    left = task.layout.left[found.pairs.interval]
    x, y = casadi.cos(angles), casadi.sin(angles)
    dips = found.hull.along(found.axis) - found.heights  # requirement and dip, Shape (2v, p)
    values = []
    for side, node in enumerate((left, left + 1)):
        required = found.required.value[node]
        pose = model.poses[node.tolist(), :]
        c, s = casadi.cos(pose[:, 2]), casadi.sin(pose[:, 2])
        moving = _required_expression(current, found, node, pose)
        for v in range(count):
            arm = task.world.body.vertices[found.pairs.part, v]
            px = pose[:, 0] + c * arm[:, 0] - s * arm[:, 1]
            py = pose[:, 1] + s * arm[:, 0] + c * arm[:, 1]
            fixed = casadi.DM(dips[side * count + v] - required + _BUFFER)
            values.append(x * px + y * py - offsets - moving - fixed)
    rocks = zip(found.outline.x, found.outline.y, strict=True)
    values.extend(offsets - x * casadi.DM(rock_x) - y * casadi.DM(rock_y) for rock_x, rock_y in rocks)
    total = casadi.vertcat(*values)
    return _Program(total, np.zeros(total.shape[0]), np.full(total.shape[0], np.inf))


def _required_expression(current: Iterate, found: Clearance, node: IntArray, pose: casadi.SX) -> casadi.SX:
    """Required clearance at nodes, first order in their positions around the last round's."""
    value, gradient = casadi.DM(found.required.value[node]), casadi.DM(found.required.gradient[node])
    return value + casadi.sum2(gradient * (pose[:, :2] - casadi.DM(current.rollout.poses[node, :2])))
