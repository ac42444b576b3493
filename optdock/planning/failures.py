"""Errors of `plan_dock`: impossible end poses, and the failure that is reported if no guess leads to a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import (
    CertificationFailed,
    FailedToTimePath,
    GoalOccupied,
    GoalOutsideMapBounds,
    NoValidPathCouldBeFound,
    OptdockError,
    PlannerException,
    PlannerTimedOut,
    SmootherException,
    SmootherTimedOut,
    StartOccupied,
    StartOutsideMapBounds,
    TimedOut,
    TimingTimedOut,
)
from optdock.geometry.obstacles import in_words
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import DockDirection
from optdock.model.path import Direction
from optdock.planning.refinement import ran_out_of_time
from optdock.verification import TOLERANCE, end_clearances

if TYPE_CHECKING:
    from collections.abc import Sequence

    from optdock.model.problem import DockingProblem
    from optdock.planning.plan import PartialPlan
    from optdock.planning.refinement import Refinement

__all__ = ["Failure", "check_ends", "furthest", "refusal", "stage_of"]

# Stage at which a guess failed, by its error: the later the stage, the more informative the error.
_STAGES: tuple[tuple[type[OptdockError], int], ...] = (
    (FailedToTimePath, 3),
    (CertificationFailed, 2),
    (SmootherException, 1),
    (PlannerException, 0),
)


def stage_of(error: OptdockError) -> int | None:
    """Return the stage at which a guess failed with an error; None if the error does not concern the guess."""
    return next((stage for kind, stage in _STAGES if isinstance(error, kind)), None)


class Failure(NamedTuple):
    """Error of a guess or a planner, with the partial plan that existed when the error occurred."""

    error: OptdockError
    left: PartialPlan

    @property
    def stage(self) -> int:
        """Stage of the failure, see `stage_of`."""
        return stage_of(self.error) or 0


def furthest(failures: Sequence[Failure]) -> Failure:
    """Return the most informative failure: the first failure at the latest stage, preferably not a time-out.

    If no planner returned a guess, the failure of the last planner is returned, because that planner performs a search.
    """
    if not any(failure.stage for failure in failures):
        return failures[-1]
    return max(failures, key=lambda failure: (failure.stage, not isinstance(failure.error, TimedOut)))


def refusal(failures: Sequence[Failure], work: Refinement, *, is_cut_off: bool) -> OptdockError:
    """Return the error of a call that found no plan and no proof.

    The error is a time-out if more time might have given a plan, otherwise the most informative failure. `is_cut_off`:
    whether the time limit ended the call before all guesses were made or tried.
    """
    is_late = work.is_late()
    if not failures:
        if is_cut_off or is_late:
            return PlannerTimedOut(ran_out_of_time("the search for a first guess", work.budget))
        return NoValidPathCouldBeFound("no planner returned a path")
    found, late = furthest(failures), [failure for failure in failures if isinstance(failure.error, TimedOut)]
    for_good = _reason_of_every_guess(failures, work.problem)
    attempts = f"{len(failures)} attempts failed; it is not proven that no motion exists"
    if for_good is not None or not (late or is_cut_off):
        error = (for_good or found).error
        if len(failures) > 1:
            error.args = (f"{error} ({attempts})", *error.args[1:])
        return error
    last = max(reversed(late), key=lambda failure: failure.stage, default=None)
    if last is not None:
        kind = next(kind for kind in (TimingTimedOut, SmootherTimedOut, TimedOut) if isinstance(last.error, kind))
        error = (PlannerTimedOut if kind is TimedOut else kind)(str(last.error), where=last.error.where)
        error.__cause__ = last.error
    else:
        kind = SmootherTimedOut if found.stage else PlannerTimedOut
        error = kind(ran_out_of_time("the search for other guesses", work.budget))
    if len(failures) > 1 or last is None:
        error.args = (f"{error} ({attempts})",)
    if not isinstance(found.error, TimedOut):
        error.args = (f"{error}; best attempt: {type(found.error).__name__}: {found.error}",)
    return error


def _reason_of_every_guess(failures: Sequence[Failure], problem: DockingProblem) -> Failure | None:
    """Return a failure that, with those before it, excludes both gears in which a path can end, or None."""
    gears = {Direction.FORWARD, Direction.REVERSE}
    if problem.dock.direction is not DockDirection.AUTO:
        gears = {Direction.FORWARD if problem.dock.direction is DockDirection.FORWARD else Direction.REVERSE}
    for failure in failures:
        reason, raw = failure.error.where.get("reason"), failure.left.raw_path
        if reason in ("approach_blocked", "approach_unseen") and raw is not None:
            gears.discard(raw.segments[-1].direction)
            if not gears:
                return failure
    return None


def check_ends(problem: DockingProblem) -> None:
    """Raise an error for a start or goal pose that no path can have.

    Raises:
        StartOutsideMapBounds: If the start is outside the problem's costmap.
        GoalOutsideMapBounds: If the goal is outside the problem's costmap.
        StartOccupied: If the footprint at the start overlaps an obstacle.
        GoalOccupied: If the footprint at the goal is closer to an obstacle than the rule allows.
        NoValidPathCouldBeFound: If the dock must be in view until the goal is reached, but is not in view at the goal.
    """
    _check_view_at_goal(problem)
    found = end_clearances(problem)
    for name, pose, off_map, occupied, clearance, row in (
        ("start", problem.start, StartOutsideMapBounds, StartOccupied, found.start, found.nearest_to_start),
        ("goal", problem.goal, GoalOutsideMapBounds, GoalOccupied, found.goal, found.nearest_to_goal),
    ):
        if problem.costmap is not None and not bool(problem.costmap.contains(pose.as_array()[None, :2])[0]):
            raise off_map(
                f"the {name} ({pose.x:.3f}, {pose.y:.3f}) is outside the map", where={"pose": [pose.x, pose.y]}
            )
        required = problem.clearance.at_dock if name == "goal" else 0.0
        if clearance < required - TOLERANCE:
            obstacle = problem.all_obstacles.name_of(row)
            what = (
                f"overlaps {in_words(obstacle)} by {-clearance:.4f} m"
                if clearance < 0.0
                else f"is {clearance:.4f} m from {in_words(obstacle)}, required {required:.4f} m"
            )
            # The robot may touch its own station: the required clearance there is what must be changed.
            if obstacle == "dock" and name == "goal" and clearance >= 0.0:
                what += _clearance_hint(problem.clearance)
            raise occupied(f"the footprint at the {name} {what}", where={"obstacle": obstacle, "clearance": clearance})


def _check_view_at_goal(problem: DockingProblem) -> None:
    view, goal = problem.required_view, problem.goal.as_array()[None]
    if view is None or view.blind_distance > 0.0:
        return
    margins = view.margins(goal)
    if margins.smallest[0] < -TOLERANCE:
        worst = view.worst(margins, 0, 0.0)
        where = {"reason": "approach_unseen", "quantity": worst.name, "value": worst.value, "limit": worst.limit}
        message = f"the dock is not in the camera's view at the goal: {worst}; see dock.blind_distance"
        raise NoValidPathCouldBeFound(message, where=where)


def _clearance_hint(rule: ClearanceRule) -> str:
    """Return a hint for a clearance rule that lets the robot touch its station."""
    parts = {"required": rule.required, "at_dock": 0.0}
    if rule.taper != ClearanceRule().taper:
        parts["taper"] = rule.taper
    in_file = ", ".join(f"{key}: {value:g}" for key, value in parts.items())
    in_python = ", ".join(f"{key}={value!r}" for key, value in parts.items())
    reduced = f"{{{in_file}}} (in Python: ClearanceRule({in_python}))"
    return f"; the clearance also holds at the dock; to reduce it there set {reduced}"
