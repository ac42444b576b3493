"""Contracts of controllers, goal checkers, behaviors and dock types."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from optdock.errors import BehaviorException, ControllerException, ControllerInvalidPath, InvalidValue
from optdock.executor.checked_inputs import CheckedDockType
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.measurements import AtDock, Detection, Measurements
from optdock.model.path import Direction, Path
from optdock.plugins.interfaces import (
    Behavior,
    BehaviorResult,
    BehaviorStatus,
    Controller,
    CostmapInfoType,
    DockType,
    GoalChecker,
    PluginContext,
    Tolerances,
)
from optdock.testing.contracts.contract_scene import (
    GOAL,
    ORIGIN,
    ROBOT,
    free_costmap,
    room,
    room_costmap,
    scene_context,
    scene_problem,
)
from optdock.testing.contracts.plugin import PluginContract, attempted, refused, require
from optdock.testing.drives import cusp_drive, s_curve_drive, straight_drive

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from optdock.model.trajectory import Trajectory

__all__ = ["BehaviorContract", "ControllerContract", "DockTypeContract", "GoalCheckerContract"]

_REST = Twist2()
_FAR = 100.0  # [m]
_FAR_DOCK = Pose2(50.0, 0.0, 0.0)  # far from every drive of this module
_COMMAND_PERIOD, _CYCLES, _LIMITED_CYCLES, _STOP_CYCLES, _SETTLING = 0.05, 240, 60, 100, 20  # [s]; numbers of commands
_SLACK = 1.0 + 1e-6
_LIMIT_SLACK = 1.05  # factor on a speed limit: feedback may add to a reference that was slowed down
_BEHAVIOR_PERIOD, _BEHAVIOR_CYCLES = 0.1, 400  # [s]; number of cycles within which a behavior ends
_DOCK_PERIOD = 0.02  # [s]
_DISTANCES = (0.7, 1.5)  # [m]: Nav2's staging distance, and a distance for a robot with wide turns
_FARTHEST = 20.0  # [m]: largest distance of a staging pose from the dock
_DETECTION = Detection(0.0, Pose2(0.8, 0.05, 0.02), 0.003, 0.005)


class _UnreachedGoal(GoalChecker):
    """Goal checker with given tolerances that never reports arrival."""

    tolerances = Tolerances()

    def __init__(self, accepted: Tolerances) -> None:
        super().__init__()
        self.tolerances = accepted

    def is_goal_reached(self, query_pose: Pose2, goal_pose: Pose2, velocity: Twist2, path: Sequence[Pose2]) -> bool:  # noqa: ARG002 - the interface's
        return False


class ControllerContract(PluginContract[Controller]):
    """Rules of `optdock.plugins.interfaces.Controller`, with perfect actuation at 20 Hz.

    Attributes:
        arrival_tolerance: Largest accepted distance from the end of the path if there is no goal checker [m].
    """

    interface: ClassVar[type[Controller]] = Controller
    arrival_tolerance: ClassVar[float] = 0.05

    def make_context(self) -> PluginContext:
        """Return a context without obstacles near the drives."""
        return scene_context(scene_problem(goal=_FAR_DOCK))

    def exercise(self, plugin: Controller) -> object:
        """Return the first commands along an S-shaped path, after a reset."""
        plugin.reset()
        plugin.set_path(s_curve_drive(ORIGIN))
        commands, _ = self._drive(plugin, 10)
        plugin.reset()
        return tuple((command.linear, command.angular) for command in commands)

    def test_without_a_path_there_is_no_command(self) -> None:
        """`set_path`, `reset`: a command raises ControllerException before `set_path` and after `reset`."""
        controller = self.ready_plugin()
        call = partial(controller.compute_velocity_commands, ORIGIN, _REST, None)
        for _ in range(2):
            refused(call, ControllerException, "there is no command without a path")
            controller.set_path(s_curve_drive(ORIGIN))
            self._drive(controller, 3)
            controller.reset()

    def test_it_drives_to_the_end_within_the_limits(self) -> None:
        """`compute_velocity_commands`: a trajectory or a path is driven to its end, with or without a goal checker."""
        task = s_curve_drive(ORIGIN)
        accepted = _UnreachedGoal(Tolerances()), _UnreachedGoal(Tolerances(x=0.02, y=0.02, yaw=0.05))
        runs: list[tuple[Path | Trajectory, GoalChecker | None]] = [(task, None), (task.path, accepted[0])]
        for follow, checker in (*runs, (task, accepted[1])):
            self._require_arrival(self._drive(self._following(follow), _CYCLES, checker), task.path.end)

    def test_a_reverse_gear_is_driven_or_refused(self) -> None:
        """`set_path`: a path in reverse is driven to its end or refused by ControllerInvalidPath with a reason."""
        for task in (straight_drive(ORIGIN, Direction.REVERSE), cusp_drive(ORIGIN)):
            controller = attempted(partial(self._following, task), ControllerInvalidPath)
            if controller is not None:
                run = self._drive(controller)
                require(min(command.linear for command in run[0]) < 0.0, "a reverse gear is driven backwards")
                self._require_arrival(run, task.path.end)

    def test_a_speed_limit_holds_until_it_is_removed(self) -> None:
        """`set_speed_limit`: limits are in percent or m/s, 0 removes the limit, and wrong values raise InvalidValue."""
        free, top = self._peak_after(lambda _: None), ROBOT.limits.max_speed
        slow = 0.4 * free
        by_speed = self._peak_after(lambda c: c.set_speed_limit(slow, False))  # noqa: FBT003 - as in Nav2
        require(by_speed <= _LIMIT_SLACK * slow, f"a limit of {slow:.3f} m/s holds, got {by_speed:.3f} m/s")
        by_share = self._peak_after(lambda c: c.set_speed_limit(40.0, True))  # noqa: FBT003 - as in Nav2
        require(by_share <= _LIMIT_SLACK * 0.4 * top, f"40 percent of {top} m/s hold, got {by_share:.3f} m/s")

        def limited_and_freed(controller: Controller) -> None:
            controller.set_speed_limit(slow, percentage=False)
            controller.set_speed_limit(0.0, percentage=False)

        require(self._peak_after(limited_and_freed) == free, "0 removes the limit")
        wrong: list[tuple[float, object]] = [(0.2, 50.0), (0.2, None), (0.2, "true")]
        wrong += [(bad, percentage) for bad in (math.nan, math.inf, -0.1) for percentage in (False, True)]
        for limit, percentage in wrong:
            call = partial(self.ready_plugin().set_speed_limit, limit, percentage)  # type: ignore[arg-type]
            refused(call, InvalidValue, f"set_speed_limit({limit}, {percentage!r}) is refused")

    def test_cancelling_ends_in_a_stop(self) -> None:
        """`cancel`: the result is False during deceleration and True at rest; then a new path can be driven."""
        controller = self._following(s_curve_drive(ORIGIN))
        commands, pose = self._drive(controller, 40)
        twist, asked = commands[-1], 0
        while not controller.cancel():
            asked += 1
            require(asked <= _STOP_CYCLES, f"cancel returns True within {_STOP_CYCLES} commands")
            stamp = (39 + asked) * _COMMAND_PERIOD
            command = controller.compute_velocity_commands(pose, twist, None, stamp=stamp)
            slower = abs(command.linear) <= max(abs(twist.linear), 0.02) * _SLACK
            require(slower, f"a cancelled drive becomes slower, got {twist.linear}, then {command.linear} m/s")
            pose, twist = pose.moved(command, _COMMAND_PERIOD), command
        still = asked == 0 or (abs(twist.linear) <= 1e-3 and abs(twist.angular) <= 1e-2)
        require(still, f"cancel returns True at rest, but the last command was {twist}")
        controller.reset()
        require(
            self.exercise(controller) == self.exercise(self.ready_plugin()),
            "a new path is followed as by a new controller",
        )

    def test_a_robot_far_from_its_path_gets_an_error_or_a_command(self) -> None:
        """`compute_velocity_commands`: the call returns a command within the limits or raises a ControllerException."""
        for pose in (Pose2(30.0, 30.0, 3.0), Pose2(-2.0, 1.0, -3.1), Pose2(1.0, 0.3, 40.0)):
            controller = self._following(s_curve_drive(ORIGIN))
            call = partial(controller.compute_velocity_commands, pose, _REST, None)
            command = attempted(call, ControllerException)
            _require_within_limits([] if command is None else [command])

    def _following(self, task: Path | Trajectory) -> Controller:
        controller = self.ready_plugin()
        controller.set_path(task)
        return controller

    @staticmethod
    def _drive(
        controller: Controller, cycles: int = _CYCLES, checker: GoalChecker | None = None
    ) -> tuple[list[Twist2], Pose2]:
        """Return commands and last pose of a run from the origin."""
        pose, twist, commands = ORIGIN, _REST, []
        for k in range(cycles):
            twist = controller.compute_velocity_commands(pose, twist, checker, stamp=k * _COMMAND_PERIOD)
            pose = pose.moved(twist, _COMMAND_PERIOD)
            commands.append(twist)
        return commands, pose

    def _peak_after(self, prepare: Callable[[Controller], None]) -> float:
        controller = self._following(s_curve_drive(ORIGIN))
        prepare(controller)
        return max(abs(command.linear) for command in self._drive(controller, _LIMITED_CYCLES)[0][_SETTLING:])

    def _require_arrival(self, run: tuple[list[Twist2], Pose2], end: Pose2) -> None:
        commands, pose = run
        _require_within_limits(commands)
        missed = pose.distance_to(end)
        require(
            missed <= self.arrival_tolerance, f"the robot arrives within {self.arrival_tolerance} m, got {missed} m"
        )


def _require_within_limits(commands: list[Twist2]) -> None:
    limits, before = ROBOT.limits, 0.0
    most = max(limits.max_acceleration, limits.max_deceleration) * _COMMAND_PERIOD
    for command in commands:
        v, w = command.linear, command.angular
        top = limits.max_speed if v >= 0.0 else limits.max_reverse_speed
        require(abs(v) <= top * _SLACK, f"speed at most {top} m/s, got {v}")
        require(abs(w) <= limits.max_yaw_rate * _SLACK, f"yaw rate at most {limits.max_yaw_rate} rad/s, got {w}")
        require(abs(v - before) <= most * _SLACK, f"speed changes of at most {most} m/s, got {v - before}")
        before = v


def _remaining(length: float, goal: Pose2 = GOAL) -> list[Pose2]:
    """Return a straight remaining path of `length` [m] that ends at the goal."""
    return [goal @ Pose2(-length * share, 0.0, 0.0) for share in (1.0, 0.5, 0.0)]


class GoalCheckerContract(PluginContract[GoalChecker]):
    """Rules of `optdock.plugins.interfaces.GoalChecker`."""

    interface: ClassVar[type[GoalChecker]] = GoalChecker

    def exercise(self, plugin: GoalChecker) -> object:
        """Return the verdicts of all queries, after a reset."""
        plugin.reset()
        return tuple(plugin.is_goal_reached(*query) for query in self.queries())

    def queries(self, motion: Pose2 | None = None) -> Iterator[tuple[Pose2, Pose2, Twist2, list[Pose2]]]:
        """Yield 60 random query poses near the goal, with goal, velocity and path, all transformed by `motion`."""
        draw, goal = np.random.default_rng(5), (motion or Pose2(0.0, 0.0, 0.0)) @ GOAL
        for _ in range(60):
            dx, dy, turn = draw.normal(size=3) * (0.2, 0.2, 0.3)
            v, w, length = draw.choice([0.0, 0.3]), draw.choice([0.0, 0.3]), draw.choice([0.0, 0.2, 0.6])
            yield goal @ Pose2(dx, dy, turn), goal, Twist2(v, w), _remaining(length, goal) if length else []

    def test_a_robot_at_rest_at_the_goal_has_arrived(self) -> None:
        """`is_goal_reached`: the result at the goal is True for an empty path, a single pose, and repeated poses."""
        paths: list[Sequence[Pose2]] = [[GOAL] * count for count in (0, 1, 5)]
        paths += [[GOAL @ Pose2(1e-12, 0.0, 0.0), GOAL], _remaining(1e-9), _remaining(0.05), tuple(_remaining(0.05))]
        for path in paths:
            reached = self.ready_plugin().is_goal_reached(GOAL, GOAL, _REST, path)
            require(
                reached is True, f"a robot at rest at the goal has arrived (path of {len(path)} poses), got {reached}"
            )

    def test_a_robot_elsewhere_has_not_arrived(self) -> None:
        """`is_goal_reached`: the result is False at 100 m, with a longer remaining path, or turned by 90 degrees."""
        accepted = self.ready_plugin().tolerances
        for angle in np.arange(8) * math.pi / 4.0:
            query = GOAL @ Pose2(_FAR * math.cos(angle), _FAR * math.sin(angle), 0.0)
            for path in ([], [GOAL], _remaining(0.05)):
                self._require_not_reached(query, path, f"100 m away at {angle:.2f} rad")
        if accepted.path_length is not None:
            longer = _remaining(1.01 * accepted.path_length + 0.01)
            self._require_not_reached(GOAL, longer, f"more than {accepted.path_length} m remain")
        if accepted.yaw is not None and accepted.yaw < 0.5 * math.pi:
            for turn in (0.5 * math.pi, -0.5 * math.pi):
                self._require_not_reached(GOAL @ Pose2(0.0, 0.0, turn), [], f"turned by {turn:.2f} rad")

    def test_tolerances_are_numbers_or_none(self) -> None:
        """`tolerances`: every value is finite and not negative, or None if the quantity is not checked."""
        found = self.ready_plugin().tolerances
        require(isinstance(found, Tolerances), f"tolerances are Tolerances, got {type(found).__name__}")
        for name, value in found._asdict().items():
            require(value is None or (math.isfinite(value) and value >= 0.0), f"tolerances.{name}, got {value}")
        require((found.x is None) == (found.y is None), "a position is checked along both axes or not at all")

    def test_verdicts_are_booleans_and_inputs_stay(self) -> None:
        """`is_goal_reached`, `is_goal_xy_reached`: results are bool; on arrival, the position is also reached."""
        checker = self.ready_plugin()
        for query, goal, velocity, path in self.queries():
            checker.reset()
            given = list(path)
            reached = checker.is_goal_reached(query, goal, velocity, path)
            require(path == given, "the path is not changed")
            in_position = checker.is_goal_xy_reached(query, goal, velocity, path)
            for verdict in (reached, in_position):
                require(isinstance(verdict, bool), f"the verdict is a bool, got {type(verdict).__name__}")
            require(in_position or not reached, f"a robot that has arrived is in position, at {query}")

    def test_reset_clears_every_latch(self) -> None:
        """`reset`: after a reset, the verdicts are those of a new checker."""
        checker, verdicts = self.ready_plugin(), self.exercise(self.ready_plugin())
        checker.is_goal_reached(GOAL, GOAL, _REST, [])
        checker.reset()
        far = checker.is_goal_reached(GOAL @ Pose2(-_FAR, 0.0, 0.0), GOAL, _REST, [])
        require(far is False, "an arrival before a reset has no effect")
        require(self.exercise(checker) == verdicts, "after a reset the verdicts are those of a new checker")

    def test_the_origin_of_the_frame_has_no_influence(self) -> None:
        """`is_goal_reached`: the verdicts stay the same if the same rigid motion is applied to all poses."""
        for motion in (Pose2(2.0, -1.0, 0.7), Pose2(0.0, 0.0, 2.0 * math.pi)):
            here, there = self.ready_plugin(), self.ready_plugin()
            for query, moved in zip(self.queries(), self.queries(motion), strict=True):
                verdicts = here.is_goal_reached(*query), there.is_goal_reached(*moved)
                require(
                    verdicts[0] == verdicts[1], f"the verdict of {query[0]} does not change under the motion {motion}"
                )

    def _require_not_reached(self, query: Pose2, path: Sequence[Pose2], why: str) -> None:
        reached = self.ready_plugin().is_goal_reached(query, GOAL, _REST, path)
        require(reached is False, f"not reached: {why}")


class _ScriptedRobot:
    """Clock and robot; the robot follows its commands exactly, or does not move if it is `stuck`."""

    def __init__(self, context: PluginContext, *, stuck: bool = False) -> None:
        self.time, self.pose, self.twist, self.stuck = 100.0, ORIGIN, _REST, stuck
        self.context = dataclasses.replace(context, clock=lambda: self.time)
        self.commands: list[Twist2] = []

    def step(self, behavior: Behavior) -> BehaviorResult:
        """Run one cycle of the behavior and execute its command."""
        result, command = behavior.on_cycle_update(self.pose, self.twist)
        self.commands.append(command)
        self.time += _BEHAVIOR_PERIOD
        if not self.stuck:
            self.pose, self.twist = self.pose.moved(command, _BEHAVIOR_PERIOD), command
        return result


class BehaviorContract(PluginContract[Behavior]):
    """Rules of `optdock.plugins.interfaces.Behavior`.

    Attributes:
        command: Command that succeeds in open space.
        bad_commands: Commands that violate a rule.
        invalid_code: Nav2's error code for bad commands.
        timed_command: `command` with a time allowance that a stuck robot exceeds; None: the behavior has no allowance.
        timeout_code: Nav2's error code for an exceeded allowance.
        blocked_code: Nav2's error code in the narrow `room`; None: the behavior does not check collisions.
    """

    interface: ClassVar[type[Behavior]] = Behavior
    command: ClassVar[Mapping[str, object]] = {}
    bad_commands: ClassVar[tuple[Mapping[str, object], ...]] = ({"no such thing": 1},)
    invalid_code: ClassVar[int] = 0
    timed_command: ClassVar[Mapping[str, object] | None] = None
    timeout_code: ClassVar[int] = 0
    blocked_code: ClassVar[int | None] = None

    def exercise(self, plugin: Behavior) -> object:
        """Return the results of `on_run` and of the first cycle.

        Raises:
            BehaviorException: If `on_run` fails.
        """
        begun = plugin.on_run(self.command)
        if begun.status is not BehaviorStatus.SUCCEEDED:
            raise BehaviorException(begun.error_msg)
        result, twist = plugin.on_cycle_update(ORIGIN, _REST)
        return begun, result, (twist.linear, twist.angular)

    def test_it_names_its_costmaps_and_needs_on_run(self) -> None:
        """`resource_info`, `on_run`: costmaps are known before `configure`, and a cycle requires a started run."""
        found = self.make_plugin().resource_info
        require(isinstance(found, CostmapInfoType), f"resource_info is a CostmapInfoType, got {found!r}")
        self._require_no_cycle(self.ready_plugin(), "there is no cycle before on_run")

    def test_it_runs_and_ends_at_rest(self) -> None:
        """`on_cycle_update`: the status is RUNNING, then SUCCEEDED with a stop; a second run has the same commands."""
        behavior, world = self._begun(self.make_context())
        result = self._run(behavior, world)
        require(result.status is BehaviorStatus.SUCCEEDED, f"the command succeeds in open space, got {result}")
        require((result.error_code, result.error_msg) == (0, ""), f"a success has no error, got {result}")
        require(world.commands[-1] == _REST, f"the last command is a stop, got {world.commands[-1]}")
        first, world.commands, world.pose, world.twist = world.commands, [], ORIGIN, _REST
        require(
            behavior.on_run(self.command).status is BehaviorStatus.SUCCEEDED,
            "the behavior can be started a second time",
        )
        self._run(behavior, world)
        require(world.commands == first, "the second run has the same commands as the first")

    def test_a_bad_command_is_refused_with_its_code(self) -> None:
        """`on_run`: a bad command gives FAILED with code and message, raises nothing, and ends an earlier run."""
        numbers = [name for name, value in self.command.items() if isinstance(value, float)]
        not_finite = [{**self.command, name: bad} for name in numbers for bad in (math.nan, math.inf, -math.inf)]
        for bad in (*self.bad_commands, {**self.command, "no such thing": 1}, *not_finite):
            behavior, world = self._begun(self.make_context())
            world.step(behavior)
            self._require_failure(behavior.on_run(bad), self.invalid_code, f"the command {bad}")
            self._require_no_cycle(behavior, f"there is no cycle after the refused command {bad}")
            self._require_failure(self.ready_plugin().on_run(bad), self.invalid_code, f"the first command {bad}")

    def test_it_gives_up_after_its_time_allowance(self) -> None:
        """`on_cycle_update`: if the robot is stuck, a timed behavior stops and fails with its code."""
        if self.timed_command is not None:
            behavior, world = self._begun(self.make_context(), self.timed_command, stuck=True)
            self._require_failure(self._run(behavior, world), self.timeout_code, "a stuck robot")
            require(world.commands[-1] == _REST, f"the last command is a stop, got {world.commands[-1]}")

    def test_it_does_not_drive_into_obstacles(self) -> None:
        """`on_cycle_update`: a behavior that checks for collisions stops in front of obstacles or does not start."""
        if self.blocked_code is not None:
            result, world = self._tried(scene_context(scene_problem(goal=_FAR_DOCK, obstacles=room())))
            self._require_failure(result, self.blocked_code, "a blocked motion")
            require(world.commands[-1:] in ([], [_REST]), f"the last command is a stop, got {world.twist}")

    def test_it_reads_the_costmap_that_it_names(self) -> None:
        """`resource_info`: the behavior reads the named costmaps (LOCAL, GLOBAL, BOTH, NONE) and no others."""
        if self.blocked_code is None:
            return
        needs, walls, free = self.make_plugin().resource_info, room_costmap(), free_costmap()
        for asked, local, around in ((CostmapInfoType.LOCAL, walls, free), (CostmapInfoType.GLOBAL, free, walls)):
            result, _ = self._tried(PluginContext("contract", around, ROBOT.footprint, local_costmap=local))
            stopped = result.status is BehaviorStatus.FAILED
            require(
                stopped == bool(needs & asked), f"{needs.name}, with walls in the {asked.name} costmap: got {result}"
            )

    def _begun(
        self, context: PluginContext, command: Mapping[str, object] | None = None, *, stuck: bool = False
    ) -> tuple[Behavior, _ScriptedRobot]:
        behavior, world = self.make_plugin(), _ScriptedRobot(context, stuck=stuck)
        behavior.configure(world.context)
        behavior.activate()
        begun = behavior.on_run(self.command if command is None else command)
        require(begun.status is BehaviorStatus.SUCCEEDED, f"a good command is accepted, got {begun}")
        return behavior, world

    def _tried(self, context: PluginContext) -> tuple[BehaviorResult, _ScriptedRobot]:
        """Return the last result of `command` in a context, from `on_run` or from a cycle."""
        behavior, world = self.make_plugin(), _ScriptedRobot(context)
        behavior.configure(world.context)
        begun = behavior.on_run(self.command)
        return self._run(behavior, world) if begun.status is BehaviorStatus.SUCCEEDED else begun, world

    def _run(self, behavior: Behavior, world: _ScriptedRobot) -> BehaviorResult:
        for _ in range(_BEHAVIOR_CYCLES):
            result = world.step(behavior)
            require(
                isinstance(result, BehaviorResult), f"a cycle returns a BehaviorResult, got {type(result).__name__}"
            )
            if result.status is not BehaviorStatus.RUNNING:
                return result
        require(holds=False, rule=f"the behavior ends within {_BEHAVIOR_CYCLES} cycles")
        raise AssertionError

    @staticmethod
    def _require_failure(result: BehaviorResult, code: int, what: str) -> None:
        require(result.status is BehaviorStatus.FAILED, f"{what} fails, got {result}")
        require(result.error_code == code, f"{what} has the code {code}, got {result}")
        require(result.error_msg, f"{what} has a message")

    def _require_no_cycle(self, behavior: Behavior, rule: str) -> None:
        refused(lambda: behavior.on_cycle_update(ORIGIN, _REST), BehaviorException, rule)


class DockTypeContract(PluginContract[DockType]):
    """Rules of `optdock.plugins.interfaces.DockType`; the types of all results are checked by `CheckedDockType`."""

    interface: ClassVar[type[DockType]] = DockType

    def exercise(self, plugin: DockType) -> object:
        """Return all results of an approach that ends in contact, after a reset."""
        plugin.reset()
        contacts = tuple((plugin.contact(now), plugin.is_charging(now.measurements)) for now in self.approach())
        detections = tuple(tuple(plugin.detections(measurements)) for measurements in self.sightings())
        staging = tuple(tuple(plugin.staging_poses(gear, far)) for gear in (1.0, -1.0) for far in _DISTANCES)
        return contacts, detections, staging, plugin.is_pressed_on, plugin.waits_for_charge, plugin.back_out_distance

    def approach(self) -> Iterator[AtDock]:
        """Yield the cycles of an approach: half a metre, pressing for a second, then a contact signal at rest.

        Override this method if contact is detected in a different way.
        """
        stamp = 0.0
        for cycle in range(350):
            stamp += _DOCK_PERIOD
            x = min(-0.5 + 0.1 * stamp, 0.0)
            commanded = Twist2(0.1) if cycle < 300 else _REST
            twist = Twist2(0.1) if x < 0.0 else _REST
            signal = True if cycle >= 310 else None
            pose = GOAL @ Pose2(x, 0.0, 0.0)
            measurements = Measurements(stamp, pose, twist, (), signal, current=3.0 * bool(signal))
            yield AtDock(stamp, measurements, commanded, Pose2(x, 0.0, 0.0), -x <= 0.05)

    def sightings(self) -> Iterator[Measurements]:
        """Yield measurements with no detection, one detection, and two detections out of order."""
        for found in ((), (_DETECTION,), (_DETECTION._replace(stamp=0.1), _DETECTION)):
            yield Measurements(0.2, GOAL @ Pose2(-0.8, 0.0, 0.0), Twist2(0.1), found)

    def test_results_have_the_right_types_in_every_cycle(self) -> None:
        """`contact`, `is_charging`, properties: the types are right for all sensor values and repeated stamps."""
        checked, far = CheckedDockType(self.ready_plugin()), Pose2(-3.0, 0.2, 0.1)
        for now in self.approach():
            checked.contact(now)
            checked.contact(now)
            flags = checked.is_pressed_on, checked.waits_for_charge, checked.is_charging(now.measurements)
            require(checked.back_out_distance > 0.0, f"back_out_distance is positive, with {flags}")
        for signal in (None, False, True):
            for current in (None, -1.0, 0.0, 30.0):
                for commanded in (_REST, Twist2(-0.3, 0.5)):
                    measurements = Measurements(9.0, None, contact=signal, current=current)
                    checked.contact(AtDock(9.0, measurements, commanded, far, is_near=False))
                    checked.is_charging(measurements)

    def test_a_robot_far_away_without_a_signal_has_no_contact(self) -> None:
        """`contact`: the result is None far from the dock if there is no signal."""
        plugin = self.ready_plugin()
        plugin.reset()
        for cycle in range(100):
            measurements = Measurements(cycle * _DOCK_PERIOD, Pose2(0.0, 0.0, 0.0))
            now = AtDock(cycle * _DOCK_PERIOD, measurements, _REST, Pose2(-3.0, 0.0, 0.0), is_near=False)
            found = plugin.contact(now)
            require(found is None, f"there is no contact at rest 3 m before the dock without a signal, got {found}")

    def test_a_reset_clears_the_contact(self) -> None:
        """`reset`: the results of an approach do not depend on earlier approaches."""
        plugin, whole = self.ready_plugin(), list(self.approach())
        plugin.reset()
        expected = [plugin.contact(now) for now in whole]
        for cut in (1, 290, len(whole)):
            plugin.reset()
            for now in whole[:cut]:
                plugin.contact(now)
            plugin.reset()
            found = [plugin.contact(now) for now in whole]
            require(found == expected, f"after {cut} cycles and a reset the results are those of the first approach")

    def test_staging_poses_are_outside_the_dock(self) -> None:
        """`staging_poses`: either gear has at least one pose; none is at the docked pose or more than 20 m away."""
        checked = CheckedDockType(self.ready_plugin())
        for gear in (1.0, -1.0):
            for distance in _DISTANCES:
                for pose in checked.staging_poses(gear, distance):
                    far = math.hypot(pose.x, pose.y)
                    require(
                        0.0 < far <= _FARTHEST,
                        f"staging poses are outside the dock, at most {_FARTHEST} m away, got {pose}",
                    )

    def test_detections_come_from_detections(self) -> None:
        """`detections`: there are at most as many as measured detections, each with the stamp of a measured one."""
        checked = CheckedDockType(self.ready_plugin())
        for measurements in self.sightings():
            given, found = measurements.detections, checked.detections(measurements)
            require(
                len(found) <= len(given),
                f"at most {len(given)} detections are returned, got {len(found)}",
            )
            stamps = {one.stamp for one in given}
            require(all(one.stamp in stamps for one in found), f"a detection keeps its stamp, got {found}")
