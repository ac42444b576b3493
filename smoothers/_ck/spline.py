"""From the solver's variables to an exact path, closed onto the goal to rounding accuracy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.path import ClothoidSegment, Path
from smoothers._ck.closing import close_goal, least_norm_step
from smoothers._ck.rollout import Variables, end_sensitivity, roll_out

if TYPE_CHECKING:
    from smoothers._ck.closing import Ends
    from smoothers._ck.layout import Layout
    from smoothers._ck.task import Task

__all__ = ["exact_path"]

_CLOSED = 3e-8  # [m, rad], a thirtieth of what the certificate accepts
_POLISHED = 1e-11  # of the roll-out, which is within some 1e-9 of the spline
_MAX_STEPS = 4


def exact_path(task: Task, variables: Variables, final_straight: float) -> tuple[Path, Variables]:
    """The clothoid splines of all gears, the last one with the final straight, and the variables finally used."""
    layout, knots = task.layout, task.layout.num_knots
    target = task.ends.target
    back = float(task.ends.signs[-1]) * final_straight
    goal = target + back * np.array([np.cos(target[2]), np.sin(target[2]), 0.0])
    variables = close_goal(layout, variables, task.ends, task.bounds, _POLISHED)
    splines = _chained(layout, variables, task.ends, final_straight)
    for _ in range(_MAX_STEPS):
        error = splines[-1].end.as_array() - goal
        if float(np.abs(error).max()) < _CLOSED:
            break
        error[:2] -= error[2] * back * np.array([-np.sin(target[2]), np.cos(target[2])])  # seen before the straight
        rollout = roll_out(layout, variables, task.ends.start, task.ends.signs)
        flat = np.concatenate(variables)
        step = least_norm_step(end_sensitivity(layout, variables, rollout.moves), error, flat, task.bounds)
        moved = np.clip(flat + step, task.bounds.lower, task.bounds.upper)
        variables = Variables(moved[:knots], moved[knots:])
        splines = _chained(layout, variables, task.ends, final_straight)
    return Path(tuple(ClothoidSegment(spline) for spline in splines)), variables


def _chained(layout: Layout, variables: Variables, ends: Ends, final_straight: float) -> list[ClothoidSpline]:
    """One spline per gear, each from the end of the one before, the straight at the last one's end."""
    pose = Pose2.from_sequence(ends.start)
    splines = []
    for m, (first, last) in enumerate(zip(layout.first_knots, layout.last_knots, strict=True)):
        knots = np.linspace(0.0, variables.lengths[m], last - first + 1)
        curvature = variables.curvature[first : last + 1]
        if m == layout.num_gears - 1 and final_straight > 0.0:
            knots, curvature = np.append(knots, knots[-1] + final_straight), np.append(curvature, 0.0)
        spline = ClothoidSpline(pose, knots, curvature, int(ends.signs[m]))
        splines.append(spline)
        pose = spline.end
    return splines
