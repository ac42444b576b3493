"""End poses that no path can have."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.errors import (
    GoalOccupied,
    GoalOutsideMapBounds,
    NoValidPathCouldBeFound,
    StartOccupied,
    StartOutsideMapBounds,
)
from optdock.geometry.obstacles import in_words
from optdock.model.problem import ClearanceRule
from optdock.verification import TOLERANCE, end_clearances

if TYPE_CHECKING:
    from optdock.model.problem import DockingProblem

__all__ = ["check_ends"]


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
