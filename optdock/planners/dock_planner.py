"""`DockPlanner`: the plugin of the two-segment planner."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optdock.errors import InvalidValue, LifecycleError, NoValidPathCouldBeFound
from optdock.geometry.obstacles import in_words
from optdock.model.dock import DockDirection
from optdock.model.segments import PolylineSegment
from optdock.planners.two_segment import DockGeometry, DockPlannerParameters, TwoSegmentPlan, plan_two_segment
from optdock.plugins.interfaces import GlobalPlanner, LifecycleState, never_cancelled

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.obstacles import ObstacleSet
    from optdock.geometry.pose import Pose2
    from optdock.model.path import Path
    from optdock.plugins.parameters import PluginParameters

__all__ = ["DockPlanner", "DockPlannerParameters"]


class DockPlanner(GlobalPlanner):
    """Plan a two-segment NURBS path into a dock.

    The planner takes the robot's footprint and the costmap from its context, or from the problem of the context, so it
    must be configured before a call. If the parameters `footprint_dock` (null) and `direction` (auto) are not set,
    outline and direction of the dock in the context's problem are used. A dock without an outline has length 0.

    Args:
        **parameters: See `DockPlannerParameters`.

    Raises:
        InvalidValue: If a parameter is unknown, of the wrong type or out of range.
    """

    Parameters: ClassVar[type[PluginParameters]] = DockPlannerParameters
    parameters: DockPlannerParameters

    def on_configure(self) -> None:
        """Check the context.

        Raises:
            InvalidValue: If the context contains no robot footprint.
        """
        if self.context.footprint is None:
            raise InvalidValue(
                f"{self.context.name}: needs the robot's footprint; configure it with "
                "PluginContext(footprint=...) or PluginContext(problem=...)"
            )

    def create_plan(self, start: Pose2, goal: Pose2, cancel_checker: Callable[[], bool] = never_cancelled) -> Path:
        """Return the raw docking path: polylines, one per gear, in the frame of `start` and `goal`.

        The path starts exactly at `start` and ends exactly at `goal`. With `check_free_space` both must lie on free
        cells of the map, and the path must not cross an obstacle of the configured problem; the outline of the robot is
        checked by `plan_dock`.

        Raises:
            LifecycleError: If the planner is not configured. This error is not a PlannerException, because neither
                another goal nor a retry can resolve it.
            PlannerException: If `check_free_space` is set and there is no costmap.
            StartOutsideMapBounds: If `check_free_space` is set and the start is outside the map.
            StartOccupied: If `check_free_space` is set and the start is not free.
            GoalOutsideMapBounds: If `check_free_space` is set and the goal is outside the map.
            GoalOccupied: If `check_free_space` is set and the goal is not free.
            NoValidPathCouldBeFound: If a rule of the method is violated; the message names the step and the amount.
            PlannerCancelled: If `cancel_checker` returned True.
        """
        return self.plan(start, goal, cancel_checker).path

    def plan(self, start: Pose2, goal: Pose2, cancel_checker: Callable[[], bool] = never_cancelled) -> TwoSegmentPlan:
        """Return the path of `create_plan` together with the data of its construction.

        Raises:
            LifecycleError: As `create_plan`.
            PlannerException: As `create_plan`, including all subclasses of this error.
        """
        robot = self.context.footprint
        if self.state not in (LifecycleState.INACTIVE, LifecycleState.ACTIVE) or robot is None:
            raise LifecycleError(
                f"{self.context.name}: cannot plan when {self.state.value}; call configure(PluginContext(...)) first"
            )
        outline, problem, costmap = self.parameters.dock_outline, self.context.problem, self.context.costmap
        if problem is None:
            direction, frame = DockDirection.AUTO, ""
        else:
            outline = problem.dock.footprint if outline is None else outline
            direction, frame = problem.dock.direction, problem.frame
        geometry = DockGeometry.from_footprints(robot, outline, direction)
        plan = plan_two_segment(start, goal, geometry, self.parameters, costmap, cancel_checker, frame=frame)
        self.context.logger.debug("%s: dir %d, %r", self.context.name, plan.joint.dir, plan.path)
        if problem is not None and self.parameters.check_free_space:
            _check_free(plan.path, (self.context.problem_at_hand(None) or problem).all_obstacles)
        return plan


def _check_free(path: Path, obstacles: ObstacleSet) -> None:
    """Check that no obstacle lies on the path of the robot's origin, as the curve sampler checks the costmap."""
    points = np.concatenate([segment.poses[:, :2] for segment in path.segments if isinstance(segment, PolylineSegment)])
    rows = obstacles.rows_at(points)
    blocked = np.flatnonzero(rows >= 0)
    if blocked.size:
        x, y = (float(value) for value in points[blocked[0]])
        name = obstacles.name_of(int(rows[blocked[0]]))
        raise NoValidPathCouldBeFound(
            f"dock planner: the path is blocked at ({x:.3f}, {y:.3f}) by {in_words(name)}",
            where={"x": x, "y": y, "obstacle": name},
        )
