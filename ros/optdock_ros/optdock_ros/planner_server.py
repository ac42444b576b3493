"""`planner_server`: Nav2's action `compute_path_to_pose` with the planners of this library.

They plan manoeuvres of some metres, into a dock say, and need the robot's outline; for ways through a building there is
Nav2's own server. Parameters, topics, action and error codes are those of Nav2's server; ours are `robot`, `clearance`,
`max_planning_time`, `costmap_timeout`. The service `get_plan` (nav_msgs/GetPlan) asks the same.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from nav2_msgs.action import ComputePathToPose
from nav_msgs.srv import GetPlan
from pydantic import Field
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration

from optdock import ros
from optdock.deadline import Deadline
from optdock.errors import (
    Cancelled,
    GoalOccupied,
    GoalOutsideMapBounds,
    NoValidPathCouldBeFound,
    OptdockError,
    PlannerException,
    PlannerTimedOut,
    StartOccupied,
    StartOutsideMapBounds,
)
from optdock.model.dock import Dock
from optdock.model.path import Path
from optdock.model.problem import ClearanceRule, DockingProblem
from optdock.plugins.interfaces import GlobalPlanner, PluginContext
from optdock.verification import certify_path, pose_clearances
from optdock_ros.goals import JobEnded, WorkerJob, answer_of
from optdock_ros.plugin_server import (
    PluginServer,
    PluginServerParameters,
    ServerSettings,
    compact_path,
    cropped,
    failed,
    poses_of,
)
from optdock_ros.server import run
from optdock_ros.surroundings import SurroundingsError, now

if TYPE_CHECKING:
    from geometry_msgs.msg import PoseStamped
    from nav_msgs.msg import Path as PathMessage

    from optdock.geometry.pose import Pose2

__all__ = ["PlannerServer", "PlannerServerParameters", "main"]

# [m]: how far around start and goal the costmap is handed to a planner; its edge is a wall. Manoeuvres of these
# planners turn within a few turning radii.
_AROUND = 10.0
_SPACING = 0.05  # [m] of the poses taken from a curve: the usual cell
_TOUCHES = 1e-6  # [m]: as the certificate's; contact is none
_NO_PLAN = {"frame", "start", "goal", "clearance", "unproven"}  # rules of the certificate that every plan must keep
_WAIT = 0.01  # [s] between two looks for a costmap


class PlannerServerParameters(PluginServerParameters):
    """Nav2's names and defaults; `max_planning_time` is ours."""

    planner_plugins: tuple[str, ...] = Field(("GridBased",), description="names of the planners")
    expected_planner_frequency: float = Field(1.0, ge=0, description="slower planning is told; 0: never [Hz]")
    costmap_update_timeout: float = Field(1.0, ge=0, description="how long a costmap is waited for [s]")
    transform_tolerance: float = Field(0.3, ge=0, description="how old a transform may be [s]")
    max_planning_time: float = Field(5.0, gt=0, description="of a planner [s]")
    check_for_collisions: bool = Field(default=True, description="refuse plans that touch something, as raw ones may")


class InvalidPlanner(PlannerException):
    """The goal asks for a planner that there is not."""

    code = 201


class PlannerTFError(PlannerException):
    """There is no transform of start or goal into the costmap's frame."""

    code = 202


class PlannerServer(PluginServer[GlobalPlanner]):
    """See the module."""

    Parameters = PlannerServerParameters
    kind: ClassVar[str] = "planner"
    interface = GlobalPlanner
    default_plugins: ClassVar[tuple[str, ...]] = ("GridBased",)
    default_class: ClassVar[str] = "nav2_navfn_planner::NavfnPlanner"
    accepted = frozenset({"allow_partial_planning", "partial_plan_costmap_update_timeout"})
    fixed = PluginServer.fixed | {"planner_plugins"}

    def __init__(self, name: str = "planner_server", **kwargs: Any) -> None:
        super().__init__(name, **kwargs)

    def set_up(self) -> None:
        """Subscribe, and offer action and service."""
        super().set_up()
        self._plan_publisher = self.path_publisher("plan")
        self.offer(ComputePathToPose, "compute_path_to_pose", self._compute)
        group = ReentrantCallbackGroup()
        service = self.create_service(GetPlan, "get_plan", self._get_plan, callback_group=group)
        self._ends.append(lambda: self.destroy_service(service))

    def _compute(self, goal: ComputePathToPose.Goal, job: WorkerJob) -> tuple[ComputePathToPose.Result, bool]:
        """A goal, in the worker's thread."""
        began, result = now(self), ComputePathToPose.Result()
        start = goal.start if goal.use_start else None
        try:
            result.path = self._planned(goal.planner_id, start, goal.goal, job)
        except JobEnded:
            raise
        except OptdockError as error:
            self.get_logger().warning(str(error))
            code = error.code if 200 <= error.code <= 208 else PlannerException.code
            return failed(result, str(error), code), False
        took = max(0.0, now(self) - began)
        result.planning_time = Duration(seconds=took).to_msg()
        expected = self.settings.parameters.expected_planner_frequency
        if expected > 0.0 and took > 1.0 / expected:
            self.get_logger().warning(f"planning took {took:.2f} s, more than expected_planner_frequency asks for")
        return result, True

    async def _get_plan(self, request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
        """The service: an empty path where there is none, and why in the log."""
        if not self.is_active:
            self.get_logger().error("get_plan: the server is not active")
            return response
        start = request.start if request.start.header.frame_id else None
        job = self.worker.begin(lambda job: self._planned("", start, request.goal, job))
        await answer_of(job, self)
        if job.error is None:
            response.plan = job.result
        else:
            self.say(job.error, "get_plan")
        return response

    def _planned(self, planner_id: str, start: PoseStamped | None, goal: PoseStamped, job: WorkerJob) -> PathMessage:
        """A path, in the costmap's frame.

        Raises:
            PlannerException: There is none, by Nav2's codes.
            JobEnded: It is not wanted any more.
        """
        settings = self.settings
        planner = self.chosen(planner_id, settings)
        if planner is None:
            raise InvalidPlanner(f"Invalid Planner: {planner_id!r}; available: {', '.join(settings.plugins)}")
        problem = self._problem(start, goal, settings, job)
        deadline = Deadline(settings.parameters.max_planning_time, time.monotonic, job.should_end)
        with planner.made(PluginContext(planner.name, problem=problem)) as plugin:
            try:
                found = plugin.create_plan(problem.start, problem.goal, deadline.passed)
            except Cancelled as error:
                job.look()
                raise PlannerTimedOut(f"{planner.name}: no plan within {deadline.seconds:g} s: {error}") from error
        job.look()
        if not isinstance(found, Path):
            raise NoValidPathCouldBeFound(f"{planner.name}: generated no path, but {found!r}")
        self._check_plan(found, planner.name, problem, settings, job)
        poses = poses_of(found, _SPACING)
        message = compact_path(poses, problem.frame, now(self))
        if self._plan_publisher.get_subscription_count():
            self._plan_publisher.publish(message)
        return message

    def _check_plan(
        self, plan: Path, name: str, problem: DockingProblem, settings: ServerSettings[GlobalPlanner], job: WorkerJob
    ) -> None:
        """Nav2's planners return no path through anything; ours may be raw ones, for a smoother to mend.

        Raises:
            NoValidPathCouldBeFound: It touches something, or leads elsewhere.
        """
        bare = dataclasses.replace(problem, clearance=ClearanceRule(0.0, 0.0, 0.0))
        if not settings.parameters.check_for_collisions:
            bare = dataclasses.replace(bare, costmap=None)
        for broken in certify_path(plan, bare, is_late=job.should_end).violations:
            if broken.kind in _NO_PLAN:
                job.look()
                raise NoValidPathCouldBeFound(f"{name}: {broken.message}", where={"s": broken.s, **broken.where})

    def _problem(
        self, start: PoseStamped | None, goal: PoseStamped, settings: ServerSettings[GlobalPlanner], job: WorkerJob
    ) -> DockingProblem:
        """From where to where, among what is known of the surroundings.

        Raises:
            PlannerException: An end is not known, not on the map or not free, or the surroundings are not known.
        """
        known = self._awaited_costmap(settings, job)
        footprint = self.outline(settings)
        if footprint is None:
            raise self.no_footprint(settings)
        frame = known.frame if known is not None else goal.header.frame_id
        try:
            begin = self._robot(frame, settings) if start is None else self._in_frame(start, frame, settings)
            end = self._in_frame(goal, frame, settings)
        except OptdockError as error:
            raise PlannerTFError(str(error)) from error
        ends = np.stack((begin.as_array(), end.as_array()))
        near = None
        if known is not None:
            on_map = known.costmap.contains(ends[:, :2])
            if not on_map[0]:
                raise StartOutsideMapBounds(f"Start {begin.brief} lies off the costmap")
            if not on_map[1]:
                raise GoalOutsideMapBounds(f"Goal {end.brief} lies off the costmap")
            near = cropped(known.costmap, ends, _AROUND)
        rule = settings.rule
        robot = settings.robot(footprint)
        problem = DockingProblem(begin, Dock(end), robot, (), rule, costmap=near, frame=frame)
        depth, _ = pose_clearances(ends, footprint, problem.all_obstacles, within=0.0)
        if depth[0] < -_TOUCHES:
            raise StartOccupied(f"Start {begin.brief}: the footprint overlaps an obstacle by {-depth[0]:.3f} m")
        if depth[1] < -_TOUCHES:
            raise GoalOccupied(f"Goal {end.brief}: the footprint overlaps an obstacle by {-depth[1]:.3f} m")
        return problem

    def _awaited_costmap(self, settings: ServerSettings[GlobalPlanner], job: WorkerJob) -> ros.StampedCostmap | None:
        """The costmap, waited for where there is none or one that is too old.

        Raises:
            PlannerTimedOut: It did not come.
        """
        end = time.monotonic() + settings.parameters.costmap_update_timeout
        while True:
            job.look()
            try:
                return self.newest_costmap(settings)
            except SurroundingsError as error:
                if time.monotonic() >= end:
                    raise PlannerTimedOut(f"Costmap timed out waiting for update: {error}") from error
            time.sleep(_WAIT)

    def _robot(self, frame: str, settings: ServerSettings[GlobalPlanner]) -> Pose2:
        told = settings.parameters
        stood = self.transforms.lookup(frame, told.robot_base_frame, now(self), told.transform_tolerance)
        return stood.planar()

    def _in_frame(self, message: PoseStamped, frame: str, settings: ServerSettings[GlobalPlanner]) -> Pose2:
        given = ros.pose(message)
        if given.frame.lstrip("/") == frame.lstrip("/"):
            return given.pose
        tolerance = settings.parameters.transform_tolerance
        seen = self.transforms.lookup(frame, given.frame, now(self), tolerance)
        return seen.planar() @ given.pose


def main() -> int:
    """The console script."""
    return run(PlannerServer)


if __name__ == "__main__":
    sys.exit(main())
