"""From the solver's variables to an exact path, closed onto the goal to rounding accuracy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.path import ClothoidSegment, Path
from smoothers._ck.closing import least_norm_step
from smoothers._ck.rollout import Variables, end_sensitivity, roll_out

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from smoothers._ck.layout import Layout
    from smoothers._ck.task import Task

__all__ = ["exact_path"]

_CLOSED = 1e-10
_MAX_STEPS = 4


def exact_path(task: Task, variables: Variables, final_straight: float) -> tuple[Path, Variables]:
    """The clothoid splines of all gears, the last one with the final straight, and the variables finally used."""
    layout, knots = task.layout, task.layout.num_knots
    splines = _chained(layout, variables, task.ends.start, task.ends.signs)
    for _ in range(_MAX_STEPS):
        error = splines[-1].end.as_array() - task.ends.target
        if float(np.abs(error).max()) < _CLOSED:
            break
        rollout = roll_out(layout, variables, task.ends.start, task.ends.signs)
        flat = np.concatenate(variables)
        step = least_norm_step(end_sensitivity(layout, variables, rollout.moves), error, flat, task.bounds)
        moved = np.clip(flat + step, task.bounds.lower, task.bounds.upper)
        variables = Variables(moved[:knots], moved[knots:])
        splines = _chained(layout, variables, task.ends.start, task.ends.signs)
    if final_straight > 0.0:
        splines[-1] = _with_straight(splines[-1], final_straight)
    return Path(tuple(ClothoidSegment(spline) for spline in splines)), variables


def _chained(layout: Layout, variables: Variables, start: FloatArray, signs: FloatArray) -> list[ClothoidSpline]:
    pose = Pose2.from_sequence(start)
    splines = []
    for m, (first, last) in enumerate(zip(layout.first_knots, layout.last_knots, strict=True)):
        knots = np.linspace(0.0, variables.lengths[m], last - first + 1)
        spline = ClothoidSpline(pose, knots, variables.curvature[first : last + 1], int(signs[m]))
        splines.append(spline)
        pose = spline.end
    return splines


def _with_straight(spline: ClothoidSpline, length: float) -> ClothoidSpline:
    knots = np.append(spline.knots, spline.length + length)
    return ClothoidSpline(spline.start, knots, np.append(spline.curvature, 0.0), spline.sign)
