"""The contract of controllers."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from optdock.errors import ControllerException, ControllerInvalidPath, InvalidValue
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.path import Direction, Path
from optdock.plugins.interfaces import Controller, GoalChecker, Tolerances
from optdock.testing.contracts.contract_scene import ORIGIN, ROBOT, scene_context, scene_problem
from optdock.testing.contracts.plugin import PluginContract
from optdock.testing.contracts.rules import refused, require
from optdock.testing.drives import cusp_drive, s_curve_drive, straight_drive

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from optdock.model.trajectory import Trajectory
    from optdock.plugins.lifecycle import PluginContext

__all__ = ["ControllerContract"]

_SLACK = 1.0 + 1e-6
_LIMIT_SLACK = 1.05  # of a speed limit: feedback may work on top of a reference that was slowed down
_FAR_DOCK = Pose2(50.0, 0.0, 0.0)  # out of the way of every drive here


class _TrackingRun(NamedTuple):
    """Commands of a run with perfect actuation, and where it ended."""

    commands: list[Twist2]
    pose: Pose2


class _Accepting(GoalChecker):
    """Says what it accepts, and never that the goal is reached."""

    tolerances = Tolerances()

    def __init__(self, accepted: Tolerances) -> None:
        super().__init__()
        self.tolerances = accepted

    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:  # noqa: ARG002 - the interface's
        return False


class ControllerContract(PluginContract[Controller]):
    """`optdock.plugins.interfaces.Controller`: turns a path or a trajectory into velocity commands.

    Attributes:
        period: Time between two commands [s], as their stamps say.
        cycles: Commands within which it arrives.
        stop_cycles: Commands within which `cancel` says True.
        arrival_tolerance: How near the end it comes without a goal checker [m].
        limits_acceleration: Commands change no faster than the robot can accelerate.
        settling: Commands that a new speed limit may take to show.
    """

    interface: ClassVar[type[Controller]] = Controller
    period: ClassVar[float] = 0.05
    cycles: ClassVar[int] = 240
    stop_cycles: ClassVar[int] = 100
    arrival_tolerance: ClassVar[float] = 0.05
    limits_acceleration: ClassVar[bool] = True
    settling: ClassVar[int] = 20

    def make_context(self) -> PluginContext:
        """A robot in the open: the dock is far away."""
        return scene_context(scene_problem(goal=_FAR_DOCK))

    def make_task(self) -> Path | Trajectory:
        """What to follow, forward, from the origin at yaw 0."""
        return s_curve_drive(ORIGIN)

    def exercise(self, plugin: Controller) -> object:
        """The first commands along the task, from a reset on."""
        plugin.reset()
        plugin.set_path(self.make_task())
        commands = self._drive(plugin, 40).commands
        plugin.reset()
        return tuple((command.linear, command.angular) for command in commands)

    def test_without_a_path_there_is_no_command(self) -> None:
        """`set_path`, `reset`: nothing to follow before the one and after the other: a ControllerException."""
        controller = self.ready_plugin()
        for _ in range(2):
            refused(
                lambda: controller.compute_velocity_commands(ORIGIN, Twist2(), None),
                ControllerException,
                "without a path there is no command",
            )
            controller.set_path(self.make_task())
            self._drive(controller, 3)
            controller.reset()

    def test_it_drives_to_the_end_within_the_limits(self) -> None:
        """`compute_velocity_commands`: the command of this cycle, one the robot can drive, until it is there."""
        task = self.make_task()
        controller = self.ready_plugin()
        controller.set_path(task)
        run = self._drive(controller, self.cycles)
        self._require_within_limits(run.commands)
        missed = run.pose.distance_to(_path_of(task).end)
        require(missed <= self.arrival_tolerance, f"it arrives within {self.arrival_tolerance} m, missed by {missed}")

    def test_a_reverse_gear_is_driven_or_refused(self) -> None:
        """`set_path`: ControllerInvalidPath where it cannot be followed; else it is driven backwards."""
        for task in (straight_drive(ORIGIN, Direction.REVERSE), cusp_drive(ORIGIN)):
            controller = self.ready_plugin()
            try:
                controller.set_path(task)
            except ControllerInvalidPath as error:
                require(str(error), "a refusal says why")
                continue
            run = self._drive(controller, self.cycles)
            self._require_within_limits(run.commands)
            require(min(command.linear for command in run.commands) < 0.0, "a reverse gear is driven backwards")
            missed = run.pose.distance_to(task.path.end)
            require(missed <= self.arrival_tolerance, f"it arrives in reverse too, missed by {missed} m")

    def test_a_goal_checker_may_measure_anything_or_nothing(self) -> None:
        """`goal_checker`: may be asked for its tolerances; each of them may be None."""
        for accepted in (Tolerances(), Tolerances(x=0.02, y=0.02, yaw=0.05)):
            controller, task = self.ready_plugin(), self.make_task()
            controller.set_path(task)
            run = self._drive(controller, self.cycles, _Accepting(accepted))
            missed = run.pose.distance_to(_path_of(task).end)
            require(missed <= self.arrival_tolerance, f"it arrives with a checker of {accepted}, missed by {missed} m")

    def test_paths_without_time_are_followed_too(self) -> None:
        """`set_path`: a path or a trajectory."""
        controller, path = self.ready_plugin(), _path_of(self.make_task())
        controller.set_path(path)
        missed = self._drive(controller, self.cycles).pose.distance_to(path.end)
        require(missed <= self.arrival_tolerance, f"a path is followed to its end, missed by {missed} m")

    def test_a_speed_limit_holds_until_it_is_removed(self) -> None:
        """`set_speed_limit`: percent of the maximum, or m/s, by place or by name; 0 removes the limit."""
        free, top = self._peak_after(lambda _: None), ROBOT.limits.max_speed
        slow = 0.4 * free
        by_speed = self._peak_after(lambda c: c.set_speed_limit(slow, False))  # noqa: FBT003 - as Nav2 writes it
        require(by_speed <= _LIMIT_SLACK * slow, f"a limit of {slow:.3f} m/s holds, got {by_speed:.3f} m/s")
        by_share = self._peak_after(lambda c: c.set_speed_limit(40.0, True))  # noqa: FBT003 - as Nav2 writes it
        require(by_share <= _LIMIT_SLACK * 0.4 * top, f"40 percent of {top} m/s hold, got {by_share:.3f} m/s")

        def limited_and_freed(controller: Controller) -> None:
            controller.set_speed_limit(slow, percentage=False)
            controller.set_speed_limit(0.0, percentage=False)

        require(self._peak_after(limited_and_freed) == free, "0 removes the limit")

    def test_a_speed_limit_is_a_number_that_is_not_negative(self) -> None:
        """`set_speed_limit`: only 0 removes the limit; what is not a speed is refused and nothing changes."""
        for percentage in (False, True):
            for bad in (math.nan, math.inf, -0.1):
                controller = self.ready_plugin()
                rule = f"a speed limit of {bad} is refused"
                refused(partial(controller.set_speed_limit, bad, percentage=percentage), InvalidValue, rule)
        for wrong in (50.0, None, "true"):
            call = partial(self.ready_plugin().set_speed_limit, 0.2, wrong)  # type: ignore[arg-type]
            refused(call, InvalidValue, f"percentage is a bool, not {wrong!r}")

    def test_cancelling_ends_in_a_stop(self) -> None:
        """`cancel`: a graceful stop: True when stopped; False to be asked again after more, slower, commands."""
        controller = self.ready_plugin()
        controller.set_path(self.make_task())
        run = self._drive(controller, 40)
        pose, twist, asked = run.pose, run.commands[-1], 0
        while not controller.cancel():
            asked += 1
            require(asked <= self.stop_cycles, f"cancel says True within {self.stop_cycles} commands")
            stamp = (39 + asked) * self.period
            command = controller.compute_velocity_commands(pose, twist, None, stamp=stamp)
            slower = abs(command.linear) <= max(abs(twist.linear), 0.02) * _SLACK
            require(slower, f"once cancelled it slows down, got {twist.linear} then {command.linear} m/s")
            pose, twist = pose.moved(command, self.period), command
        still = asked == 0 or (abs(twist.linear) <= 1e-3 and abs(twist.angular) <= 1e-2)
        require(still, f"cancel says True when stopped, the last command was {twist}")

    def test_a_cancelled_controller_takes_a_new_path(self) -> None:
        """`cancel`, `set_path`: follow this from now on, whatever was cancelled before."""
        controller = self.ready_plugin()
        controller.set_path(self.make_task())
        self._drive(controller, 5)
        controller.cancel()
        controller.reset()
        require(self.exercise(controller) == self.exercise(self.ready_plugin()), "a new path is followed as ever")

    def test_a_robot_that_is_lost_gets_a_named_failure_or_a_command(self) -> None:
        """`compute_velocity_commands`: NoValidControl or another ControllerException, never a foreign one."""
        for pose in (Pose2(30.0, 30.0, 3.0), Pose2(-2.0, 1.0, -3.1), Pose2(1.0, 0.3, 40.0)):
            controller = self.ready_plugin()
            controller.set_path(self.make_task())
            try:
                command = controller.compute_velocity_commands(pose, Twist2(), None)
            except ControllerException as error:
                require(str(error), f"a failure says why, at {pose}")
            else:
                self._require_within_limits([command])

    def _drive(self, controller: Controller, cycles: int, checker: GoalChecker | None = None) -> _TrackingRun:
        """A run from the origin with perfect actuation."""
        pose, twist, commands = ORIGIN, Twist2(), []
        for k in range(cycles):
            twist = controller.compute_velocity_commands(pose, twist, checker, stamp=k * self.period)
            pose = pose.moved(twist, self.period)
            commands.append(twist)
        return _TrackingRun(commands, pose)

    def _peak_after(self, prepare: Callable[[Controller], None]) -> float:
        controller = self.ready_plugin()
        controller.set_path(self.make_task())
        prepare(controller)
        return max(abs(command.linear) for command in self._drive(controller, self.cycles).commands[self.settling :])

    def _require_within_limits(self, commands: list[Twist2]) -> None:
        limits, before = ROBOT.limits, 0.0
        for command in commands:
            v, w = command.linear, command.angular
            top = limits.max_speed if v >= 0.0 else limits.max_reverse_speed
            require(abs(v) <= top * _SLACK, f"speed at most {top} m/s, got {v}")
            require(abs(w) <= limits.max_yaw_rate * _SLACK, f"yaw rate at most {limits.max_yaw_rate} rad/s, got {w}")
            most = max(limits.max_acceleration, limits.max_deceleration) * self.period
            change = abs(v - before)
            require(not self.limits_acceleration or change <= most * _SLACK, f"steps of {most} m/s, got {change}")
            before = v


def _path_of(task: Path | Trajectory) -> Path:
    return task if isinstance(task, Path) else task.path
