"""The loop: sequential convex programming with an L1 merit function and a trust region.

A step minimizes a convex quadratic model of the cost within the trust region, under linear bounds on curvature and rate
and linearized goal and clearance constraints with L1 penalties. Every iterate is driven exactly and, where possible,
projected onto the goal, so every iterate is drivable and nearly every one is a candidate for the result. A step is
accepted when it lowers the merit `J + rho * shortfalls of clearance + rho_T * error at the goal` ([Fletcher1985],
[Nocedal2006] ch. 18).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import never_late
from smoothers.scp.collision.active_pairs import active_pairs
from smoothers.scp.collision.broad_phase import broad_phase
from smoothers.scp.collision.collision_scene import body_at_nodes
from smoothers.scp.collision.linearization import ClearanceRows, linearized_clearance
from smoothers.scp.collision.narrow_phase import narrow_phase
from smoothers.scp.goal_projection import end_sensitivity, project_and_roll_out
from smoothers.scp.qp_step import Penalties, QpStep, Subproblem, solve_step, trusted_nodes, zone_of
from smoothers.scp.rollout import Variables, sensitivity
from smoothers.scp.visibility_constraint import linearized_view, view_along

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import FloatArray
    from smoothers.scp.collision.narrow_phase import Clearance
    from smoothers.scp.nlp import NonlinearProgram
    from smoothers.scp.qp_step import ProgramPool
    from smoothers.scp.rollout import Rollout
    from smoothers.scp.settings import LoopSettings
    from smoothers.scp.visibility_constraint import SeenPlaces

__all__ = ["Iterate", "Progress", "SearchGuess", "evaluated", "judged", "search"]


class SearchGuess(NamedTuple):
    """Where a search begins, and how boldly.

    Attributes:
        variables: Curvatures and lengths.
        trust_region: First bound of the heading changes of a step [rad].
        proximal: First weight of the squared motion of a step.
        patience: Iterations within which an infeasible iterate must lose a good part of its shortfall.
    """

    variables: Variables
    trust_region: float
    proximal: float
    patience: int


class Iterate(NamedTuple):
    """A driven path and how it does.

    Attributes:
        variables: Knot curvatures and gear lengths.
        rollout: The driven path.
        cost: Its cost.
        clearance: Its near pairs.
        zones: Shape (zones,) [m], worst shortfall of clearance and of the view in each zone, >= 0.
        end_error: Shape (3,) [m, m, rad].
        on_goal: Whether it ends at the target.
        feasible: Whether it may be certified.
        view: The view where the path must have it; None where nothing must be seen.
    """

    variables: Variables
    rollout: Rollout
    cost: float
    clearance: Clearance
    zones: FloatArray
    end_error: FloatArray
    on_goal: bool
    feasible: bool
    view: SeenPlaces | None = None

    @property
    def shortfall(self) -> float:
        """Worst shortfall of clearance or of the view [m]."""
        return float(self.zones.max())

    @property
    def missing(self) -> float:
        """Shortfalls over all zones and error at the goal [m, rad]."""
        return float(self.zones.sum() + np.abs(self.end_error).sum())

    def merit(self, penalties: Penalties) -> float:
        """Cost plus penalties."""
        missed, short = float(np.abs(self.end_error).sum()), float(self.zones.sum())
        return self.cost + penalties.clearance * short + penalties.goal * missed


class Progress(NamedTuple):
    """The state after an iteration: the current iterate, and whether the search has ended and converged."""

    iterate: Iterate
    iterations: int
    finished: bool


def search(
    nlp: NonlinearProgram,
    guess: SearchGuess,
    pool: ProgramPool,
    max_iterations: int = 60,
    is_late: Callable[[], bool] = never_late,
) -> Iterator[Progress]:
    """Yield after every iteration, the initial iterate first; the last one is `finished`.

    Args:
        nlp: What to search for.
        guess: Where to begin.
        pool: Convex programs.
        max_iterations: Steps at most.
        is_late: Asked within every iteration; once it is True the search ends without a further word.
    """
    state = _State.at(guess, nlp.settings.loop)
    if is_late():
        return
    current, _ = evaluated(nlp, guess.variables)
    yield Progress(current, 0, finished=False)
    around: Subproblem | None = None
    for iteration in range(1, max_iterations + 1):
        if around is None:
            state.found = state.found or current.feasible
            around = _linearized(nlp, current, state)
            if is_late():
                return
        step = solve_step(nlp, around, pool, state.trust_region, state.proximal, state.penalties)
        if is_late():
            return
        finished = current.feasible and step is not None and step.gain < state.settings.small_gain * current.cost
        better = None if finished else _improved(nlp, current, step, state)
        if better is not None:
            finished = state.has_settled(current, better)
            current, around = better, None
        finished = finished or state.is_hopeless(current) or iteration == max_iterations
        yield Progress(current, iteration, finished=finished)
        if finished:
            return


def evaluated(nlp: NonlinearProgram, variables: Variables, before: Iterate | None = None) -> tuple[Iterate, float]:
    """Project, drive and judge.

    Args:
        nlp: What is searched for.
        variables: Wanted curvatures and lengths.
        before: The iterate from which they are a step, or None.

    Returns:
        The iterate, and how far it turned [rad] or stretched [m] at most.
    """
    settings = nlp.settings.loop
    variables, rollout = project_and_roll_out(nlp, variables)
    moved, reach = 0.0, settings.reach
    if before is not None:
        turned = float(np.abs(rollout.poses[:, 2] - before.rollout.poses[:, 2]).max())
        moved = max(turned, float(np.abs(variables.lengths - before.variables.lengths).max()))
        reach = min(settings.most_reach, settings.reach_per_motion * moved + settings.least_reach)
    return judged(nlp, variables, rollout, reach), moved


def judged(nlp: NonlinearProgram, variables: Variables, rollout: Rollout, reach: float) -> Iterate:
    """A driven path and how it does; pairs further apart than `reach` [m] beyond the requirement are left out."""
    settings, scene, basis = nlp.settings.loop, nlp.scene, nlp.basis
    body = body_at_nodes(scene, rollout.poses)
    pairs = broad_phase(scene, basis, rollout, body, reach + scene.rule.required)
    found = narrow_phase(scene, basis, rollout, nlp.ends.signs, body, pairs)
    count = nlp.settings.step.zones
    zones = np.zeros(count)
    if found.margin.size:
        # The end poses are given and were checked before: the cautious bound next to them is not a fault of the path.
        at_ends = (pairs.interval == 0) | (pairs.interval == basis.num_intervals - 1)
        short = np.where(at_ends, -settings.end_allowance, 0.0) - found.margin
        np.maximum.at(zones, zone_of(basis, basis.left[pairs.interval], count), short)
    view = None if nlp.view is None else view_along(nlp.view, basis, variables, rollout)
    if view is not None and view.margin.size:
        given = (view.node == 0) | (view.node == basis.num_nodes - 1)  # as above
        unseen = np.where(given, -settings.end_allowance, 0.0) - view.margin.min(axis=0)
        np.maximum.at(zones, zone_of(basis, view.node, count), unseen)
    error = nlp.ends.error(rollout)
    on_goal = float(np.abs(error).max()) <= settings.goal_tolerance
    feasible = on_goal and float(zones.max()) <= settings.clearance_tolerance
    cost = nlp.cost.value(variables, rollout)
    return Iterate(variables, rollout, cost, found, zones, error, on_goal, feasible, view)


def _linearized(nlp: NonlinearProgram, current: Iterate, state: _State) -> Subproblem:
    """The linearization at an iterate; its steps aim at a buffer of clearance."""
    basis, settings, rollout, found = nlp.basis, nlp.settings.step, current.rollout, current.clearance
    buffer = settings.buffer + state.overshoot(current)
    by = sensitivity(basis, current.variables, rollout)
    goal = end_sensitivity(basis, current.variables, rollout.moves), current.end_error
    share = float(current.variables.lengths.sum()) / basis.num_intervals
    motion = share * (by.x.T @ by.x + by.y.T @ by.y + settings.yaw_motion * (by.yaw.T @ by.yaw))
    most = settings.clearance_rows[-1]
    active = active_pairs(nlp.scene, found, basis.num_intervals, most // 3)
    rows = linearized_clearance(nlp.scene, basis, rollout, by, found, active)
    if nlp.view is not None and current.view is not None:
        seeing = linearized_view(nlp.view, basis, rollout, by, current.view, nlp.settings.view.reach)
        rows = ClearanceRows(*(np.concatenate(both) for both in zip(rows, seeing, strict=True)))
    rows = rows.lowest(most)
    # Less near the ends, where the pose cannot move.
    away = [np.hypot(*(rollout.poses[:, :2] - point[:2]).T) for point in (nlp.ends.start, nlp.ends.target)]
    wanted = buffer * np.minimum(1.0, np.minimum(away[0], away[1]) / settings.buffer_taper)
    rows = rows._replace(gap=rows.gap - wanted[rows.node])
    quadratic = nlp.cost.quadratic(current.variables, rollout, by)
    return Subproblem(current.variables, quadratic, motion, goal, by.yaw[trusted_nodes(basis, settings)], rows)


def _improved(nlp: NonlinearProgram, current: Iterate, step: QpStep | None, state: _State) -> Iterate | None:
    """The iterate after a step if its merit is lower; adapts trust region and proximal weight."""
    if step is None:
        state.reject(state.trust_region)
        return None
    knots, (curvature, lengths) = nlp.basis.num_knots, current.variables
    trial, moved = evaluated(nlp, Variables(curvature + step.change[:knots], lengths + step.change[knots:]), current)
    if trial.merit(state.penalties) < current.merit(state.penalties):
        state.accept()
        return trial
    state.reject(moved)
    return None


@dataclass
class _State:
    """What adapts during the search."""

    settings: LoopSettings
    trust_region: float
    proximal: float
    patience: int
    penalties: Penalties
    rejections: int = 0
    gain: float = math.inf
    shortfalls: list[float] = field(default_factory=list)
    found: bool = False

    @classmethod
    def at(cls, guess: SearchGuess, settings: LoopSettings) -> _State:
        """The state in which a search begins."""
        penalties = Penalties(settings.clearance_penalty, settings.goal_penalty)
        return cls(settings, guess.trust_region, guess.proximal, guess.patience, penalties)

    def overshoot(self, current: Iterate) -> float:
        """How much more clearance than the usual buffer to aim at [m], until a first feasible iterate is found.

        Where sides roll around a corner a step falls short by about as much as the one before it.
        """
        return current.shortfall if not self.found and current.shortfall < self.settings.overshot else 0.0

    def accept(self) -> None:
        """A step was good: dare more."""
        self.trust_region = min(self.settings.trust_growth * self.trust_region, self.settings.most_trust)
        self.proximal = max(self.settings.proximal_cut * self.proximal, self.settings.least_proximal)
        self.rejections = 0

    def reject(self, moved: float) -> None:
        """A step that moved by so much was bad: stay closer."""
        self.trust_region = self.settings.trust_cut * min(self.trust_region, max(moved, 1e-6))
        self.proximal *= self.settings.proximal_growth
        self.rejections += 1

    def has_settled(self, before: Iterate, after: Iterate) -> bool:
        """Whether a feasible iterate has stopped to improve, or will with the next step if gains shrink as they did."""
        gain = before.merit(self.penalties) - after.merit(self.penalties)
        previous, self.gain = self.gain, gain if before.feasible else math.inf
        expected = gain * min(1.0, gain / previous) if math.isfinite(previous) else gain
        small = self.settings.small_gain * after.cost
        return after.feasible and before.feasible and min(gain, 2.0 * expected) < small

    def is_hopeless(self, current: Iterate) -> bool:
        """Whether to give up: a feasible iterate that no step improves, or a shortfall that no longer shrinks.

        Where the shortfall costs less than the path itself, its weight is raised first.
        """
        settings, penalties = self.settings, self.penalties
        if current.feasible:
            return self.rejections > settings.max_rejections or self.trust_region < settings.small_step
        self.shortfalls.append(current.missing)
        recent = self.shortfalls[-self.patience :]
        if len(recent) < self.patience or recent[-1] < settings.shrinking * recent[0]:
            return False
        if penalties.clearance >= settings.most_penalty or penalties.clearance * current.missing > current.cost:
            return True
        clearance = settings.raised * penalties.clearance
        self.penalties = Penalties(clearance, max(penalties.goal, settings.goal_above_clearance * clearance))
        self.trust_region = max(self.trust_region, settings.raised_trust)
        self.proximal = min(self.proximal, settings.raised_proximal)
        self.rejections = 0
        self.shortfalls.clear()
        return False
