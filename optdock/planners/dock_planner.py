"""The dock planner as a plugin."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optdock.errors import InvalidValue, LifecycleError, NoValidPathCouldBeFound
from optdock.geometry.obstacles import in_words
from optdock.model.dock import DockDirection
from optdock.planners.two_segment import DockGeometry, DockPlannerParameters, TwoSegmentPlan, plan_two_segment
from optdock.plugins.interfaces import GlobalPlanner, LifecycleState, PluginContext, never_cancelled

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.geometry.pose import Pose2
    from optdock.model.path import Path
    from optdock.plugins.parameters import PluginParameters

__all__ = ["DockPlanner", "DockPlannerParameters"]


class DockPlanner(GlobalPlanner):
    """Plans a two-segment NURBS path into a dock.

    It needs the robot's footprint, so it must be configured before it plans: the footprint and the costmap come from
    the context, or from the context's problem. What the parameters `footprint_dock` (null) and `direction` (auto)
    leave open is taken from the dock of the context's problem, where there is one. A dock without an outline counts
    as one of length 0.

    Args:
        **parameters: See `DockPlannerParameters`.

    Raises:
        InvalidValue: A parameter is unknown, of the wrong type or out of range.
    """

    Parameters: ClassVar[type[PluginParameters]] = DockPlannerParameters
    parameters: DockPlannerParameters

    def configure(self, context: PluginContext) -> None:
        """Link the planner to its surroundings; doing so again with the same ones is a no-op that succeeds.

        Raises:
            LifecycleError: It is configured with other surroundings (clean up first), or finalized.
            InvalidValue: The context holds no robot footprint.
        """
        if self.state in (LifecycleState.INACTIVE, LifecycleState.ACTIVE) and _same(self.context, context):
            return
        super().configure(context)

    def on_configure(self) -> None:
        """Check the surroundings, and load SciPy's splines now: that takes longer than a hundred plans.

        Raises:
            InvalidValue: The context holds no robot footprint.
        """
        import scipy.interpolate  # noqa: F401 - loaded for its side effect on the first plan's duration

        if self.context.footprint is None:
            raise InvalidValue(
                f"{self.context.name}: needs the robot's footprint; configure it with "
                "PluginContext(footprint=...) or PluginContext(problem=...)"
            )

    def create_plan(self, start: Pose2, goal: Pose2, cancel_checker: Callable[[], bool] = never_cancelled) -> Path:
        """The raw docking path: polylines, one per gear, in the frame of `start` and `goal`.

        The path names that frame where a problem is configured, which says so.

        It starts exactly at `start` and ends exactly at `goal`. With `check_free_space` both must lie on free cells of
        the map, and no obstacle of the configured problem under the path; whether the whole robot fits there is asked
        by `plan_dock`, not here.

        Raises:
            LifecycleError: The planner is not configured. That is the caller's mistake: no other goal, retry or
                recovery can help, so it is not a PlannerException.
            PlannerException: `check_free_space` is on, and there is no costmap to check.
            StartOutsideMapBounds: Also StartOccupied, GoalOutsideMapBounds, GoalOccupied: `check_free_space` is on, and
                an end is not free.
            NoValidPathCouldBeFound: A rule of the method is broken; the message says in which step and by how much.
            PlannerCancelled: `cancel_checker` returned True.
        """
        plan = self.plan(start, goal, cancel_checker)
        self.context.logger.debug(
            "%s: dir %d, %s, %.3f m", self.context.name, plan.dir, plan.direction.name, plan.path.length
        )
        return plan.path

    def plan(self, start: Pose2, goal: Pose2, cancel_checker: Callable[[], bool] = never_cancelled) -> TwoSegmentPlan:
        """As `create_plan`, with everything that led to the path.

        Raises:
            LifecycleError: As `create_plan`.
            PlannerException: As `create_plan`, and all its children.
        """
        robot = self.context.footprint
        if self.state not in (LifecycleState.INACTIVE, LifecycleState.ACTIVE) or robot is None:
            raise LifecycleError(
                f"{self.context.name}: cannot plan when {self.state.value}; call configure(PluginContext(...)) first"
            )
        geometry = DockGeometry.from_footprints(robot, self._dock_footprint())
        plan = plan_two_segment(start, goal, geometry, self._effective(), self.context.costmap, cancel_checker)
        problem = self.context.problem
        if problem is None:
            return plan
        if self.parameters.check_free_space:
            _check_free(plan.path, (self.context.problem_at_hand(None) or problem).all_obstacles)
        return dataclasses.replace(plan, path=plan.path.with_frame(problem.frame))

    def _dock_footprint(self) -> Footprint | None:
        given = self.parameters.dock_outline
        if given is not None or self.context.problem is None:
            return given
        return self.context.problem.dock.footprint

    def _effective(self) -> DockPlannerParameters:
        problem = self.context.problem
        if problem is None or self.parameters.direction is not DockDirection.AUTO:
            return self.parameters
        return self.parameters.model_copy(update={"direction": problem.dock.direction})


def _check_free(path: Path, obstacles: ObstacleSet) -> None:
    """As the costmap under the robot's centre must be free, no obstacle may lie there.

    Raises:
        NoValidPathCouldBeFound: One does.
    """
    points = np.concatenate([segment.poses_at(segment.knots)[:, :2] for segment in path.segments])
    rows = obstacles.rows_at(points)
    blocked = np.flatnonzero(rows >= 0)
    if blocked.size:
        x, y = (float(value) for value in points[blocked[0]])
        name = obstacles.name_of(int(rows[blocked[0]]))
        raise NoValidPathCouldBeFound(
            f"dock planner: the path is blocked at ({x:.3f}, {y:.3f}) by {in_words(name)}",
            where={"x": x, "y": y, "obstacle": name},
        )


def _same(known: PluginContext, offered: PluginContext) -> bool:
    if known.costmap is not offered.costmap or known.footprint is not offered.footprint:
        return False
    mine, theirs = known.problem, offered.problem
    return mine is theirs or (mine is not None and theirs is not None and mine.fingerprint == theirs.fingerprint)
