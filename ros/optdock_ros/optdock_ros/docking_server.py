"""`docking_server`: Nav2's dock_robot and undock_robot, carried out by the executor.

Three threads share the work, and none waits for another one while the robot moves. The executor of the node takes
messages and puts them away. The control loop steps the `DockingExecutor` at `controller_frequency` and publishes
cmd_vel. The goal's thread does everything that takes time: it finds the dock, has the robot navigated to its staging
pose, prepares the costmaps and reports. Paths are planned in another process.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING, TypeVar

from geometry_msgs.msg import Twist, TwistStamped
from nav2_msgs.action import DockRobot, UndockRobot
from nav2_msgs.srv import ReloadDockDatabase

from optdock import ros
from optdock.errors import InvalidValue, OptdockError
from optdock.executor import PlanningProcess
from optdock.geometry.pose import Twist2
from optdock.model.trajectory import braking_time
from optdock_ros.control_loop import may_be_preferred
from optdock_ros.dock_database import Docks
from optdock_ros.docking_goals import UNKNOWN, Ended, Goal, GoalOutcome, GoalQueue, failed
from optdock_ros.docking_parameters import NOT_READ, DockingParameters, DockingSettings, docking_settings
from optdock_ros.docking_reports import Reports
from optdock_ros.docking_task import DockingTask
from optdock_ros.frame_lookup import TransformBuffer
from optdock_ros.navigator import Navigator
from optdock_ros.robot_topics import RobotTopics
from optdock_ros.server import Server, run
from optdock_ros.surroundings import now
from optdock_ros.task_drive import STOPPING, DockingResources

if TYPE_CHECKING:
    from collections.abc import Callable


__all__ = ["DockingServer", "main"]

T = TypeVar("T")

_CODES = range(901, 908)  # of Nav2's docking actions


class DockingServer(Server[DockingSettings]):
    """The node."""

    Parameters = DockingParameters
    accepted = NOT_READ
    fixed = frozenset(
        {
            *("controller_frequency", "base_frame", "fixed_frame", "odom_topic", "enable_stamped_cmd_vel"),
            *("dock_plugins", "dock_database", "docks", "stage_by_executor"),
            *("controller.costmap_topic", "controller.footprint_topic", "controller.map_topic"),
            "controller.use_collision_detection",
        }
    )

    def check(self, block: dict[str, object]) -> DockingSettings:
        """All parameters; see `docking_settings`."""
        names = [name for key in ("dock_plugins", "docks") for name in block.get(key) or () if isinstance(name, str)]  # type: ignore[attr-defined]
        blocks = ("controller", "executor", "robot", "clearance", "tracker", "goal_checker", "dock", *names)
        own = self.own_parameters(block, blocks)
        assert isinstance(own, DockingParameters)
        return docking_settings(block, own)

    def set_up(self) -> None:
        """Subscriptions, publishers, services, actions, and the process that plans."""
        settings = self.settings
        if settings.own.use_realtime_priority and not may_be_preferred():
            raise InvalidValue("use_realtime_priority: is not permitted; set rtprio in /etc/security/limits.conf")
        self._say_what_is_missing()
        docks = Docks(settings.plugins, settings.docks)
        self._parts = parts = ExitStack()
        planner = parts.enter_context(closing(PlanningProcess()))
        frames = parts.enter_context(closing(TransformBuffer(self)))
        reports = parts.enter_context(closing(Reports(self, settings.own.fixed_frame)))
        stamped = settings.own.enable_stamped_cmd_vel
        self._command = self.create_publisher(TwistStamped if stamped else Twist, "cmd_vel", 1)
        parts.callback(self.destroy_publisher, self._command)
        topics = parts.enter_context(closing(RobotTopics(self, settings, frames)))
        navigator: Navigator | None = None
        if not settings.own.stage_by_executor:
            navigator = parts.enter_context(closing(Navigator(self)))
        self._resources = DockingResources(
            self, settings, docks, frames, topics, planner, reports, navigator, self._send, self._tidy
        )
        service = self.create_service(ReloadDockDatabase, "~/reload_database", self._reload)
        parts.callback(self.destroy_service, service)
        work = {DockRobot: ("dock_robot", self._dock), UndockRobot: ("undock_robot", self._undock)}
        self._goals = GoalQueue(self, work)
        parts.callback(self._goals.destroy)

    def _say_what_is_missing(self) -> None:
        settings = self.settings
        if settings.not_read:
            self.get_logger().info(f"parameters that mean nothing here: {', '.join(settings.not_read)}")
        if not settings.docks:
            self.get_logger().warning(
                "there is neither dock_database nor docks: goals must give a dock's pose, or reload_database be called"
            )
        if not settings.controller.use_collision_detection:
            self.get_logger().warning("controller.use_collision_detection is false: the robot sees no obstacles")

    def start(self) -> None:
        """Accept goals."""
        self._goals.open()
        docks = self._resources.docks
        self.get_logger().info(f"ready for goals: {len(docks.plugins)} dock types, {len(docks.entries)} docks")

    def changed(self, before: DockingSettings) -> None:  # noqa: ARG002 - the base class's
        """What is changed counts from the next goal on."""
        self._resources.settings = self.settings
        self._resources.docks.plugins = dict(self.settings.plugins)

    def stop(self) -> None:
        """Stop the robot, end all goals; the last command is zero."""
        reason = "the server is being deactivated"
        self._goals.close(reason)
        limits = self.settings.robot.document.limits.value()
        braking = braking_time(limits.max_speed, limits.max_deceleration, limits.max_jerk)
        loop = self._resources.loop
        if loop is not None and not loop.close(reason, braking + STOPPING):
            self.get_logger().error("the robot was not stopped by the executor")
        if not self._goals.join(STOPPING):
            self.get_logger().error("the thread of a goal goes on; it commands nothing any more")
        self._resources.reports.idle(now(self))

    def tear_down(self) -> None:
        """Give everything back."""
        parts = self.__dict__.pop("_parts", None)
        if parts is not None:
            parts.close()

    def _send(self, command: Twist2) -> None:
        own = self.settings.own
        stamp, stamped = now(self), own.enable_stamped_cmd_vel
        self._command.publish(ros.twist_message(ros.imported, command, own.base_frame, stamp, stamped=stamped))

    def _tidy(self) -> None:
        self._goals.tidy()

    def _reload(
        self, request: ReloadDockDatabase.Request, response: ReloadDockDatabase.Response
    ) -> ReloadDockDatabase.Response:
        response.success = False
        if self._goals.is_busy:
            self.get_logger().error("reload_database: not while docking or undocking")
            return response
        try:
            self._resources.docks.reload(request.filepath)
        except OptdockError as error:
            self.say(error, "reload_database")
            return response
        self.get_logger().info(f"reload_database: {len(self._resources.docks.entries)} docks from {request.filepath}")
        response.success = True
        return response

    def _dock(self, goal: Goal) -> GoalOutcome:
        """The work on a goal of dock_robot."""
        return self._worked_on(DockingTask(self._resources, goal).dock)

    def _undock(self, goal: Goal) -> GoalOutcome:
        """The work on a goal of undock_robot."""
        outcome = self._worked_on(DockingTask(self._resources, goal).undock)
        of_action = (0, UndockRobot.Result.DOCK_NOT_VALID, UndockRobot.Result.TIMEOUT, UndockRobot.Result.UNKNOWN)
        return outcome if outcome.code in of_action else outcome._replace(code=UndockRobot.Result.FAILED_TO_CONTROL)

    def _worked_on(self, work: Callable[[], GoalOutcome]) -> GoalOutcome:
        try:
            outcome = work()
        except Ended as ended:
            outcome = ended.outcome
        except OptdockError as error:
            outcome = failed(error.code if error.code in _CODES else UNKNOWN, str(error))
        finally:
            self._resources.reports.idle(now(self))
        if outcome.success:
            self.get_logger().info(f"done{outcome.text and ': '}{outcome.text}")
        else:
            text = f"failed ({outcome.code}): {outcome.text}"
            self.get_logger().error(text)
            self._resources.reports.idle(now(self), f"the last goal {text}")
        return outcome


def main() -> None:
    """The process."""
    sys.exit(run(lambda: DockingServer("docking_server")))
