"""The contract of behaviors."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, ClassVar

from optdock.errors import BehaviorException
from optdock.geometry.pose import Pose2, Twist2
from optdock.plugins.interfaces import Behavior, BehaviorResult, BehaviorStatus, CostmapInfoType, PluginContext
from optdock.testing.contracts.contract_scene import (
    ORIGIN,
    ROBOT,
    free_costmap,
    room,
    room_costmap,
    scene_context,
    scene_problem,
)
from optdock.testing.contracts.plugin import PluginContract
from optdock.testing.contracts.rules import refused, require

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["BehaviorContract"]

_REST = Twist2()


class _ScriptedRobot:
    """A clock, and a robot that does what it is told, or stands where it is `stuck`."""

    def __init__(self, context: PluginContext, pose: Pose2, *, stuck: bool = False) -> None:
        self.time, self.pose, self.twist, self.stuck = 100.0, pose, _REST, stuck
        self.context = dataclasses.replace(context, clock=lambda: self.time)
        self.commands: list[Twist2] = []

    def step(self, behavior: Behavior, period: float) -> BehaviorResult:
        """One cycle: ask, then drive."""
        result, command = behavior.on_cycle_update(self.pose, self.twist)
        self.commands.append(command)
        self.time += period
        if not self.stuck:
            self.pose, self.twist = self.pose.moved(command, period), command
        return result


class BehaviorContract(PluginContract[Behavior]):
    """`optdock.plugins.interfaces.Behavior`: a timed recovery or auxiliary motion.

    Attributes:
        command: One that succeeds in the open, for a robot at `start`.
        bad_commands: Such that cannot be understood or break a rule.
        invalid_code: Nav2's error code for them.
        timed_command: As `command`, with a time allowance that a robot that is stuck exceeds; None: it has none.
        timeout_code: Nav2's error code for that.
        blocked_code: Nav2's error code in the narrow `room`; None: it does not look for collisions.
        works_without_problem: A costmap and a footprint are all the surroundings that it needs.
        period: Time between two cycles [s]; build the plugin for it.
        cycles: Cycles within which it ends.
    """

    interface: ClassVar[type[Behavior]] = Behavior
    command: ClassVar[Mapping[str, object]] = {}
    bad_commands: ClassVar[tuple[Mapping[str, object], ...]] = ({"no such thing": 1},)
    invalid_code: ClassVar[int] = 0
    timed_command: ClassVar[Mapping[str, object] | None] = None
    timeout_code: ClassVar[int] = 0
    blocked_code: ClassVar[int | None] = None
    works_without_problem: ClassVar[bool] = True
    period: ClassVar[float] = 0.1
    cycles: ClassVar[int] = 400

    def start(self) -> Pose2:
        """Where the robot stands when the behavior begins."""
        return ORIGIN

    def make_blocked_context(self) -> PluginContext:
        """Surroundings in which `command` cannot succeed."""
        return scene_context(scene_problem(goal=Pose2(50.0, 0.0, 0.0), obstacles=room()))

    def exercise(self, plugin: Behavior) -> object:
        """How it begins, and its first command.

        Raises:
            BehaviorException: It does not begin.
        """
        begun = plugin.on_run(self.command)
        if begun.status is not BehaviorStatus.SUCCEEDED:
            raise BehaviorException(begun.error_msg)
        result, twist = plugin.on_cycle_update(self.start(), _REST)
        return begun, result, (twist.linear, twist.angular)

    def test_it_says_which_costmaps_it_needs(self) -> None:
        """`resource_info`: which costmaps it needs, known before it is configured."""
        found = self.make_plugin().resource_info
        require(isinstance(found, CostmapInfoType), f"resource_info is a CostmapInfoType, got {found!r}")

    def test_no_cycle_before_it_has_begun(self) -> None:
        """`on_run`: SUCCEEDED lets the cycles start; nothing else does."""
        self._require_no_cycle(self.ready_plugin(), "before on_run there is no cycle")

    def test_it_runs_and_ends_at_rest(self) -> None:
        """`on_cycle_update`: RUNNING until SUCCEEDED, a command with each; the last one is to stand still."""
        behavior, world = self._begun(self.make_context())
        result = self._run(behavior, world)
        require(result.status is BehaviorStatus.SUCCEEDED, f"in the open it succeeds, got {result}")
        require((result.error_code, result.error_msg) == (0, ""), f"a success has no error, got {result}")
        require(world.commands[-1] == _REST, f"the last command is to stand still, got {world.commands[-1]}")

    def test_it_can_begin_again(self) -> None:
        """`on_run`: begin; a second run is like the first, wherever the robot is now."""
        behavior, world = self._begun(self.make_context())
        self._run(behavior, world)
        first, world.commands, world.pose, world.twist = world.commands, [], self.start(), _REST
        require(behavior.on_run(self.command).status is BehaviorStatus.SUCCEEDED, "it begins a second time")
        self._run(behavior, world)
        require(world.commands == first, "the second run is like the first")

    def test_a_bad_command_is_refused_with_its_code(self) -> None:
        """`BehaviorResult`: status, Nav2 error code and message; a refused command never raises and never moves."""
        for bad in (*self.bad_commands, {**self.command, "no such thing": 1}):
            behavior = self.ready_plugin()
            self._require_failure(behavior.on_run(bad), self.invalid_code, f"the command {bad}")
            self._require_no_cycle(behavior, f"after the refused command {bad} there is no cycle")

    def test_a_bad_command_ends_an_earlier_run(self) -> None:
        """`on_run`: only SUCCEEDED lets the cycles start, so a refusal leaves no earlier motion behind to go on."""
        for bad in self.bad_commands:
            behavior, world = self._begun(self.make_context())
            world.step(behavior, self.period)
            require(behavior.on_run(bad).status is BehaviorStatus.FAILED, f"the command {bad} is refused")
            self._require_no_cycle(behavior, "a refused command ends the run before it")

    def test_numbers_in_commands_are_finite(self) -> None:
        """`on_run`: a command whose number is NaN or infinite is refused like any other bad one."""
        numbers = [name for name, value in self.command.items() if isinstance(value, float)]
        for name in numbers:
            for bad in (math.nan, math.inf, -math.inf):
                result = self.ready_plugin().on_run({**self.command, name: bad})
                self._require_failure(result, self.invalid_code, f"{name} = {bad}")

    def test_it_gives_up_when_its_time_is_over(self) -> None:
        """A timed behavior: a robot that is stuck makes it FAIL with the time-out's code, at rest."""
        if self.timed_command is None:
            return
        behavior, world = self._begun(self.make_context(), self.timed_command, stuck=True)
        self._require_failure(self._run(behavior, world), self.timeout_code, "a robot that is stuck")
        require(world.commands[-1] == _REST, f"the last command is to stand still, got {world.commands[-1]}")

    def test_it_does_not_drive_into_obstacles(self) -> None:
        """`resource_info`: a behavior that reads a costmap stops before obstacles, or never begins; with its code."""
        if self.blocked_code is None:
            return
        behavior, world = self.make_plugin(), _ScriptedRobot(self.make_blocked_context(), self.start())
        behavior.configure(world.context)
        begun = behavior.on_run(self.command)
        result = self._run(behavior, world) if begun.status is BehaviorStatus.SUCCEEDED else begun
        self._require_failure(result, self.blocked_code, "a blocked way")
        require(world.commands[-1:] in ([], [_REST]), f"the last command is to stand still, got {world.twist}")

    def test_it_sees_the_costmap_that_it_asks_for(self) -> None:
        """`resource_info`: LOCAL heeds the local costmap alone, GLOBAL the global one, BOTH both, NONE neither.

        Without a problem: its obstacles always count.
        """
        if self.blocked_code is None or not self.works_without_problem:
            return
        needs = self.make_plugin().resource_info
        for wall_is_local in (True, False):
            walls, free = room_costmap(), free_costmap()
            local, around = (walls, free) if wall_is_local else (free, walls)
            context = PluginContext("contract", around, ROBOT.footprint, local_costmap=local)
            asked = CostmapInfoType.LOCAL if wall_is_local else CostmapInfoType.GLOBAL
            behavior, world = self.make_plugin(), _ScriptedRobot(context, self.start())
            behavior.configure(world.context)
            begun = behavior.on_run(self.command)
            result = self._run(behavior, world) if begun.status is BehaviorStatus.SUCCEEDED else begun
            heeded = result.status is BehaviorStatus.FAILED
            which = "local" if wall_is_local else "global"
            require(heeded == bool(needs & asked), f"asking for {needs.name}, a wall in the {which} one: got {result}")

    def _begun(
        self, context: PluginContext, command: Mapping[str, object] | None = None, *, stuck: bool = False
    ) -> tuple[Behavior, _ScriptedRobot]:
        behavior, world = self.make_plugin(), _ScriptedRobot(context, self.start(), stuck=stuck)
        behavior.configure(world.context)
        behavior.activate()
        begun = behavior.on_run(self.command if command is None else command)
        require(begun.status is BehaviorStatus.SUCCEEDED, f"a good command is accepted, got {begun}")
        return behavior, world

    def _run(self, behavior: Behavior, world: _ScriptedRobot) -> BehaviorResult:
        for _ in range(self.cycles):
            result = world.step(behavior, self.period)
            require(isinstance(result, BehaviorResult), f"a BehaviorResult, got {type(result).__name__}")
            if result.status is not BehaviorStatus.RUNNING:
                return result
        require(holds=False, sentence=f"it ends within {self.cycles} cycles")
        raise AssertionError

    @staticmethod
    def _require_failure(result: BehaviorResult, code: int, what: str) -> None:
        require(result.status is BehaviorStatus.FAILED, f"{what} fails, got {result}")
        require(result.error_code == code, f"{what} has the code {code}, got {result}")
        require(result.error_msg, f"{what} is explained")

    def _require_no_cycle(self, behavior: Behavior, rule: str) -> None:
        refused(lambda: behavior.on_cycle_update(self.start(), _REST), BehaviorException, rule)
