"""End poses that no path can have, refused before anything is planned."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.errors import GoalOccupied, GoalOutsideMapBounds, StartOccupied, StartOutsideMapBounds
from optdock.verification import TOLERANCE, end_clearances

if TYPE_CHECKING:
    from optdock.problem import DockingProblem

__all__ = ["check_ends"]


def check_ends(problem: DockingProblem) -> None:
    """Refuse end poses that no path can have.

    Raises:
        StartOutsideMapBounds: Also GoalOutsideMapBounds: the position lies off the problem's costmap.
        StartOccupied: The footprint at the start overlaps an obstacle.
        GoalOccupied: The footprint at the goal is closer to an obstacle than required there.
    """
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
                f"overlaps {obstacle} by {-clearance:.4f} m"
                if clearance < 0.0
                else (f"is {clearance:.4f} m from {obstacle}, required {required:.4f} m")
            )
            raise occupied(f"the footprint at the {name} {what}", where={"obstacle": obstacle, "clearance": clearance})
