"""`docking_server`: Nav2's dock_robot and undock_robot, carried out by the executor.

Three threads share the work, and none waits for another one while the robot moves. The executor of the node takes
messages and puts them away. The control loop steps the `DockingExecutor` at `controller_frequency` and publishes
cmd_vel. The goal's thread does everything that takes time: it finds the dock, has the robot navigated to its staging
pose, prepares the costmaps and reports. Paths are planned in another process.
"""

from __future__ import annotations

import dataclasses
import math
import sys
import time
from collections import deque
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav2_msgs.action import DockRobot, UndockRobot
from nav2_msgs.srv import ReloadDockDatabase
from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.duration import Duration
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from optdock import ros
from optdock.errors import DockNotValid, InvalidMessage, InvalidValue, OptdockError
from optdock.executor import DockingExecutor, EndingKind, PlanningProcess, State, ThreadPlanning
from optdock.executor.contact_zone import contact_reach
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.problem import DockingProblem
from optdock.model.trajectory import braking_time
from optdock_ros.control_loop import ControlLoop, TaskRun, may_be_preferred
from optdock_ros.dock_database import Docks
from optdock_ros.dock_plugins import Told
from optdock_ros.docking_goals import UNKNOWN, Goal, GoalOutcome, GoalQueue, done, failed
from optdock_ros.docking_parameters import NOT_READ, DockingParameters, DockingSettings, docking_settings
from optdock_ros.docking_reports import Reports
from optdock_ros.frame_lookup import TransformBuffer
from optdock_ros.measuring import DatedCostmap, MeasurementRules, Measuring
from optdock_ros.merged_costmap import joined, moved
from optdock_ros.navigator import Navigator
from optdock_ros.server import Server, run
from optdock_ros.surroundings import CostmapTopic, FootprintTopic, SurroundingsError, nav2_footprint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rclpy.task import Future

    from optdock.costmap.costmap import Costmap
    from optdock.executor import Event, ExecutorSettings, Step
    from optdock.executor.planning import DrivenMotion, PlanResult
    from optdock.geometry.footprint import Footprint
    from optdock.model.measurements import Measurements
    from optdock.nav2.docks import DockEntry
    from optdock.ros import StampedCostmap
    from optdock_ros.dock_plugins import DockPlugin
    from optdock_ros.merged_costmap import Box

__all__ = ["DockingServer", "main"]

T = TypeVar("T")

_LOOK = 0.05  # [s] between two looks at costmaps, cancellations and what there is to report
_FIRST_MESSAGES = 2.0  # [s]: a costmap comes at 1 Hz at least, a footprint and transforms with it
_WARM = 60.0  # [s] for the planning process to start, once, on a slow computer
_STOPPING = 2.0  # [s] beyond what braking takes, until a stop counts as failed, or a thread that ends as hanging
_CODES = range(901, 908)  # of Nav2's docking actions
_DETECTIONS = "detected_dock_pose"
_TELL, _REPORT = 0.1, 0.5  # [s] between two feedbacks, and two reports on /diagnostics, where nothing changes
_LOOKS = 15  # detections for a dock that is not seen any more on the way: their median errs by a third of one
_PRESSES = (State.APPROACHING, State.PRESSING)
_FRESH = 0.5  # [s] at least that a pose is good for before the robot moves
_AROUND = 3.0  # [m] around robot and dock: beyond, a map is not looked at


class _Ended(Exception):
    """The goal has ended before its task, or instead of one."""

    def __init__(self, outcome: GoalOutcome) -> None:
        super().__init__(outcome.text)
        self.outcome = outcome


class _Docked(NamedTuple):
    """Where the robot was docked last: in the fixed frame, the robot's pose; and its type."""

    pose: Pose2
    type_name: str


class _WatchedPlanning(ThreadPlanning):
    """Plans in the process, and remembers what is driven."""

    def __init__(self, process: PlanningProcess) -> None:
        super().__init__(process.planned)
        self.motion: DrivenMotion | None = None

    def poll(self, stamp: float) -> PlanResult | None:
        """The result, once it is there."""
        result = super().poll(stamp)
        if result is not None:
            self.motion = result.motion or self.motion
        return result


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
        self._docks = Docks(settings.plugins, settings.docks)
        self._measuring: Measuring | None = None
        self._battery: Told | None = None
        self._joints: Told | None = None
        self._switches: dict[str, Told] = {}
        self._docked: _Docked | None = None
        self._loop: ControlLoop | None = None
        self._parts = parts = ExitStack()
        self._planner = parts.enter_context(closing(PlanningProcess()))
        self._frames = parts.enter_context(closing(TransformBuffer(self)))
        self._reports = parts.enter_context(closing(Reports(self, settings.own.fixed_frame)))
        stamped = settings.own.enable_stamped_cmd_vel
        self._command = self.create_publisher(TwistStamped if stamped else Twist, "cmd_vel", 1)
        parts.callback(self.destroy_publisher, self._command)
        self._see()
        self._listen()
        self._navigator: Navigator | None = None
        if not settings.own.stage_by_executor:
            self._navigator = parts.enter_context(closing(Navigator(self)))
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

    def _see(self) -> None:
        """Subscribe to what the robot must not touch, and to what it is."""
        own, controller, parts = self.settings.own, self.settings.controller, self._parts
        self._costmap: CostmapTopic | None = None
        self._map: CostmapTopic | None = None
        self._footprint: FootprintTopic | None = None
        if not controller.use_collision_detection:
            return
        self._costmap = parts.enter_context(closing(CostmapTopic(self, controller.costmap_topic)))
        if controller.map_topic:
            self._map = parts.enter_context(closing(CostmapTopic(self, controller.map_topic)))
        outline = FootprintTopic(
            self, controller.footprint_topic, self._frames, own.base_frame, controller.transform_tolerance
        )
        self._footprint = parts.enter_context(closing(outline))

    def _listen(self) -> None:
        """Subscribe to what the robot does and feels, as far as a type of dock asks for it."""
        types = [plugin.parameters for plugin in self.settings.plugins.values()]
        self._subscribe(Odometry, self.settings.own.odom_topic, self._take_odometry, 10)
        if any(of_type.use_external_detection_pose and not of_type.subscribe_toggle for of_type in types):
            self._subscribe(PoseStamped, _DETECTIONS, self._take_detection, 10)
        if any(plugin.uses_battery for plugin in self.settings.plugins.values()):
            self._subscribe(BatteryState, "battery_state", self._take_battery, 1)
        if any(of_type.use_stall_detection for of_type in types):
            self._subscribe(JointState, "joint_states", self._take_joints, 10)
        for topic in {plugin.contact_topic for plugin in self.settings.plugins.values()} - {""}:
            self._subscribe(Bool, topic, partial(self._take_switch, topic), 10)
        names = {of_type.detector_service_name for of_type in types} - {""}
        self._detectors: dict[str, Any] = {name: self.create_client(Trigger, name) for name in names}
        for client in self._detectors.values():
            self._parts.callback(self.destroy_client, client)

    def _subscribe(self, kind: Any, topic: str, take: Callable[[Any], None], depth: int) -> None:
        group = MutuallyExclusiveCallbackGroup()
        subscription = self.create_subscription(kind, topic, take, depth, callback_group=group)
        self._parts.callback(self.destroy_subscription, subscription)

    def start(self) -> None:
        """Accept goals."""
        self._goals.open()
        docks = self._docks
        self.get_logger().info(f"ready for goals: {len(docks.plugins)} dock types, {len(docks.entries)} docks")

    def changed(self, before: DockingSettings) -> None:  # noqa: ARG002 - the base class's
        """What is changed counts from the next goal on."""
        self._docks.plugins = dict(self.settings.plugins)

    def stop(self) -> None:
        """Stop the robot, end all goals; the last command is zero."""
        reason = "the server is being deactivated"
        self._goals.close(reason)
        limits = self.settings.robot.document.limits.value()
        braking = braking_time(limits.max_speed, limits.max_deceleration, limits.max_jerk)
        if self._loop is not None and not self._loop.close(reason, braking + _STOPPING):
            self.get_logger().error("the robot was not stopped by the executor")
        if not self._goals.join(_STOPPING):
            self.get_logger().error("the thread of a goal goes on; it commands nothing any more")
        self._reports.idle(self._now())

    def tear_down(self) -> None:
        """Give everything back."""
        parts = self.__dict__.pop("_parts", None)
        if parts is not None:
            parts.close()

    # Messages.

    def _now(self) -> float:
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def _take_odometry(self, message: Odometry) -> None:
        if self._measuring is not None:
            self._measuring.take_odometry(message)

    def _take_detection(self, message: PoseStamped) -> None:
        if self._measuring is not None:
            self._measuring.take_detection(message)

    def _take_battery(self, message: BatteryState) -> None:
        self._battery = Told(message, self._now())

    def _take_joints(self, message: JointState) -> None:
        self._joints = Told(message, self._now())

    def _take_switch(self, topic: str, message: Bool) -> None:
        self._switches[topic] = Told(message, self._now())

    def _send(self, command: Twist2) -> None:
        own = self.settings.own
        self._command.publish(
            ros.twist_message(ros.imported, command, own.base_frame, self._now(), stamped=own.enable_stamped_cmd_vel)
        )

    def _reload(
        self, request: ReloadDockDatabase.Request, response: ReloadDockDatabase.Response
    ) -> ReloadDockDatabase.Response:
        response.success = False
        if self._goals.is_busy:
            self.get_logger().error("reload_database: not while docking or undocking")
            return response
        try:
            self._docks.reload(request.filepath)
        except OptdockError as error:
            self.say(error, "reload_database")
            return response
        self.get_logger().info(f"reload_database: {len(self._docks.entries)} docks from {request.filepath}")
        response.success = True
        return response

    # Docking.

    def _dock(self, goal: Goal) -> GoalOutcome:
        """The work on a goal of dock_robot."""
        return self._worked_on(goal, self._dock_at)

    def _undock(self, goal: Goal) -> GoalOutcome:
        """The work on a goal of undock_robot."""
        outcome = self._worked_on(goal, self._undock_from)
        of_action = (0, UndockRobot.Result.DOCK_NOT_VALID, UndockRobot.Result.TIMEOUT, UndockRobot.Result.UNKNOWN)
        return outcome if outcome.code in of_action else outcome._replace(code=UndockRobot.Result.FAILED_TO_CONTROL)

    def _worked_on(self, goal: Goal, work: Callable[[Goal], GoalOutcome]) -> GoalOutcome:
        try:
            outcome = work(goal)
        except _Ended as ended:
            outcome = ended.outcome
        except OptdockError as error:
            outcome = failed(error.code if error.code in _CODES else UNKNOWN, str(error))
        finally:
            self._measuring = None
            self._reports.idle(self._now())
        if outcome.success:
            self.get_logger().info(f"done{outcome.text and ': '}{outcome.text}")
        else:
            text = f"failed ({outcome.code}): {outcome.text}"
            self.get_logger().error(text)
            self._reports.idle(self._now(), f"the last goal {text}")
        return outcome

    def _dock_at(self, goal: Goal) -> GoalOutcome:
        request, own = goal.request, self.settings.own
        staging_time = self._limit(request.max_staging_time, "max_staging_time")
        entry, plugin = self._wanted(request)
        dock = self._in_fixed_frame(goal, entry)
        stands_there = [] if plugin.waits_for_charge else [plugin.docked_pose(dock)]  # else the current alone tells
        if plugin.is_charger and self._is_in_dock(plugin, stands_there):
            return done("the robot is docked or charging already")
        stages = bool(request.navigate_to_staging_pose)
        if stages and not own.stage_by_executor:
            self._navigate(goal, entry, plugin, dock, staging_time)
            dock, stages = self._in_fixed_frame(goal, entry), False
        settings = self.settings.executor_settings(
            plugin, navigate_to_staging_pose=stages, max_staging_time=staging_time
        )
        docked = plugin.docked_pose(dock)
        if plugin.parameters.rotate_to_dock and settings.use_detections:
            docked = self._seen_at_rest(goal, plugin, settings)
            settings = settings.model_copy(update={"use_detections": False})
        task = self._task(goal, plugin, docked, settings, "dock")
        ending = self._carry_out(goal, task)
        if ending.success:
            self._docked = _Docked(task.executor.dock, plugin.name)
        return ending

    def _undock_from(self, goal: Goal) -> GoalOutcome:
        request = goal.request
        named = request.dock_type or (self._docked.type_name if self._docked is not None else "")
        plugin = self._docks.plugin(named, "undock_robot: dock_type")
        robot = self._robot_pose(goal)
        known = [plugin.docked_pose(pose) for pose in self._stored(plugin)]
        known += [self._docked.pose] if self._docked is not None else []
        if plugin.is_charger and not self._is_in_dock(plugin, known):
            return done("the robot is in no dock, there is nothing to undock from")
        limit = self._limit(request.max_undocking_time, "max_undocking_time")
        settings = self.settings.executor_settings(
            plugin, use_detections=False, max_undocking_time=limit, timeout=limit
        )
        # As Nav2: the dock is where the robot stands.
        ending = self._carry_out(goal, self._task(goal, plugin, robot, settings, "undock"))
        if not ending.success:
            return ending
        self._docked = None
        until = time.monotonic() + _FIRST_MESSAGES  # batteries tell once a second
        while plugin.is_charging(self._battery, self._now()) and time.monotonic() < until and not goal.ending:
            time.sleep(_LOOK)
        if plugin.is_charging(self._battery, self._now()):
            return failed(UndockRobot.Result.FAILED_TO_CONTROL, "the battery still charges at the staging pose")
        return ending

    def _limit(self, seconds: float, name: str) -> float:
        """A time limit of a goal [s], one period at least.

        Raises:
            _Ended: It is no number: nothing would ever be later than that.
        """
        if not math.isfinite(seconds):
            raise _Ended(failed(UNKNOWN, f"{name}: must be a finite number of seconds, got {seconds}"))
        return max(float(seconds), self.settings.period)

    def _wanted(self, request: DockRobot.Goal) -> tuple[DockEntry, DockPlugin]:
        """The dock that a goal means.

        Raises:
            DockNotInDB: There is none of its name.
            DockNotValid: Its type is unknown, or its pose is none.
        """
        if request.use_dock_id:
            return self._docks.find(request.dock_id)
        try:
            told = ros.pose(request.dock_pose)
        except InvalidMessage as error:
            raise DockNotValid(f"dock_pose: {error}") from error
        return self._docks.at(told.pose, told.frame, request.dock_type)

    def _in_fixed_frame(self, goal: Goal, entry: DockEntry) -> Pose2:
        """The dock's pose, as Nav2 writes it.

        Raises:
            DockNotValid: Its frame is unknown.
        """
        fixed = self.settings.own.fixed_frame
        try:
            frame = self._waited(goal, lambda: self._frames.lookup(fixed, entry.frame).planar())
        except OptdockError as error:
            raise DockNotValid(f"{entry.name}.frame: {error}") from error
        return frame @ entry.pose

    def _robot_pose(self, goal: Goal) -> Pose2:
        """Where the robot is in the fixed frame, or will have been a moment later.

        Raises:
            TransformError: Nobody tells.
        """
        return self._waited(goal, self._located)

    def _located(self) -> Pose2:
        """Where the robot is in the fixed frame.

        Raises:
            TransformError: Nobody has told for too long.
        """
        own = self.settings.own
        found = self._frames.lookup(own.fixed_frame, own.base_frame)
        age = self._now() - found.stamp
        if age > max(_FRESH, self.settings.controller.transform_tolerance):
            raise ros.TransformError(f"{own.fixed_frame} <- {own.base_frame}: the last one is {age:.2f} s old")
        return found.planar()

    def _waited(self, goal: Goal, ask: Callable[[], T]) -> T:
        """What may come with the first messages.

        Raises:
            OptdockError: It has not come.
        """
        until = time.monotonic() + _FIRST_MESSAGES
        while True:
            self._check_end(goal)
            try:
                return ask()
            except OptdockError:
                if time.monotonic() > until:
                    raise
            time.sleep(_LOOK)

    def _check_end(self, goal: Goal) -> None:
        """End here where the goal is to end."""
        self._goals.tidy()
        if goal.ending:
            raise _Ended(self._stopped_goal(goal))

    @staticmethod
    def _stopped_goal(goal: Goal, where: str = "", retries: int = 0) -> GoalOutcome:
        code = 0 if goal.ending == "cancelled" else UNKNOWN
        return failed(code, f"{goal.ending}{where and ' '}{where}", retries)

    def _stored(self, plugin: DockPlugin) -> list[Pose2]:
        """The docks of a type whose frames are known, in the fixed frame."""
        found = []
        for entry in self._docks.entries.values():
            if entry.type == plugin.name:
                with suppress(OptdockError):
                    frame = self._frames.lookup(self.settings.own.fixed_frame, entry.frame).planar()
                    found.append(frame @ entry.pose)
        return found

    def _is_in_dock(self, plugin: DockPlugin, docked: list[Pose2]) -> bool:
        """Whether the battery charges, or the robot stands where it would stand docked."""
        if plugin.is_charging(self._battery, self._now()):
            return True
        try:
            robot = self._located()
        except OptdockError:
            return False
        return any(robot.distance_to(pose) < plugin.parameters.docking_threshold for pose in docked)

    def _navigate(self, goal: Goal, entry: DockEntry, plugin: DockPlugin, dock: Pose2, limit: float) -> None:
        """Have the robot navigated to the staging pose, where it is far from it.

        Raises:
            _Ended: It did not get there.
        """
        own, staging = self.settings.own, plugin.staging_pose(dock)
        self._reports.pose("staging_pose", staging, self._now())
        gap = self._robot_pose(goal).in_frame_of(staging)
        if math.sqrt(gap.x**2 + gap.y**2 + gap.yaw**2) < own.dock_prestaging_tolerance:
            return
        assert self._navigator is not None
        pose = ros.pose_message(ros.imported, plugin.staging_pose(entry.pose), entry.frame, self._now())

        def is_over() -> bool:
            self._goals.tidy()
            self._tell(goal, DockRobot.Feedback.NAV_TO_STAGING_POSE, 0)
            goal.changed.wait(_LOOK)
            goal.changed.clear()
            return bool(goal.ending)

        fault = self._navigator.go(pose, own.navigator_bt_xml, limit, is_over)
        self._check_end(goal)
        if fault:
            raise _Ended(failed(DockRobot.Result.FAILED_TO_STAGE, f"navigate_to_pose: {fault}"))

    # The executor's part.

    def _task(
        self, goal: Goal, plugin: DockPlugin, docked: Pose2, settings: ExecutorSettings, what: Literal["dock", "undock"]
    ) -> _DockingTask:
        """Everything that one task needs, checked; the robot stands.

        Raises:
            _Ended: What the robot must see or know has not come.
        """
        own = self.settings.own
        outline = self._outline(goal)
        robot = self.settings.robot.robot(outline)
        if plugin.parameters.rotate_to_dock:
            robot = dataclasses.replace(robot, turns_in_place=True)
        dock = self.settings.dock_parameters[plugin.name].dock(plugin, docked)
        problem = DockingProblem(
            self._robot_pose(goal), dock, robot, clearance=self.settings.clearance, frame=own.fixed_frame
        )
        planning = _WatchedPlanning(self._planner)
        executor = DockingExecutor(
            problem,
            settings,
            task=what,
            controller=self.settings.tracker,
            goal_checker=self.settings.goal_checker,
            dock_type=self.settings.dock_type(plugin),
            planning=planning,
        )
        detect = plugin.detection if settings.use_detections else None
        task = _DockingTask(goal, plugin, problem, executor, planning)
        task.measuring = Measuring(
            self._rules(plugin),
            self._frames,
            detect,
            contact=lambda now: self._contact(task, now),
            current=lambda now: plugin.current(self._battery, now),
        )
        return task

    def _rules(self, plugin: DockPlugin) -> MeasurementRules:
        own, controller = self.settings.own, self.settings.controller
        return MeasurementRules(
            own.fixed_frame,
            own.base_frame,
            controller.transform_tolerance,
            own.odom_duration,
            controller.costmap_timeout if controller.use_collision_detection else None,
            plugin.parameters.external_detection_timeout,
        )

    def _outline(self, goal: Goal) -> Footprint:
        """The robot's, from the block `robot`, the topic, or the parameters of Nav2's costmaps.

        Raises:
            _Ended: Nobody tells.
        """
        own, given = self.settings.own, self.settings.robot.footprint
        if given is not None:
            return given
        topic = self._footprint
        if topic is None or own.footprint:
            return nav2_footprint(own.footprint, own.robot_radius, own.footprint_padding)
        try:
            return self._waited(goal, lambda: topic.newest()[0])
        except OptdockError as error:
            raise _Ended(failed(DockRobot.Result.FAILED_TO_CONTROL, str(error))) from error

    def _contact(self, task: _DockingTask, now: float) -> bool | None:
        """What a switch tells of contact, and the joints until the robot has stopped; None where neither does."""
        plugin, state = task.plugin, task.executor.state
        switched = plugin.is_switched(self._switches.get(plugin.contact_topic), now)
        if not plugin.parameters.use_stall_detection:
            return switched
        if state in _PRESSES:
            try:
                task.stalled = task.stalled or plugin.is_stalled(self._joints, now)
            except InvalidMessage as error:
                self.get_logger().error(str(error), throttle_duration_sec=5.0)
        elif state is not State.STOPPING:
            task.stalled = False
        return bool(switched) or task.stalled

    def _carry_out(self, goal: Goal, task: _DockingTask) -> GoalOutcome:
        """Drive; returns when the robot stands."""
        try:
            with self._detecting(goal, task.plugin, task.measuring):
                self._see_first(goal, task)
                self._wait_for_planner(goal)
                run = self._driven(goal, task)
        finally:
            task.planning.close()
        ending = run.ending
        assert ending is not None
        if ending.kind is EndingKind.CANCELLED and goal.ending:
            return self._stopped_goal(goal, ending.reason, ending.num_retries)
        missing = "; ".join(f"{name}: {why}" for name, why in task.measuring.faults.items())
        text = f"{ending.kind.value}{ending.reason and ': '}{ending.reason}"
        if not ending.kind.succeeded and missing:
            text += f" ({missing})"
        return GoalOutcome(ending.kind.succeeded, ending.kind.code, text, ending.num_retries)

    def _wait_for_planner(self, goal: Goal) -> None:
        """Until the process that plans is warm, some seconds after configure.

        Raises:
            _Ended: It does not start, or the goal is to end.
        """
        until = time.monotonic() + _WARM
        while not self._planner.wait_until_warm(_LOOK):
            self._check_end(goal)
            if time.monotonic() > until:
                raise _Ended(failed(UNKNOWN, "the planning process does not start"))

    def _driven(self, goal: Goal, task: _DockingTask) -> TaskRun:
        """The task, done; the robot stands, also where something fails here."""
        self._check_end(goal)
        own, settings = self.settings.own, self.settings
        loop = self._loop = ControlLoop(
            task.problem.robot, settings.period, self._now, self._send, realtime=own.use_realtime_priority
        )
        run = TaskRun(task.executor, task.measuring.measurements, task.observe)
        goal.start(run)
        loop.start(run)
        try:
            while not run.done.is_set():
                goal.changed.wait(_LOOK)
                goal.changed.clear()
                self._look_after(goal, task, loop)
            self._look_after(goal, task, loop)
        finally:
            loop.close("the thread of the goal has failed", _STOPPING)  # nothing to do but then
        return run

    def _see_first(self, goal: Goal, task: _DockingTask) -> None:
        """Wait for the surroundings.

        Raises:
            _Ended: There are none.
        """
        if self._costmap is None:
            return
        try:
            self._waited(goal, lambda: self._refresh(task, is_first=True))
        except OptdockError as error:
            raise _Ended(failed(DockRobot.Result.FAILED_TO_CONTROL, str(error))) from error

    def _look_after(self, goal: Goal, task: _DockingTask, loop: ControlLoop) -> None:
        """Everything beside the control loop; nothing here may end the goal."""
        self._goals.tidy()
        try:
            self._refresh(task)
        except OptdockError as error:
            self.get_logger().error(str(error), throttle_duration_sec=1.0)
        try:
            self._report(goal, task, loop)
        except Exception as error:  # a report that fails must not leave the robot alone
            self.say(error, "a report failed")

    def _report(self, goal: Goal, task: _DockingTask, loop: ControlLoop) -> None:
        """What has happened since the last time."""
        step, now = task.step, self._now()
        if step is None:
            return
        while task.events:
            event = task.events.popleft()
            self.get_logger().info(f"{event.name}{event.detail and ': '}{event.detail}")
        said = (step.state, step.feedback.num_retries)
        is_new = said != task.said
        if is_new or time.monotonic() - task.told_at >= _TELL:
            task.said, task.told_at = said, time.monotonic()
            # Nav2 knows no state for what is done at rest: whoever plans or waits is still doing what he did.
            task.feedback = int(step.feedback.state) or task.feedback
            self._tell(goal, task.feedback, step.feedback.num_retries)
            docked = task.executor.dock
            self._reports.pose("dock_pose", task.plugin.stored_pose(docked), now)
            if task.measuring.detects:
                self._reports.pose("filtered_dock_pose", task.plugin.stored_pose(docked), now)
        if is_new or time.monotonic() - task.reported_at >= _REPORT:
            task.reported_at = time.monotonic()
            self._reports.state("ok", step.state.value, step, task.measuring.faults, loop.times, now)
        motion = task.planning.motion
        if motion is not None:
            self._reports.motion(motion, self._exempt(task), now)

    def _exempt(self, task: _DockingTask) -> str:
        """What no certificate of this task counts."""
        if task.local is None:
            return "any obstacle but the station's outline: controller.use_collision_detection is false"
        margin = self.settings.dock_parameters[task.plugin.name].contact_margin
        reach = contact_reach(task.local.costmap, margin)
        return f"cells of the costmap within {reach:.3f} m of the docked robot's front, which touches"

    def _tell(self, goal: Goal, state: int, retries: int) -> None:
        passed = Duration(nanoseconds=int(1e9 * (time.monotonic() - goal.began))).to_msg()
        goal.tell(state=state, docking_time=passed, num_retries=retries)

    def _refresh(self, task: _DockingTask, *, is_first: bool = False) -> None:
        """Hand over the costmaps as one picture in the fixed frame, where there is a new one.

        Raises:
            SurroundingsError: There is none, or it is too old to begin with.
            TransformError: Nobody knows where it stands.
        """
        topic = self._costmap
        if topic is None:
            return
        local, wide = topic.newest(), None if self._map is None else self._map.newest()
        timeout = self.settings.controller.costmap_timeout
        age = self._now() - local.stamp
        if is_first and age > timeout:
            raise SurroundingsError(f"{topic.topic}: the last costmap is {age:.2f} s old")
        if local is task.local and wide is task.wide:
            return
        executor = task.executor
        robot, docked = executor.robot or task.problem.start, executor.dock
        box = (
            min(robot.x, docked.x) - _AROUND, min(robot.y, docked.y) - _AROUND,
            max(robot.x, docked.x) + _AROUND, max(robot.y, docked.y) + _AROUND,
        )  # fmt: skip
        costmap = self._in_frame(local, box)
        if wide is not None:
            costmap = joined(self._in_frame(wide, box), costmap)
        task.local, task.wide = local, wide
        task.measuring.take_surroundings(DatedCostmap(costmap, local.stamp))

    def _in_frame(self, seen: StampedCostmap, box: Box) -> Costmap:
        """A costmap in the fixed frame; what of it is far from robot and dock is left out."""
        fixed = self.settings.own.fixed_frame
        if seen.frame.lstrip("/") == fixed.lstrip("/"):
            frame = Pose2(0.0, 0.0, 0.0)
        else:
            frame = self._frames.lookup(fixed, seen.frame).planar()
        return moved(seen.costmap, frame, box)

    def _switch_on(self, goal: Goal, plugin: DockPlugin) -> None:
        """Have the detector switched on, where the type of dock names its service.

        Raises:
            _Ended: It is not, or the goal is to end.
        """
        service = self._detectors.get(plugin.parameters.detector_service_name)
        if service is None:
            return
        timeout, answer = plugin.parameters.detector_service_timeout, None
        until = time.monotonic() + timeout
        while answer is None or not answer.done():
            self._check_end(goal)
            if time.monotonic() > until:
                why = "there is no such service" if answer is None else f"no answer within {timeout:g} s"
                fault = f"{service.srv_name}: the detector is not switched on: {why}"
                raise _Ended(failed(DockRobot.Result.FAILED_TO_DETECT_DOCK, fault))
            if answer is None and service.service_is_ready():
                answer = service.call_async(Trigger.Request())
            time.sleep(_LOOK)
        told = answer.result()
        if told is None or not told.success:
            fault = f"{service.srv_name}: the detector is not switched on: {told and told.message}"
            raise _Ended(failed(DockRobot.Result.FAILED_TO_DETECT_DOCK, fault))

    def _switch_off(self, plugin: DockPlugin) -> None:
        """As above; nobody waits for the answer, least of all a server that is being deactivated."""
        service = self._detectors.get(plugin.parameters.detector_service_name)
        if service is None:
            return
        what = f"{service.srv_name}: the detector is not switched off"

        def answered(answer: Future[Any]) -> None:
            told = answer.result()
            if told is None or not told.success:
                self.get_logger().error(f"{what}: {told and told.message}")

        if service.service_is_ready():
            service.call_async(Trigger.Request()).add_done_callback(answered)
        else:
            self.get_logger().error(f"{what}: there is no such service")

    @contextmanager
    def _detecting(self, goal: Goal, plugin: DockPlugin, measuring: Measuring) -> Iterator[None]:
        """The detector at work, messages on their way to where they are wanted.

        Raises:
            _Ended: It does not begin, or the goal is to end.
        """
        of_type, subscription = plugin.parameters, None
        self._measuring = measuring
        if measuring.detects:
            self._switch_on(goal, plugin)
            if of_type.subscribe_toggle:
                subscription = self.create_subscription(PoseStamped, _DETECTIONS, self._take_detection, 10)
        try:
            yield
        finally:
            self._measuring = None
            if subscription is not None:
                self.destroy_subscription(subscription)
            if measuring.detects:
                self._switch_off(plugin)

    def _seen_at_rest(self, goal: Goal, plugin: DockPlugin, settings: ExecutorSettings) -> Pose2:
        """Where the docked robot would stand, by what is seen before a robot turns its back to the dock.

        Raises:
            _Ended: It is not seen.
        """
        own = self.settings.own
        measuring = Measuring(self._rules(plugin), self._frames, plugin.detection, lambda _: None)
        seen: list[Pose2] = []
        with self._detecting(goal, plugin, measuring):
            until = time.monotonic() + settings.initial_perception_timeout
            enough = max(settings.least_detections, _LOOKS)
            while len(seen) < enough and time.monotonic() < until:
                self._check_end(goal)
                self._tell(goal, DockRobot.Feedback.INITIAL_PERCEPTION, 0)
                time.sleep(_LOOK)
                for detection in measuring.measurements(self._now()).detections:
                    with suppress(OptdockError):
                        robot = self._frames.lookup(own.fixed_frame, own.base_frame, detection.stamp).planar()
                        seen.append(robot @ detection.pose)
        if len(seen) < settings.least_detections:
            text = f"{len(seen)} detections in {settings.initial_perception_timeout:g} s {measuring.faults or ''}"
            raise _Ended(failed(DockRobot.Result.FAILED_TO_DETECT_DOCK, text))
        # The medians: some of them may be somewhere else altogether.
        first = seen[0]
        gaps = np.array([pose.in_frame_of(first).as_array() for pose in seen])
        return first @ Pose2(*np.median(gaps, axis=0).tolist())


@dataclass(eq=False)
class _DockingTask:
    """A task under way, and what was said of it."""

    goal: Goal
    plugin: DockPlugin
    problem: DockingProblem
    executor: DockingExecutor
    planning: _WatchedPlanning
    measuring: Measuring = field(init=False)
    step: Step | None = None
    events: deque[Event] = field(default_factory=deque)
    stalled: bool = False
    local: StampedCostmap | None = None
    wide: StampedCostmap | None = None
    said: tuple[State, int] | None = None
    feedback: int = DockRobot.Feedback.INITIAL_PERCEPTION
    told_at: float = -math.inf
    reported_at: float = -math.inf

    def observe(self, _: Measurements, step: Step) -> None:
        """What came of a cycle; in the control loop."""
        before, self.step = self.step, step
        self.events.extend(step.events)
        if before is None or step.state is not before.state or step.events:
            self.goal.changed.set()


def main() -> None:
    """The process."""
    sys.exit(run(lambda: DockingServer("docking_server")))
