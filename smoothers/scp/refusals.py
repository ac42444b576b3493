"""Refusals: constraints that no path can satisfy, and the constraint that a failed search violates."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.errors import FailedToSmoothPath
from optdock.geometry.arrays import readonly
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import Pose2, wrap_angles
from optdock.model.dock import DockDirection
from optdock.model.path import ClothoidSegment, Direction, Path, PolylineSegment, TurnSegment
from optdock.planning.plan import PartialPlan
from optdock.verification import compiled_clearances, end_clearances
from optdock.verification.visibility import prove_view
from smoothers.scp.goal_projection import driven_path, exact_path
from smoothers.scp.term_samples import SPACING, sampled_terms
from smoothers.terms import SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.model.problem import DockingProblem
    from optdock.plugins.outcomes import SampledBound
    from optdock.verification import Certificate, Violation
    from smoothers.scp.loop import Iterate
    from smoothers.scp.nlp import NonlinearProgram
    from smoothers.scp.term_functions import TermSet
    from smoothers.terms import HardTerm

__all__ = [
    "Refusal",
    "refuse_approach",
    "refuse_certificate",
    "refuse_search",
    "refuse_start",
    "refuse_term",
    "refuse_terms_at_ends",
    "refuse_turns",
    "refuse_unseen_approach",
]

_TOLERANCE = 1e-6  # [m], as the certificate's
_BEFORE_GOAL = readonly(np.linspace(1.0, 0.0, 13))  # checked poses of the final straight, as shares of its length
# A search is local: a failure near one input proves nothing for other inputs.
_NEAR_THIS_GUESS = "refused near this guess:"
_SPACING = 0.02  # [m] between measured poses of a refused path, 0.7 ms for 5 m; 3 cm missed 6 mm of overlap
# If no measured pose violates the rule: the poses with the smallest margins, and how many are measured around each of
# them, 1 mm apart. A corner that swings past an obstacle may be 3 mm closer between two poses.
_CLOSEST, _BETWEEN = 8, 41
_GOAL_ALONE = 1e-4  # [m]: length of the straight that represents the goal pose


class Refusal(NamedTuple):
    """A violated constraint, with its position and the reason for the error."""

    reason: str  # name of the constraint
    s: float  # arc length [m]
    amount: float  # violation, in the unit of the constraint
    obstacle: str  # name of the obstacle, or empty
    message: str  # sentence with the numbers
    pose: FloatArray | None = None  # pose of the violation, Shape (3,), or None
    more: Mapping[str, object] = MappingProxyType({})  # further entries of `where`
    path: Path | None = None  # best path found, which violates the constraint; None before a search

    def error(self) -> FailedToSmoothPath:
        """Return the exception, with the best path found as the `path` of its `partial`."""
        where = {"reason": self.reason, "s": self.s, "amount": self.amount, "obstacle": self.obstacle, **self.more}
        if self.pose is not None:
            where["pose"] = self.pose.tolist()
        error = FailedToSmoothPath(f"{self.reason}: {self.message}", where=where)
        if self.path is not None:
            error.partial = PartialPlan(path=self.path)
        return error


def refuse_start(path: Path, problem: DockingProblem, start_clearance: float, nearest: int) -> Refusal | None:
    """Return the refusal of a start, or of gears, for which no path exists, or None."""
    if start_clearance < -_TOLERANCE:
        name = problem.all_obstacles.name_of(nearest)
        message = f"the footprint overlaps {in_words(name)} by {-start_clearance:.3f} m at the start"
        return Refusal("start_in_collision", 0.0, -start_clearance, name, message)
    limit, steered = problem.robot.limits.max_curvature, problem.start_curvature
    if steered is not None and abs(steered) > limit * (1.0 + _TOLERANCE) + _TOLERANCE:  # as the certificate's rules
        message = f"the curvature at the start is {steered:.4g} 1/m, the limit is {limit:.4g} 1/m"
        more = {"every_path": not problem.may_turn_first}
        return Refusal("start_curvature", 0.0, abs(steered) - limit, "", message, more=more)
    first, last = path.segments[0].direction, path.segments[-1].direction
    wanted = {DockDirection.FORWARD: Direction.FORWARD, DockDirection.BACKWARD: Direction.REVERSE}
    if wanted.get(problem.dock.direction, last) is not last:
        asked = problem.dock.direction.value
        message = f"the raw path enters the dock in {last.name.lower()} gear, the dock requires {asked}"
        return Refusal("direction", path.length, 1.0, "", message)
    if problem.start_speed * first < 0.0:
        message = f"the robot moves at {problem.start_speed:.3g} m/s, the raw path begins in {first.name.lower()} gear"
        return Refusal("direction", 0.0, abs(problem.start_speed), "", message)
    return None


def refuse_approach(path: Path, problem: DockingProblem, start_clearance: float) -> Refusal | None:
    """Return the refusal if the final straight or the goal, which every path contains, lacks clearance, or None."""
    goal, straight = problem.goal, problem.dock.final_straight
    back = float(path.segments[-1].direction) * straight * (_BEFORE_GOAL if straight > 0.0 else _BEFORE_GOAL[-1:])
    poses = np.empty((back.size, 3))
    poses[:, 0], poses[:, 1] = goal.x - back * math.cos(goal.yaw), goal.y - back * math.sin(goal.yaw)
    poses[:, 2] = goal.yaw
    rule, robot, obstacles = problem.path_clearance, problem.robot, problem.all_obstacles
    required = rule.near_goal(np.abs(back))
    distance, rows = compiled_clearances(poses, robot.footprint, obstacles, float(np.maximum.reduce(required)))
    if not np.maximum.reduce(required - distance) > _TOLERANCE:
        return None
    # Near a start that is too close, less is required.
    from_start = np.hypot(poses[:, 0] - problem.start.x, poses[:, 1] - problem.start.y)
    required = np.minimum(required, rule.near_start(from_start, start_clearance, problem.start_run))
    short = required - distance
    k = int(short.argmax())
    if not short[k] > _TOLERANCE:
        return None
    name = obstacles.name_of(int(rows[k]))
    s = path.length - abs(float(back[k]))
    what = "at the goal" if back[k] == 0.0 else f"on the final straight, {abs(back[k]):.3f} m before the goal,"
    met = in_words(name)
    does = f"overlaps {met} by {-distance[k]:.4f} m" if distance[k] < 0.0 else f"is {distance[k]:.4f} m from {met}"
    message = f"{what} the footprint {does}, required {required[k]:.4f} m"
    return Refusal("approach_blocked", s, float(short[k]), name, message, poses[k])


def refuse_unseen_approach(path: Path, problem: DockingProblem) -> Refusal | None:
    """Return the refusal if the final straight or the goal, which every path contains, lacks the required view."""
    if problem.required_view is None or not isinstance(path.segments[-1], ClothoidSegment | PolylineSegment):
        return None
    # Without a final straight, a negligible stretch represents the goal alone.
    goal, length = problem.goal, max(problem.dock.final_straight, _GOAL_ALONE)
    sign = int(path.segments[-1].direction)
    begin = goal @ Pose2(-sign * length, 0.0, 0.0)
    line = Path((ClothoidSegment(ClothoidSpline(begin, np.array([0.0, length]), np.zeros(2), sign)),), path.frame)
    broken = next((one for one in prove_view(line, problem).violations if one.kind == "view"), None)
    if broken is None:
        return None
    before, straight = length - broken.s, problem.dock.final_straight
    place = "at the goal" if before <= _GOAL_ALONE else f"on the final straight, {before:.3f} m before the goal"
    refusal = _unseen(broken, path.length - before, None)
    message = f"{place}: {broken.message.partition(': ')[2]} (every path ends there; see dock.blind_distance)"
    message = f"the dock is not in the camera's view {message}"
    is_certain = before == 0.0 or (straight > 0.0 and problem.dock.direction is not DockDirection.AUTO)
    more = {**refusal.more, "every_path": is_certain}
    return refusal._replace(reason="approach_unseen", message=message, more=more)


def _unseen(broken: Violation, s: float, path: Path | None) -> Refusal:
    """Return the refusal of a pose without the required view, at arc length `s` [m]."""
    more = dict(broken.where)
    pose = np.array(more.pop("pose"))
    return Refusal("view", s, broken.amount, "", broken.message, pose, more, path)


def refuse_turns(path: Path, problem: DockingProblem) -> Refusal | None:
    """Return the refusal of turns in place, whose positions are fixed, or None.

    Turns are refused if the robot cannot turn in place, if the robot moves at the start or a final straight is required
    at a turn, or if an obstacle is too close.
    """
    first, last = path.segments[0], path.segments[-1]
    for segment, s in zip(path.segments, path.segment_starts[:-1].tolist(), strict=True):
        if not isinstance(segment, TurnSegment):
            continue
        message = f"the raw path turns in place by {segment.turn:.4g} rad at s = {s:.3f} m, "
        if not problem.robot.turns_in_place:
            message += "the robot cannot turn in place (turns_in_place)"
        elif segment is first and problem.start_speed != 0.0:
            message += f"the robot moves at {problem.start_speed:.3g} m/s there"
        elif segment is last and problem.dock.final_straight > 0.0:
            message += f"the dock requires a final straight of {problem.dock.final_straight:.3g} m"
        else:
            continue
        return Refusal("turn", s, abs(segment.turn), "", message, segment.pose.as_array())
    return _blocked_turn(path, problem)


def _blocked_turn(path: Path, problem: DockingProblem) -> Refusal | None:
    """Return the refusal of the first turn too close to an obstacle, except at ends that differ from the problem."""
    begins = path.start.gap_to(problem.start) <= _TOLERANCE
    ends = path.end.gap_to(problem.goal) <= _TOLERANCE
    last = len(path.segments) - 1
    for i, (segment, s) in enumerate(zip(path.segments, path.segment_starts[:-1].tolist(), strict=True)):
        if isinstance(segment, TurnSegment) and (begins or i > 0) and (ends or i < last):
            found = _too_close(Path((segment,), path.frame), problem, 0.0, problem.start_run)
            if found.amount > _TOLERANCE:
                return found._replace(s=s + found.s, path=None)
    return None


def refuse_search(
    nlp: NonlinearProgram, closest: Iterate, problem: DockingProblem, whole: DockingProblem | None = None
) -> Refusal:
    """Return the refusal for the constraint that a failed search violates: goal, clearance, view or a hard term.

    The search may still succeed from other inputs.

    Args:
        nlp: Program of the search.
        closest: Iterate with the smallest violation, whose path is reported.
        problem: Problem of the path, or of a piece of it.
        whole: Problem of the whole path, whose clearance rule applies; None means `problem`.
    """
    is_clear = closest.clearance.margin.size == 0
    if not closest.on_goal or (is_clear and nlp.view is None and nlp.terms is None):
        return _unreachable(nlp, closest, problem)
    path = exact_path(nlp, closest.variables, problem.dock.final_straight, problem.frame)
    judged = problem if whole is None else whole
    unseen = _lost_view(path, judged) if problem.goal == judged.goal else None
    other = unseen or _broken_term(nlp, path, problem.dock.final_straight)
    if is_clear:
        return other or _unreachable(nlp, closest, problem)
    too_close = _too_close(path, judged, closest.shortfall, nlp.scene.start_relief)
    return other if other is not None and too_close.amount <= _TOLERANCE else too_close


def _broken_term(nlp: NonlinearProgram, path: Path, straight: float) -> Refusal | None:
    """Return the refusal of the first hard term that the best path found violates, or None."""
    bound = nlp.terms
    if bound is None:
        return None
    sampled = sampled_terms(bound.terms, path, bound.before, bound.after - straight)
    broken = next((one for one in sampled if not one.holds), None)
    if broken is None:
        return None
    found = refuse_term(broken, path)
    return found._replace(message=f"{_NEAR_THIS_GUESS} on the best path found {found.message}")


def refuse_term(broken: SampledBound, path: Path) -> Refusal:
    """Return the refusal for a hard term that is negative at a sample of `path`."""
    at, more = path.poses_at(broken.s)[0], {"term": broken.name}
    return Refusal("term", broken.s, -broken.least, "", broken.violation, at, more, path)


def refuse_terms_at_ends(
    path: Path, problem: DockingProblem, terms: TermSet, after: float | None, *, is_whole: bool
) -> Refusal | None:
    """Return the refusal of a hard term at the start or on the final straight, which every path contains, or None.

    Terms that read a symbol whose value is not the same on all paths are not evaluated. If the refusal holds for other
    gears as well, `every_path` in its `where` is True.

    Args:
        path: Input, whose gears all paths have.
        problem: Start and goal.
        terms: Terms.
        after: Distance left to drive from the goal of the problem [m]; None: only the start is checked.
        is_whole: Whether the path is not a piece of a longer path, which may contain other pieces.
    """
    if not terms.hard:
        return None
    start, goal, straight = problem.start, problem.goal, problem.dock.final_straight
    first, last, fixed = int(path.segments[0].direction), int(path.segments[-1].direction), {"x", "y", "yaw", "gear"}
    steps = 0 if after is None else max(1, math.ceil(straight / SPACING))
    back, points = straight / max(1, steps) * np.arange(1 + steps), np.empty((2 + steps, len(SYMBOLS)))  # goal first
    points[0] = start.x, start.y, start.yaw, problem.start_curvature or 0.0, 0.0, 0.0, first
    away = -last * math.cos(goal.yaw), -last * math.sin(goal.yaw), 0.0, 0.0, 0.0, 1.0, 0.0
    points[1:] = back[:, None] * away + (goal.x, goal.y, goal.yaw, 0.0, 0.0, after or 0.0, last)
    points[:, 2] = wrap_angles(points[:, 2])
    values = terms.only_hard.values(points)
    known = fixed if problem.start_curvature is None else {*fixed, "curvature"}
    broken = _lowest(terms, values[:1], known)
    if broken is not None:
        depends = {"gear", "curvature"} if problem.may_turn_first else {"gear"}
        is_certain = is_whole and depends.isdisjoint(broken[3].function.reads)
        message, more = f"{broken[1]} at the start", {"term": broken[3].name, "every_path": is_certain}
        message += f", where every path {'' if is_certain else 'in these gears '}begins"
        return Refusal("term", 0.0, broken[2], "", message, points[0, :3], more)
    if after is None:
        return None
    broken = _lowest(terms, values[1:], {*fixed, "remaining", *(["curvature"] if straight > 0.0 else [])})
    if broken is None:
        return None
    row = broken[0]
    place = "at the goal" if back[row] == 0.0 else f"on the final straight, {back[row]:.3f} m before the goal"
    in_all_gears = back[row] == 0.0 or problem.dock.direction is not DockDirection.AUTO
    is_certain = is_whole and in_all_gears and "gear" not in broken[3].function.reads
    message, more = f"{broken[1]} {place}", {"term": broken[3].name, "every_path": is_certain}
    message += f", where every path {'' if is_certain else 'in these gears '}ends"
    return Refusal("term", path.length - float(back[row]), broken[2], "", message, points[1 + row, :3], more)


def _lowest(terms: TermSet, values: FloatArray, known: set[str]) -> tuple[int, str, float, HardTerm] | None:
    """Return the row, a sentence, the amount and the first violated hard term that reads only `known`."""
    for k, term in enumerate(terms.hard):
        if not term.function.reads <= known:
            continue
        row = values[:, k].argmin().item()  # of the first that is not a number, if any is
        value = -math.inf if math.isnan(values.item(row, k)) else values.item(row, k)
        if value < -_TOLERANCE:
            return row, f"the term {term.name!r} is {value:.4g}, must be >= 0,", -value, term
    return None


def _lost_view(path: Path, problem: DockingProblem) -> Refusal | None:
    """Return the refusal at the position where the best path found loses the view of the dock, or None."""
    broken = next((one for one in prove_view(path, problem).violations if one.kind == "view"), None)
    if broken is None:
        return None
    found = _unseen(broken, broken.s, path)
    return found._replace(message=f"{_NEAR_THIS_GUESS} on the best path found {broken.message}")


def refuse_certificate(certificate: Certificate, path: Path) -> Refusal:
    """Return the refusal for the first violation in the certificate of `path`."""
    broken = certificate.violations[0]
    more = dict(broken.where)
    obstacle, pose = str(more.pop("obstacle", "")), more.pop("pose", None)
    at = path.poses_at(min(broken.s, path.length))[0] if pose is None else np.array(pose)
    return Refusal(broken.kind, broken.s, broken.amount, obstacle, broken.message, at, more, path)


def _too_close(path: Path, problem: DockingProblem, bound: float, start_relief: float = 0.0) -> Refusal:
    """Return the refusal at the pose with the smallest margin of clearance, measured by the certificate's distances.

    All poses may satisfy the rule although the lower bounds of the search are violated.
    """
    s = np.linspace(0.0, path.length, max(2, math.ceil(path.length / _SPACING) + 1))
    poses, clearance, required, rows = _measured(path, problem, s, start_relief)
    if np.all(required - clearance <= _TOLERANCE):
        nearest = np.argsort(clearance - required, kind="stable")[:_CLOSEST]
        between = np.clip(s[nearest, None] + np.linspace(-_SPACING, _SPACING, _BETWEEN), 0.0, path.length)
        s = np.unique(between)
        poses, clearance, required, rows = _measured(path, problem, s, start_relief)
    k = int(np.argmax(required - clearance))
    short, row = float(required[k] - clearance[k]), int(rows[k])
    name = problem.all_obstacles.name_of(row) if row >= 0 else ""
    more: dict[str, object] = {"clearance": float(clearance[k]), "required": float(required[k])}
    if short > _TOLERANCE:
        message = (
            f"{_NEAR_THIS_GUESS} the best path found comes {short:.4f} m closer to {in_words(name)} than required at "
            f"s = {s[k]:.3f} m"
        )
    else:
        more["bound"] = bound
        message = (
            f"{_NEAR_THIS_GUESS} every pose measured on the best path found keeps the required clearance, but between "
            f"them it is not proven: the bound of the search is {bound:.4f} m short"
        )
    return Refusal("clearance", float(s[k]), short, name, message, poses[k], more, path)


def _unreachable(nlp: NonlinearProgram, closest: Iterate, problem: DockingProblem) -> Refusal:
    straight, variables = problem.dock.final_straight, closest.variables
    path = driven_path(nlp, variables).with_frame(problem.frame)
    missed, turned = float(np.hypot(*closest.end_error[:2])), abs(float(closest.end_error[2]))
    bound = float(nlp.bounds.upper[: nlp.basis.num_knots].max())
    used = float(np.abs(variables.curvature).max()) / bound
    steered = float(np.abs(closest.rollout.rate).max()) / nlp.bounds.rate
    tight = [name for name, share in (("curvature", used), ("curvature rate", steered)) if share > 0.97]
    tight += ["clearance"] if closest.clearance.margin.size and closest.clearance.margin.min() < 2e-3 else []
    target = f"the final straight, {straight:.3f} m before the goal," if straight > 0.0 else "the goal"
    message = f"{_NEAR_THIS_GUESS} the best path found in the gears of the raw path misses {target} by"
    message += f" {missed:.3f} m and {turned:.3f} rad"
    message += f"; at the limit: {', '.join(tight)}" if tight else ""
    at = path.poses_at(path.length)[0]
    return Refusal("goal_unreachable", path.length, missed, "", message, at, path=path)


def _measured(
    path: Path, problem: DockingProblem, s: FloatArray, start_relief: float
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Return poses at `s`, their clearances up to one spacing above the required ones, these, and nearest obstacles."""
    poses, at_start = path.poses_at(s), end_clearances(problem).start
    required = problem.path_clearance.required_for(poses, problem.goal, problem.start, at_start, start_relief)
    within = float(required.max()) + _SPACING
    clearance, rows = compiled_clearances(poses, problem.robot.footprint, problem.all_obstacles, within)
    return poses, clearance, required, rows
