"""Failures."""

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
from optdock.model.dock import DockDirection
from optdock.model.path import Direction
from optdock.model.problem import ClearanceRule
from optdock.planning.refinement import ran_out_of_time
from optdock.verification import TOLERANCE, end_clearances

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.planning.plan import PartialPlan

__all__ = ["Failure", "Failures", "check_ends", "stage_of"]

# How far a guess came that ended in such an error: the further, the more its reason tells.
_STAGES: tuple[tuple[type[OptdockError], int], ...] = (
    (FailedToTimePath, 3),
    (CertificationFailed, 2),
    (SmootherException, 1),
    (PlannerException, 0),
)


def stage_of(error: OptdockError) -> int | None:
    """How far a guess came that ended in an error; None where that says nothing of the guess."""
    return next((stage for kind, stage in _STAGES if isinstance(error, kind)), None)


class Failure(NamedTuple):
    """A guess, or a planner, that came to nothing: why, what existed by then, and how far it came."""

    error: OptdockError
    left: PartialPlan
    stage: int


class Failures:
    """The guesses and planners of one call that came to nothing.

    Args:
        problem: That is planned.
        budget: Of the call [s].
    """

    def __init__(self, problem: DockingProblem, budget: float) -> None:
        self._problem, self._budget = problem, budget
        self._all: list[Failure] = []

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[Failure]:
        return iter(self._all)

    def add(self, failure: Failure) -> None:
        """Take in one more."""
        self._all.append(failure)

    def forget(self, raw_path: Path) -> None:
        """Forget that of a guess, which is tried once more."""
        self._all = [failure for failure in self._all if failure.left.raw_path is not raw_path]

    def furthest(self) -> Failure:
        """The failure that tells most: of the guess that came furthest, the earliest; time-outs tell least.

        Where no planner had a guess the last one, which searched, tells more than the first.
        """
        if not any(failure.stage for failure in self._all):
            return self._all[-1]
        return max(self._all, key=lambda failure: (failure.stage, not isinstance(failure.error, TimedOut)))

    def refusal(self, *, is_cut_off: bool, is_late: bool) -> OptdockError:
        """What is raised when nothing was found and nothing proven.

        That there was too little time wherever more of it might have found a plan; else the failure that tells most.

        Args:
            is_cut_off: By the clock, with guesses not made, or not tried, yet.
            is_late: Whether no time is left for another guess.
        """
        late = [failure for failure in self._all if isinstance(failure.error, TimedOut)]
        if not self._all:
            if is_cut_off or is_late:
                return PlannerTimedOut(ran_out_of_time("the search for a first guess", self._budget))
            return NoValidPathCouldBeFound("no planner offers a path")
        found = self.furthest()
        for_good = self._no_guess_can_help()
        if for_good is None and (late or is_cut_off):
            return self._time_out(late, found)
        error = (for_good or found).error
        if len(self._all) > 1:
            error.args = (f"{error} ({self._attempts})", *error.args[1:])
        return error

    def _time_out(self, late: list[Failure], found: Failure) -> TimedOut:
        """The time-out that came furthest, and what became of the guess that says most."""
        last = max(reversed(late), key=lambda failure: failure.stage, default=None)
        if last is not None:
            kind = next(kind for kind in (TimingTimedOut, SmootherTimedOut, TimedOut) if isinstance(last.error, kind))
            error = (PlannerTimedOut if kind is TimedOut else kind)(str(last.error), where=last.error.where)
            error.__cause__ = last.error
        else:
            kind = SmootherTimedOut if found.stage else PlannerTimedOut
            error = kind(ran_out_of_time("the search for other guesses", self._budget))
        if len(self._all) > 1 or last is None:
            error.args = (f"{error} ({self._attempts})",)
        if not isinstance(found.error, TimedOut):
            error.args = (f"{error}; until then {type(found.error).__name__}: {found.error}",)
        return error

    @property
    def _attempts(self) -> str:
        return f"{len(self._all)} attempts failed; that there is no way is not proven"

    def _no_guess_can_help(self) -> Failure | None:
        """A failure for a reason that every guess has, whichever and however much time there were; or None."""
        gears = {Direction.FORWARD, Direction.REVERSE}
        if self._problem.dock.direction is not DockDirection.AUTO:
            gears = {Direction.FORWARD if self._problem.dock.direction is DockDirection.FORWARD else Direction.REVERSE}
        for failure in self._all:
            reason, raw = failure.error.where.get("reason"), failure.left.raw_path
            if reason == "start_curvature":
                return failure
            if reason in ("approach_blocked", "approach_unseen") and raw is not None:
                gears.discard(raw.segments[-1].direction)
                if not gears:
                    return failure
        return None


def check_ends(problem: DockingProblem) -> None:
    """Refuse end poses that no path can have.

    Raises:
        StartOutsideMapBounds: Also GoalOutsideMapBounds: the position lies off the problem's costmap.
        StartOccupied: The footprint at the start overlaps an obstacle.
        GoalOccupied: The footprint at the goal is closer to an obstacle than required there.
        NoValidPathCouldBeFound: The dock must be in view up to the goal, and is not in view there.
    """
    _check_view_at_goal(problem)
    found = end_clearances(problem)
    for name, pose, off_map, occupied, clearance, row in (
        ("start", problem.start, StartOutsideMapBounds, StartOccupied, found.start, found.nearest_to_start),
        ("goal", problem.goal, GoalOutsideMapBounds, GoalOccupied, found.goal, found.nearest_to_goal),
    ):
        if problem.costmap is not None and not bool(problem.costmap.contains(pose.as_array()[None, :2])[0]):
            raise off_map(f"the {name} ({pose.x:.3f}, {pose.y:.3f}) lies off the map", where={"pose": [pose.x, pose.y]})
        required = problem.clearance.at_dock if name == "goal" else 0.0
        if clearance < required - TOLERANCE:
            obstacle = problem.all_obstacles.name_of(row)
            what = (
                f"overlaps {in_words(obstacle)} by {-clearance:.4f} m"
                if clearance < 0.0
                else f"is {clearance:.4f} m from {in_words(obstacle)}, required {required:.4f} m"
            )
            # The robot does not overlap its own station, and may touch it: then the number is what asks for too much.
            if obstacle == "dock" and name == "goal" and clearance >= 0.0:
                what += _way_out(problem.clearance)
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


def _way_out(rule: ClearanceRule) -> str:
    """How to write a clearance that lets the robot touch its station."""
    parts = {"required": rule.required, "at_dock": 0.0}
    if rule.taper != ClearanceRule().taper:
        parts["taper"] = rule.taper
    in_file = ", ".join(f"{key}: {value:g}" for key, value in parts.items())
    in_python = ", ".join(f"{key}={value!r}" for key, value in parts.items())
    return f"; clearance holds at the dock too; give {{{in_file}}} (in Python: ClearanceRule({in_python}))"
