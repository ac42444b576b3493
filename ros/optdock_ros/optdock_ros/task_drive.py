"""The drive of a goal: an executor's task, from the first messages until the robot is at rest."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeVar

from nav2_msgs.action import DockRobot

from optdock.errors import InvalidMessage, OptdockError
from optdock.executor import DockingExecutor, EndingKind, PlanningProcess, State, ThreadPlanning
from optdock.executor.planning_scene import contact_reach
from optdock.geometry.pose import Pose2
from optdock_ros.control_loop import ControlLoop, TaskRun
from optdock_ros.frame_lookup import now
from optdock_ros.goal_queue import POLL, Ended, GoalOutcome, failed
from optdock_ros.measuring import MeasurementRules, Measuring
from optdock_ros.merged_costmap import joined, moved
from optdock_ros.robot_topics import BATTERY, JOINTS
from optdock_ros.surroundings import SurroundingsError

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor import Event, ExecutorSettings, Step
    from optdock.executor.planning import DrivenMotion, PlanResult
    from optdock.geometry.pose import Twist2
    from optdock.model.costmap import Costmap
    from optdock.model.measurements import Measurements
    from optdock.model.problem import DockingProblem
    from optdock.ros import StampedCostmap
    from optdock_ros.dock_plugins import DockPlugin
    from optdock_ros.docking_parameters import DockingSettings, Docks
    from optdock_ros.docking_reports import Reports
    from optdock_ros.frame_lookup import TransformBuffer
    from optdock_ros.goal_queue import Goal
    from optdock_ros.merged_costmap import Box
    from optdock_ros.navigator import Navigator
    from optdock_ros.robot_topics import RobotTopics
    from optdock_ros.server import Server

__all__ = ["STOPPING", "DockedAt", "DockingResources", "TaskDrive", "measurement_rules"]

T = TypeVar("T")

STOPPING = 2.0  # [s] in addition to the braking time, after which a stop has failed or a thread hangs
_FIRST_MESSAGES = 2.0  # [s] for the first costmap (1 Hz or more), footprint and transforms
_DISCOVERY = 10.0  # [s] that a new node may need on a busy computer to discover all publishers
_WARM = 60.0  # [s] for the start of the planning process on a slow computer
_FEEDBACK, _REPORT = 0.1, 0.5  # [s]: periods of feedback and /diagnostics while the state does not change
_PRESSES = (State.APPROACHING, State.PRESSING)
_AROUND = 3.0  # [m] around robot and dock: extent of the merged costmap


class DockedAt(NamedTuple):
    """Last docked pose of the robot in the fixed frame, and the dock type."""

    pose: Pose2
    type_name: str


@dataclass(eq=False)
class DockingResources:
    """The resources of the work on goals.

    Attributes:
        navigator: Client of `navigate_to_pose`; None if the executor drives to staging poses.
        send: Publishes a command.
        docked: Last docked pose; None if unknown.
        loop: Control loop of the last drive; None before the first one.
        started_at: Monotonic time at which all publishers have been discovered, even on a busy computer [s].
    """

    node: Server[DockingSettings]
    settings: DockingSettings
    docks: Docks
    frames: TransformBuffer
    topics: RobotTopics
    planner: PlanningProcess
    reports: Reports
    navigator: Navigator | None
    send: Callable[[Twist2], None]
    docked: DockedAt | None = None
    loop: ControlLoop | None = None
    started_at: float = field(default_factory=lambda: time.monotonic() + _DISCOVERY)

    def now(self) -> float:
        """Return the time of the node [s]."""
        return now(self.node)

    def waited(self, goal: Goal, ask: Callable[[], T]) -> T:
        """Return the result of `ask`; repeat the call while it raises `OptdockError` and the goal is active.

        The wait ends after 2 s, but not before 10 s after configure.
        """
        until = max(time.monotonic() + _FIRST_MESSAGES, self.started_at)
        while True:
            goal.check_end()
            try:
                return ask()
            except OptdockError:
                if time.monotonic() > until:
                    raise
            time.sleep(POLL)

    def in_fixed_frame(self, frame: str) -> Pose2:
        """Return the newest pose of a frame in the fixed frame, or raise `TransformError`."""
        return self.frames.lookup(self.settings.own.fixed_frame, frame).planar()


class _WatchedPlanning(ThreadPlanning):
    """Planning in another process that also stores the motion being driven."""

    def __init__(self, process: PlanningProcess) -> None:
        super().__init__(process.planned)
        self.motion: DrivenMotion | None = None

    def poll(self, stamp: float) -> PlanResult | None:
        """Return the result as `ThreadPlanning.poll` does, and store a new motion."""
        result = super().poll(stamp)
        if result is not None:
            self.motion = result.motion or self.motion
        return result


class TaskDrive:
    """A task `what` of the executor for one goal; the robot is at rest before and after it.

    Attributes:
        executor: The executor, which estimates the pose of the dock.
    """

    def __init__(
        self,
        resources: DockingResources,
        goal: Goal,
        plugin: DockPlugin,
        problem: DockingProblem,
        settings: ExecutorSettings,
        what: Literal["dock", "undock"],
    ) -> None:
        self._resources, self._goal, self._plugin, self._problem = resources, goal, plugin, problem
        self._settings, self._topics = resources.settings, resources.topics
        self._planning = _WatchedPlanning(resources.planner)
        self.executor = DockingExecutor(
            problem,
            settings,
            task=what,
            controller=self._settings.tracker,
            goal_checker=self._settings.goal_checker,
            dock_type=self._settings.dock_type(plugin),
            planning=self._planning,
        )
        self._measuring = Measuring(
            measurement_rules(self._settings, plugin),
            resources.frames,
            plugin.detection if settings.use_detections else None,
            contact=self._contact,
            current=lambda now: plugin.current(self._topics.newest(BATTERY), now),
        )
        self._step: Step | None = None
        self._events: deque[Event] = deque()
        self._stalled = False
        self._local: StampedCostmap | None = None
        self._wide: StampedCostmap | None = None
        self._state: tuple[State, int] | None = None
        self._feedback: int = DockRobot.Feedback.INITIAL_PERCEPTION
        self._feedback_at = self._reported_at = -math.inf

    def run(self) -> GoalOutcome:
        """Drive until the robot is at rest; raise `Ended` if the drive cannot begin."""
        try:
            with self._topics.detecting(self._plugin, self._measuring, self._goal):
                self._wait_for_surroundings()
                self._wait_for_planner()
                run = self._driven()
        finally:
            self._planning.close()
        ending = run.ending
        assert ending is not None
        if ending.kind is EndingKind.CANCELLED and self._goal.ending:
            return self._goal.stopped(ending.reason, ending.num_retries)
        missing = "; ".join(f"{name}: {why}" for name, why in self._measuring.faults.items())
        text = f"{ending.kind.value}{ending.reason and ': '}{ending.reason}"
        if not ending.kind.succeeded and missing:
            text += f" ({missing})"
        return GoalOutcome(ending.kind.succeeded, ending.kind.code, text, ending.num_retries)

    def _wait_for_surroundings(self) -> None:
        if self._topics.costmap is None:
            return
        try:
            self._resources.waited(self._goal, lambda: self._refresh(is_first=True))
        except OptdockError as error:
            raise Ended(failed(DockRobot.Result.FAILED_TO_CONTROL, str(error))) from error

    def _wait_for_planner(self) -> None:
        """Wait until the planning process is warm, some seconds after configure."""
        if not self._goal.waits_for(lambda: self._resources.planner.wait_until_warm(0.0), time.monotonic() + _WARM):
            raise Ended(failed(DockRobot.Result.UNKNOWN, "the planning process does not start"))

    def _driven(self) -> TaskRun:
        """Return the task after its end; the robot is at rest, even after an exception."""
        self._goal.check_end()
        settings = self._settings
        loop = self._resources.loop = ControlLoop(
            self._problem.robot,
            settings.period,
            self._resources.now,
            self._resources.send,
            realtime=settings.own.use_realtime_priority,
        )
        run = TaskRun(self.executor, self._measuring.measurements, self._observe)
        self._goal.on_end(run.stop)
        loop.start(run)
        try:
            while not run.done.is_set():
                self._goal.changed.wait(POLL)
                self._goal.changed.clear()
                self._look_after(loop)
            self._look_after(loop)
        finally:
            loop.close("the thread of the goal has failed", STOPPING)  # no effect unless an exception was raised
        return run

    def _observe(self, _: Measurements, step: Step) -> None:
        """Store the step of a cycle, in the thread of the control loop."""
        before, self._step = self._step, step
        self._events.extend(step.events)
        if before is None or step.state is not before.state or step.events:
            self._goal.changed.set()

    def _contact(self, now: float) -> bool | None:
        """Return the contact by a switch or, until the robot has stopped, by stalled joints; None without both."""
        plugin, state = self._plugin, self.executor.state
        switched = plugin.is_switched(self._topics.newest(plugin.contact_topic), now)
        if not plugin.parameters.use_stall_detection:
            return switched
        if state in _PRESSES:
            try:
                self._stalled = self._stalled or plugin.is_stalled(self._topics.newest(JOINTS), now)
            except InvalidMessage as error:
                self._resources.node.get_logger().error(str(error), throttle_duration_sec=5.0)
        elif state is not State.STOPPING:
            self._stalled = False
        return bool(switched) or self._stalled

    def _look_after(self, loop: ControlLoop) -> None:
        """Merge costmaps and report; no exception may end the drive."""
        node = self._resources.node
        try:
            self._refresh()
        except OptdockError as error:
            node.get_logger().error(str(error), throttle_duration_sec=1.0)
        try:
            self._report(loop)
        except Exception as error:
            node.log_error(error, "a report failed")

    def _report(self, loop: ControlLoop) -> None:
        step, time_now, reports = self._step, self._resources.now(), self._resources.reports
        if step is None:
            return
        while self._events:
            event = self._events.popleft()
            self._resources.node.get_logger().info(f"{event.name}{event.detail and ': '}{event.detail}")
        state = (step.state, step.feedback.num_retries)
        is_new = state != self._state
        if is_new or time.monotonic() - self._feedback_at >= _FEEDBACK:
            # Planning and waiting at rest have no state of Nav2: they keep the previous one, or begin another attempt.
            is_retry = self._state is not None and state[1] > self._state[1]
            kept = DockRobot.Feedback.RETRY if is_retry else self._feedback
            self._state, self._feedback_at = state, time.monotonic()
            self._feedback = int(step.feedback.state) or kept
            self._goal.publish_progress(self._feedback, step.feedback.num_retries)
            stored = self._plugin.stored_pose(self.executor.dock)
            reports.pose("dock_pose", stored, time_now)
            if self._measuring.detects:
                reports.pose("filtered_dock_pose", stored, time_now)
        if is_new or time.monotonic() - self._reported_at >= _REPORT:
            self._reported_at = time.monotonic()
            reports.state(step, self._measuring.faults, loop.times, time_now)
        if self._planning.motion is not None:
            reports.motion(self._planning.motion, self._exempt(), time_now)

    def _exempt(self) -> str:
        """Return a description of the obstacles that are excluded from the certificates of this task."""
        if self._local is None:
            return "any obstacle but the station's outline: controller.use_collision_detection is false"
        margin = self._settings.dock_parameters[self._plugin.name].contact_margin
        reach = contact_reach(self._local.costmap, margin)
        return f"cells of the costmap within {reach:.3f} m of the docked robot's front, which touches"

    def _refresh(self, *, is_first: bool = False) -> None:
        """Merge new costmaps in the fixed frame; raise if one is missing, has no transform, or is too old at first."""
        topic, wide_topic = self._topics.costmap, self._topics.map
        if topic is None:
            return
        local, wide = topic.newest(), None if wide_topic is None else wide_topic.newest()
        age = self._resources.now() - local.stamp
        if is_first and age > self._settings.controller.costmap_timeout:
            raise SurroundingsError(f"{topic.topic}: the last costmap is {age:.2f} s old")
        if local is self._local and wide is self._wide:
            return
        robot, docked = self.executor.robot or self._problem.start, self.executor.dock
        box = (
            min(robot.x, docked.x) - _AROUND, min(robot.y, docked.y) - _AROUND,
            max(robot.x, docked.x) + _AROUND, max(robot.y, docked.y) + _AROUND,
        )  # fmt: skip
        costmap = self._in_fixed_frame(local, box)
        if wide is not None:
            costmap = joined(self._in_fixed_frame(wide, box), costmap)
        self._local, self._wide = local, wide
        self._measuring.take_surroundings(costmap, local.stamp)

    def _in_fixed_frame(self, seen: StampedCostmap, box: Box) -> Costmap:
        """Return the part of a costmap in a box of the fixed frame."""
        is_same = seen.frame.lstrip("/") == self._settings.own.fixed_frame.lstrip("/")
        frame = Pose2(0.0, 0.0, 0.0) if is_same else self._resources.in_fixed_frame(seen.frame)
        return moved(seen.costmap, frame, box)


def measurement_rules(settings: DockingSettings, plugin: DockPlugin) -> MeasurementRules:
    """Return the rules of the measurements for a dock type."""
    own, controller = settings.own, settings.controller
    return MeasurementRules(
        own.fixed_frame,
        own.base_frame,
        controller.transform_tolerance,
        own.odom_duration,
        controller.costmap_timeout if controller.use_collision_detection else None,
        plugin.parameters.external_detection_timeout,
    )
