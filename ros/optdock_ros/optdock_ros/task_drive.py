"""The drive of one goal: the executor's task from the first look at the surroundings until the robot stands."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeVar

from nav2_msgs.action import DockRobot

from optdock.errors import InvalidMessage, OptdockError
from optdock.executor import DockingExecutor, EndingKind, PlanningProcess, State, ThreadPlanning
from optdock.executor.planning_scene import contact_reach
from optdock.geometry.pose import Pose2
from optdock_ros.control_loop import ControlLoop, TaskRun
from optdock_ros.docking_goals import UNKNOWN, Ended, GoalOutcome, failed
from optdock_ros.measuring import DatedCostmap, MeasurementRules, Measuring
from optdock_ros.merged_costmap import joined, moved
from optdock_ros.server import Server
from optdock_ros.surroundings import SurroundingsError, now

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor import Event, ExecutorSettings, Step
    from optdock.executor.planning import DrivenMotion, PlanResult
    from optdock.geometry.pose import Twist2
    from optdock.model.costmap import Costmap
    from optdock.model.measurements import Measurements
    from optdock.model.problem import DockingProblem
    from optdock.ros import StampedCostmap
    from optdock_ros.dock_database import Docks
    from optdock_ros.dock_plugins import DockPlugin
    from optdock_ros.docking_goals import Goal
    from optdock_ros.docking_parameters import DockingSettings
    from optdock_ros.docking_reports import Reports
    from optdock_ros.frame_lookup import TransformBuffer
    from optdock_ros.merged_costmap import Box
    from optdock_ros.navigator import Navigator
    from optdock_ros.robot_topics import RobotTopics

__all__ = ["LOOK", "STOPPING", "DockedAt", "DockingResources", "TaskDrive", "measurement_rules"]

T = TypeVar("T")

LOOK = 0.05  # [s] between two looks at costmaps, cancellations and what there is to report
_FIRST_MESSAGES = 2.0  # [s]: a costmap comes at 1 Hz at least, a footprint and transforms with it
_WARM = 60.0  # [s] for the planning process to start, once, on a slow computer
STOPPING = 2.0  # [s] beyond what braking takes, until a stop counts as failed, or a thread that ends as hanging
_TELL, _REPORT = 0.1, 0.5  # [s] between two feedbacks, and two reports on /diagnostics, where nothing changes
_PRESSES = (State.APPROACHING, State.PRESSING)
_AROUND = 3.0  # [m] around robot and dock: beyond, a map is not looked at


class DockedAt(NamedTuple):
    """Where the robot was docked last: in the fixed frame, the robot's pose; and the type of the dock."""

    pose: Pose2
    type_name: str


@dataclass(eq=False)
class DockingResources:
    """What goals are worked on with.

    Attributes:
        node: Its log and its clock.
        settings: The parameters, as they are now.
        docks: Types and places of docks.
        frames: Transforms.
        topics: What the robot does, feels and sees.
        planner: The process that plans.
        reports: What is told beside feedback.
        navigator: Brings the robot to staging poses; None: the executor does.
        send: Publishes a command.
        tidy: Answers waiting goals that were cancelled.
        docked: Where the robot was docked last; None: unknown.
        loop: The control loop of the last drive; None before the first.
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
    tidy: Callable[[], None]
    docked: DockedAt | None = None
    loop: ControlLoop | None = None

    def now(self) -> float:
        """The time of the node's clock [s]."""
        return now(self.node)

    def waited(self, goal: Goal, ask: Callable[[], T]) -> T:
        """What may come with the first messages.

        Raises:
            OptdockError: It has not come.
        """
        until = time.monotonic() + _FIRST_MESSAGES
        while True:
            self.check_end(goal)
            try:
                return ask()
            except OptdockError:
                if time.monotonic() > until:
                    raise
            time.sleep(LOOK)

    def check_end(self, goal: Goal) -> None:
        """End here where the goal is to end."""
        self.tidy()
        if goal.ending:
            raise Ended(goal.stopped())


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


class TaskDrive:
    """A task of the executor for one goal; the robot stands when it is made, and when it ends.

    Args:
        resources: What goals are worked on with.
        goal: That is worked on.
        plugin: The type of the dock.
        problem: Robot, dock and start.
        settings: Of the executor.
        what: The executor's task.

    Attributes:
        executor: Says where the dock is.
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
        self._resources, self._goal, self.plugin, self.problem = resources, goal, plugin, problem
        self._settings, self._topics = resources.settings, resources.topics
        self._planning = _WatchedPlanning(resources.planner)
        of_server, topics = resources.settings, resources.topics
        self.executor = DockingExecutor(
            problem,
            settings,
            task=what,
            controller=of_server.tracker,
            goal_checker=of_server.goal_checker,
            dock_type=of_server.dock_type(plugin),
            planning=self._planning,
        )
        self.measuring = Measuring(
            measurement_rules(of_server, plugin),
            resources.frames,
            plugin.detection if settings.use_detections else None,
            contact=self._contact,
            current=lambda now: plugin.current(topics.battery, now),
        )
        self._step: Step | None = None
        self._events: deque[Event] = deque()
        self._stalled = False
        self._local: StampedCostmap | None = None
        self._wide: StampedCostmap | None = None
        self._said: tuple[State, int] | None = None
        self._feedback: int = DockRobot.Feedback.INITIAL_PERCEPTION
        self._told_at = self._reported_at = -math.inf

    def _contact(self, now: float) -> bool | None:
        """Contact by a switch, and by the joints until the robot has stopped; None where neither is there."""
        plugin, state = self.plugin, self.executor.state
        switched = plugin.is_switched(self._topics.switches.get(plugin.contact_topic), now)
        if not plugin.parameters.use_stall_detection:
            return switched
        if state in _PRESSES:
            try:
                self._stalled = self._stalled or plugin.is_stalled(self._topics.joints, now)
            except InvalidMessage as error:
                self._resources.node.get_logger().error(str(error), throttle_duration_sec=5.0)
        elif state is not State.STOPPING:
            self._stalled = False
        return bool(switched) or self._stalled

    def run(self) -> GoalOutcome:
        """Drive; returns when the robot stands."""
        resources = self._resources
        try:
            with self._topics.detecting(self.plugin, self.measuring, lambda: resources.check_end(self._goal)):
                self._see_first()
                self._wait_for_planner()
                run = self._driven()
        finally:
            self._planning.close()
        ending = run.ending
        assert ending is not None
        if ending.kind is EndingKind.CANCELLED and self._goal.ending:
            return self._goal.stopped(ending.reason, ending.num_retries)
        missing = "; ".join(f"{name}: {why}" for name, why in self.measuring.faults.items())
        text = f"{ending.kind.value}{ending.reason and ': '}{ending.reason}"
        if not ending.kind.succeeded and missing:
            text += f" ({missing})"
        return GoalOutcome(ending.kind.succeeded, ending.kind.code, text, ending.num_retries)

    def _wait_for_planner(self) -> None:
        """Until the process that plans is warm, some seconds after configure.

        Raises:
            Ended: It does not start, or the goal is to end.
        """
        until = time.monotonic() + _WARM
        while not self._resources.planner.wait_until_warm(LOOK):
            self._resources.check_end(self._goal)
            if time.monotonic() > until:
                raise Ended(failed(UNKNOWN, "the planning process does not start"))

    def _driven(self) -> TaskRun:
        """The task, done; the robot stands, also where something fails here."""
        self._resources.check_end(self._goal)
        own, settings = self._settings.own, self._settings
        loop = self._resources.loop = ControlLoop(
            self.problem.robot,
            settings.period,
            self._resources.now,
            self._resources.send,
            realtime=own.use_realtime_priority,
        )
        run = TaskRun(self.executor, self.measuring.measurements, self._observe)
        self._goal.start(run)
        loop.start(run)
        try:
            while not run.done.is_set():
                self._goal.changed.wait(LOOK)
                self._goal.changed.clear()
                self._look_after(loop)
            self._look_after(loop)
        finally:
            loop.close("the thread of the goal has failed", STOPPING)  # nothing to do but then
        return run

    def _see_first(self) -> None:
        """Wait for the surroundings.

        Raises:
            Ended: There are none.
        """
        if self._topics.costmap is None:
            return
        try:
            self._resources.waited(self._goal, lambda: self._refresh(is_first=True))
        except OptdockError as error:
            raise Ended(failed(DockRobot.Result.FAILED_TO_CONTROL, str(error))) from error

    def _look_after(self, loop: ControlLoop) -> None:
        """Everything beside the control loop; nothing here may end the self._goal."""
        self._resources.tidy()
        try:
            self._refresh()
        except OptdockError as error:
            self._resources.node.get_logger().error(str(error), throttle_duration_sec=1.0)
        try:
            self._report(loop)
        except Exception as error:  # a report that fails must not leave the robot alone
            self._resources.node.say(error, "a report failed")

    def _report(self, loop: ControlLoop) -> None:
        """What has happened since the last time."""
        step, now = self._step, self._resources.now()
        if step is None:
            return
        while self._events:
            event = self._events.popleft()
            self._resources.node.get_logger().info(f"{event.name}{event.detail and ': '}{event.detail}")
        said = (step.state, step.feedback.num_retries)
        is_new = said != self._said
        if is_new or time.monotonic() - self._told_at >= _TELL:
            self._said, self._told_at = said, time.monotonic()
            # Nav2 has no state for what is done at rest: planning and waiting keep the state before.
            self._feedback = int(step.feedback.state) or self._feedback
            self._goal.tell_progress(self._feedback, step.feedback.num_retries)
            docked = self.executor.dock
            self._resources.reports.pose("dock_pose", self.plugin.stored_pose(docked), now)
            if self.measuring.detects:
                self._resources.reports.pose("filtered_dock_pose", self.plugin.stored_pose(docked), now)
        if is_new or time.monotonic() - self._reported_at >= _REPORT:
            self._reported_at = time.monotonic()
            self._resources.reports.state("ok", step.state.value, step, self.measuring.faults, loop.times, now)
        motion = self._planning.motion
        if motion is not None:
            self._resources.reports.motion(motion, self._exempt(), now)

    def _exempt(self) -> str:
        """What no certificate of this task counts."""
        if self._local is None:
            return "any obstacle but the station's outline: controller.use_collision_detection is false"
        margin = self._settings.dock_parameters[self.plugin.name].contact_margin
        reach = contact_reach(self._local.costmap, margin)
        return f"cells of the costmap within {reach:.3f} m of the docked robot's front, which touches"

    def _refresh(self, *, is_first: bool = False) -> None:
        """Hand over the costmaps as one picture in the fixed frame, where there is a new one.

        Raises:
            SurroundingsError: There is none, or it is too old to begin with.
            TransformError: There is no transform to its frame.
        """
        topic = self._topics.costmap
        if topic is None:
            return
        local, wide = (
            topic.newest(),
            None if self._topics.map is None else self._topics.map.newest(),
        )
        timeout = self._settings.controller.costmap_timeout
        age = self._resources.now() - local.stamp
        if is_first and age > timeout:
            raise SurroundingsError(f"{topic.topic}: the last costmap is {age:.2f} s old")
        if local is self._local and wide is self._wide:
            return
        executor = self.executor
        robot, docked = executor.robot or self.problem.start, executor.dock
        box = (
            min(robot.x, docked.x) - _AROUND, min(robot.y, docked.y) - _AROUND,
            max(robot.x, docked.x) + _AROUND, max(robot.y, docked.y) + _AROUND,
        )  # fmt: skip
        costmap = self._in_frame(local, box)
        if wide is not None:
            costmap = joined(self._in_frame(wide, box), costmap)
        self._local, self._wide = local, wide
        self.measuring.take_surroundings(DatedCostmap(costmap, local.stamp))

    def _in_frame(self, seen: StampedCostmap, box: Box) -> Costmap:
        """A costmap in the fixed frame; what of it is far from robot and dock is left out."""
        fixed = self._settings.own.fixed_frame
        if seen.frame.lstrip("/") == fixed.lstrip("/"):
            frame = Pose2(0.0, 0.0, 0.0)
        else:
            frame = self._resources.frames.lookup(fixed, seen.frame).planar()
        return moved(seen.costmap, frame, box)

    def _observe(self, _: Measurements, step: Step) -> None:
        """What came of a cycle; in the control loop."""
        before, self._step = self._step, step
        self._events.extend(step.events)
        if before is None or step.state is not before.state or step.events:
            self._goal.changed.set()


def measurement_rules(settings: DockingSettings, plugin: DockPlugin) -> MeasurementRules:
    """What the measurements for docks of a type are made of, and how old they may be."""
    own, controller = settings.own, settings.controller
    return MeasurementRules(
        own.fixed_frame,
        own.base_frame,
        controller.transform_tolerance,
        own.odom_duration,
        controller.costmap_timeout if controller.use_collision_detection else None,
        plugin.parameters.external_detection_timeout,
    )
