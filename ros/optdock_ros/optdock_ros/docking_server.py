"""`docking_server`: Nav2's actions `dock_robot` and `undock_robot`, carried out by the executor.

While the robot moves, none of these threads waits for another one: the node's executor stores messages; the control
loop steps the `DockingExecutor` at `controller_frequency` and publishes cmd_vel; the thread of the goals does all other
work, such as finding the dock, merging costmaps and reporting. Paths are planned in another process.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING

from geometry_msgs.msg import Twist, TwistStamped
from nav2_msgs.action import DockRobot, UndockRobot
from nav2_msgs.srv import ReloadDockDatabase

from optdock import ros
from optdock.errors import InvalidValue, OptdockError
from optdock.executor import PlanningProcess
from optdock.geometry.pose import Twist2
from optdock.model.constant_jerk import braking_time
from optdock.nav2.declared_parameters import Block
from optdock_ros.control_loop import may_be_preferred
from optdock_ros.docking_parameters import DockingParameters, DockingSettings, Docks, docking_settings
from optdock_ros.docking_reports import Reports
from optdock_ros.docking_task import DockingTask
from optdock_ros.frame_lookup import TransformBuffer, now
from optdock_ros.goal_queue import Ended, Goal, GoalAction, GoalOutcome, GoalQueue, failed
from optdock_ros.navigator import Navigator
from optdock_ros.robot_topics import RobotTopics
from optdock_ros.server import Server, run
from optdock_ros.task_drive import STOPPING, DockingResources

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["DockingServer", "main"]

_CODES = range(901, 908)  # error codes of Nav2's docking actions
_UNKNOWN = DockRobot.Result.UNKNOWN
_OF_UNDOCKING = (0, 902, 905, 907, 999)  # the messages of Jazzy lack the name of 907, TIMEOUT
_BLOCKS = ("controller", "executor", "robot", "clearance", "tracker", "goal_checker", "dock")


class DockingServer(Server[DockingSettings]):
    """The node."""

    Parameters = DockingParameters
    place = Block.DOCKING
    fixed = frozenset(
        {
            *("controller_frequency", "base_frame", "fixed_frame", "odom_topic", "enable_stamped_cmd_vel"),
            *("dock_plugins", "dock_database", "docks", "stage_by_executor", "nav2_distribution"),
            *("controller.costmap_topic", "controller.footprint_topic", "controller.map_topic"),
            "controller.use_collision_detection",
        }
    )

    def check(self, block: dict[str, object]) -> DockingSettings:
        """Return all parameters; see `docking_settings`."""
        names = [name for key in ("dock_plugins", "docks") for name in block.get(key) or () if isinstance(name, str)]  # type: ignore[attr-defined]
        own = self.own_parameters(block, (*_BLOCKS, *names))
        assert isinstance(own, DockingParameters)
        # Frames of messages must not begin with a slash.
        frames = {name: getattr(own, name).lstrip("/") for name in ("base_frame", "fixed_frame")}
        return docking_settings(block, own.model_copy(update=frames))

    def set_up(self) -> None:
        """Create subscriptions, publishers, the service, the action servers, and the planning process."""
        settings, log = self.settings, self.get_logger()
        own = settings.own
        if own.use_realtime_priority and not may_be_preferred():
            raise InvalidValue("use_realtime_priority: is not permitted; set rtprio in /etc/security/limits.conf")
        self.log_ignored(settings.not_read)
        for line in settings.mapped:
            log.info(line)
        if not settings.docks:
            log.warning("there are no docks: goals must give a dock's pose, or reload_database must be called")
        if not settings.controller.use_collision_detection:
            log.warning("controller.use_collision_detection is false: obstacles are not checked")
        self._parts = parts = ExitStack()
        planner = parts.enter_context(closing(PlanningProcess()))
        frames = parts.enter_context(closing(TransformBuffer(self)))
        reports = parts.enter_context(closing(Reports(self, own.fixed_frame)))
        self._command = self.create_publisher(TwistStamped if settings.sends_stamps else Twist, "cmd_vel", 1)
        parts.callback(self.destroy_publisher, self._command)
        topics = parts.enter_context(closing(RobotTopics(self, settings, frames)))
        navigator = None if own.stage_by_executor else parts.enter_context(closing(Navigator(self)))
        docks = Docks(settings.plugins, settings.docks)
        self._resources = DockingResources(
            self, settings, docks, frames, topics, planner, reports, navigator, self._send
        )
        service = self.create_service(ReloadDockDatabase, "~/reload_database", self._reload)
        parts.callback(self.destroy_service, service)
        actions = {
            DockRobot: GoalAction("dock_robot", self._dock, _UNKNOWN),
            UndockRobot: GoalAction("undock_robot", self._undock, _UNKNOWN),
        }
        self._goals = GoalQueue(self, actions)
        parts.callback(self._goals.destroy)

    def start(self) -> None:
        """Accept goals."""
        self._goals.accept_goals()
        docks = self._resources.docks
        self.get_logger().info(f"ready for goals: {len(docks.plugins)} dock types, {len(docks.entries)} docks")

    def changed(self) -> None:
        """Use the new settings for the next goals."""
        self._resources.settings = self.settings
        self._resources.docks.plugins = dict(self.settings.plugins)

    def stop(self) -> None:
        """Stop the robot and end all goals; the last command is zero."""
        reason = "the server is being deactivated"
        self._goals.close(reason)
        limits = self.settings.robot.document.limits.value()
        braking = braking_time(limits.max_speed, limits.max_deceleration, limits.max_jerk)
        loop = self._resources.loop
        if loop is not None and not loop.close(reason, braking + STOPPING):
            self.get_logger().error("the robot was not stopped by the executor")
        if not self._goals.join(STOPPING):
            self.get_logger().error("the thread of a goal still runs; its commands are ignored")
        self._resources.reports.idle(now(self))

    def tear_down(self) -> None:
        """Destroy everything that was created."""
        parts = self.__dict__.pop("_parts", None)
        if parts is not None:
            parts.close()

    def _send(self, command: Twist2) -> None:
        frame, stamped = self.settings.own.base_frame, self.settings.sends_stamps
        self._command.publish(ros.twist_message(ros.imported, command, frame, now(self), stamped=stamped))

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
            self.log_error(error, "reload_database")
            return response
        self.get_logger().info(f"reload_database: {len(self._resources.docks.entries)} docks from {request.filepath}")
        response.success = True
        return response

    # Called in the thread of the goals.

    def _dock(self, goal: Goal) -> GoalOutcome:
        return self._reported(DockingTask(self._resources, goal).dock)

    def _undock(self, goal: Goal) -> GoalOutcome:
        outcome = self._reported(DockingTask(self._resources, goal).undock)
        known = outcome.code in _OF_UNDOCKING
        return outcome if known else outcome._replace(code=UndockRobot.Result.FAILED_TO_CONTROL)

    def _reported(self, work: Callable[[], GoalOutcome]) -> GoalOutcome:
        """Return the outcome of the work on a goal, with one of the actions' error codes, and report it."""
        try:
            outcome = work()
        except Ended as ended:
            outcome = ended.outcome
        except OptdockError as error:
            outcome = failed(error.code if error.code in _CODES else _UNKNOWN, str(error))
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
    """Run the console script."""
    sys.exit(run(lambda: DockingServer("docking_server")))
