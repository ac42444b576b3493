"""The search: sequential convex steps on exactly driven paths.

A step minimizes a convex quadratic model of the cost within a trust region, under linear bounds on curvature and rate
and linearized goal and clearance constraints with L1 penalties. Every iterate is driven exactly and, where possible,
closed onto the goal, so every iterate is drivable and nearly every one is a candidate for the result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from smoothers._ck.closing import clipped, close_goal, rate_kept, rate_limited
from smoothers._ck.planes import clearance
from smoothers._ck.rollout import Variables, roll_out, sensitivity
from smoothers._ck.steps import ZONES, Penalties, Step, StepProblem, solve_step, zone_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import FloatArray
    from smoothers._ck.planes import Clearance
    from smoothers._ck.qp import ProgramPool
    from smoothers._ck.rollout import Rollout
    from smoothers._ck.task import Task

__all__ = ["Iterate", "Progress", "evaluate", "search"]

_REACH = 0.15  # [m] beyond the required clearance, first iteration
_MOST_REACH = 0.35  # [m], after a long step
_LEAST_REACH = 0.08  # [m], near the end
_GOAL_TOLERANCE = 1e-5
_CLEARANCE_TOLERANCE = 1e-6
_END_ALLOWANCE = 5e-4  # [m]
_NEARLY_CLEAR = 5e-3  # [m]
_SMALL_STEP = 3e-4
_SMALL_SHARE = 1e-3  # of the cost: a predicted gain not worth a step
_MAX_REJECTIONS = 7
_ALTERNATIONS = 2  # between the goal and the curvature rate
_SHRINKING = 0.93  # of its shortfall keeps an infeasible iterate whose patience is at its end
_MAX_PENALTY = 300.0 * 36.0


class Iterate(NamedTuple):
    """A driven path and how it does.

    Attributes:
        variables: Knot curvatures and gear lengths.
        rollout: The driven path.
        cost: Its cost.
        clearance: Its near pairs.
        zones: Shape (ZONES,) [m], worst shortfall of clearance in each zone, >= 0.
        end_error: Shape (3,) [m, m, rad].
    """

    variables: Variables
    rollout: Rollout
    cost: float
    clearance: Clearance
    zones: FloatArray
    end_error: FloatArray

    @property
    def shortfall(self) -> float:
        """Worst shortfall of clearance [m]."""
        return float(self.zones.max())

    @property
    def missing(self) -> float:
        """Shortfall of clearance over all zones and error at the goal [m, rad]."""
        return float(self.zones.sum() + np.abs(self.end_error).sum())

    @property
    def on_goal(self) -> bool:
        """Whether it ends at the target."""
        return float(np.abs(self.end_error).max()) <= _GOAL_TOLERANCE

    @property
    def feasible(self) -> bool:
        """Whether it may be certified."""
        return self.on_goal and self.shortfall <= _CLEARANCE_TOLERANCE


class Progress(NamedTuple):
    """The state after an iteration: the current iterate, and whether the search has ended and converged."""

    iterate: Iterate
    iterations: int
    finished: bool
    accepted: bool


@dataclass
class _Controls:
    """What adapts during the search."""

    trust: float
    prox: float
    patience: int
    penalties: Penalties = field(default_factory=Penalties)
    rejections: int = 0
    gain: float = math.inf
    shortfalls: list[float] = field(default_factory=list)
    found: bool = False

    def overshoot(self, current: Iterate) -> float:
        """How much more clearance than the usual buffer to aim at [m], until a first feasible iterate is found.

        Where sides roll around a corner a step falls short by about as much as the one before it.
        """
        return current.shortfall if not self.found and current.shortfall < _NEARLY_CLEAR else 0.0

    def accept(self) -> None:
        """A step was good: dare more."""
        self.trust = min(2.0 * self.trust, 0.9)
        self.prox = max(0.3 * self.prox, 1e-3)
        self.rejections = 0

    def reject(self, step: float) -> None:
        """A step that moved by `step` was bad: stay closer."""
        self.trust = 0.3 * min(self.trust, max(step, 1e-6))
        self.prox *= 3.0
        self.rejections += 1


def evaluate(task: Task, variables: Variables, rollout: Rollout, reach: float) -> Iterate:
    """Judge a driven path."""
    found = clearance(task.world, task.layout, rollout, task.ends.signs, reach + task.world.rule.required)
    zones = np.zeros(ZONES)
    if found.margin.size:
        node = task.layout.left[found.pairs.interval]
        # The end poses are given and were checked before: the cautious bound next to them is no fault of the path.
        at_ends = (found.pairs.interval == 0) | (found.pairs.interval == task.layout.num_intervals - 1)
        np.maximum.at(zones, zone_of(task.layout, node), np.where(at_ends, -_END_ALLOWANCE, 0.0) - found.margin)
    cost = task.cost.value(variables, rollout)
    return Iterate(variables, rollout, cost, found, zones, task.ends.error(rollout))


def merit(iterate: Iterate, penalties: Penalties) -> float:
    """Cost plus penalties."""
    missed, short = float(np.abs(iterate.end_error).sum()), float(iterate.zones.sum())
    return iterate.cost + penalties.clearance * short + penalties.goal * missed


def search(
    task: Task, pool: ProgramPool, max_iterations: int = 60, is_late: Callable[[], bool] = never_late
) -> Iterator[Progress]:
    """Yield after every iteration, the initial iterate first; the last one is `finished`.

    Args:
        task: What to search for.
        pool: Convex programs.
        max_iterations: Steps at most.
        is_late: Asked within every iteration; once it is True the search ends without a further word.
    """
    controls = _Controls(task.trust, task.prox, task.patience)
    variables, rollout = _closed(task, task.initial)
    if is_late():
        return
    current = evaluate(task, variables, rollout, _REACH)
    yield Progress(current, 0, finished=False, accepted=True)
    problem: StepProblem | None = None
    for iteration in range(1, max_iterations + 1):
        if problem is None:
            controls.found = controls.found or current.feasible
            problem = _linearized(task, current, controls)
            if is_late():
                return
        step = solve_step(task, problem, pool, controls.trust, controls.prox, controls.penalties)
        if is_late():
            return
        finished = current.feasible and step is not None and step.gain < _SMALL_SHARE * current.cost
        better = None if finished else _improved(task, current, step, controls)
        if better is not None:
            finished = _settled(current, better, controls)
            current, problem = better, None
        finished = finished or _hopeless(current, controls) or iteration == max_iterations
        yield Progress(current, iteration, finished=finished, accepted=better is not None)
        if finished:
            return


def _improved(task: Task, current: Iterate, step: Step | None, controls: _Controls) -> Iterate | None:
    """The iterate after a step if its merit is lower; adapts the controls."""
    if step is None:
        controls.reject(controls.trust)
        return None
    trial, moved = _trial(task, current, step)
    if merit(trial, controls.penalties) < merit(current, controls.penalties):
        controls.accept()
        return trial
    controls.reject(moved)
    return None


def _settled(before: Iterate, after: Iterate, controls: _Controls) -> bool:
    """Whether a feasible iterate has stopped to improve, or will with the next step if gains shrink as they did."""
    gain = merit(before, controls.penalties) - merit(after, controls.penalties)
    previous, controls.gain = controls.gain, gain if before.feasible else math.inf
    expected = gain * min(1.0, gain / previous) if math.isfinite(previous) else gain
    return after.feasible and before.feasible and min(gain, 2.0 * expected) < _SMALL_SHARE * after.cost


def _hopeless(current: Iterate, controls: _Controls) -> bool:
    """Whether to give up: a feasible iterate that no step improves, or a shortfall that no longer shrinks.

    Where the shortfall costs less than the path itself, its weight is raised first.
    """
    if current.feasible:
        return controls.rejections > _MAX_REJECTIONS or controls.trust < _SMALL_STEP
    controls.shortfalls.append(current.missing)
    recent = controls.shortfalls[-controls.patience :]
    if len(recent) < controls.patience or recent[-1] < _SHRINKING * recent[0]:
        return False
    if controls.penalties.clearance >= _MAX_PENALTY or controls.penalties.clearance * current.missing > current.cost:
        return True
    controls.penalties = controls.penalties.raised()
    controls.trust, controls.prox = max(controls.trust, 0.1), min(controls.prox, 1.0)
    controls.rejections = 0
    controls.shortfalls.clear()
    return False


def _linearized(task: Task, current: Iterate, controls: _Controls) -> StepProblem:
    by = sensitivity(task.layout, current.variables, current.rollout)
    quadratic = task.cost.quadratic(current.variables, current.rollout, by)
    around = StepProblem.around(task, current.variables, current.rollout, current.clearance, by, quadratic)
    return around.aiming(task.buffer + controls.overshoot(current))


def _closed(task: Task, variables: Variables) -> tuple[Variables, Rollout]:
    """The variables closed onto the goal where that keeps the curvature rate; else as they are, within the rate."""
    layout, ends = task.layout, task.ends
    closed = close_goal(layout, variables, ends, task.bounds)
    for _ in range(_ALTERNATIONS):
        if rate_kept(layout, closed, task.bounds):
            break
        closed = close_goal(layout, rate_limited(layout, closed, task.inner), ends, task.bounds)
    if not rate_kept(layout, closed, task.bounds):
        closed = rate_limited(layout, variables, task.inner)
    return closed, roll_out(layout, closed, ends.start, ends.signs)


def _trial(task: Task, current: Iterate, step: Step) -> tuple[Iterate, float]:
    """The iterate after a step, and how far it turned or stretched at most."""
    knots, change = task.layout.num_knots, step.change
    wanted = Variables(current.variables.curvature + change[:knots], current.variables.lengths + change[knots:])
    variables, rollout = _closed(task, clipped(wanted, task.bounds))
    turned = float(np.abs(rollout.poses[:, 2] - current.rollout.poses[:, 2]).max())
    moved = max(turned, float(np.abs(variables.lengths - current.variables.lengths).max()))
    return evaluate(task, variables, rollout, min(_MOST_REACH, 1.5 * moved + _LEAST_REACH)), moved
