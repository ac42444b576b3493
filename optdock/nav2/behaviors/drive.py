"""BackUp and DriveOnHeading: straight motions, ramped, timed, and with a collision check ahead."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

from pydantic import Field

from optdock.deadline import Deadline
from optdock.errors import BehaviorException, InvalidValue
from optdock.geometry.pose import Twist2
from optdock.nav2.behaviors.collision import CollisionChecker
from optdock.nav2.behaviors.results import BACK_UP, DRIVE_ON_HEADING, RUNNING, SUCCEEDED, Codes, failed, stopped
from optdock.plugins.interfaces import Behavior, BehaviorResult, CostmapInfoType
from optdock.plugins.parameters import PluginParameters, parse_parameters

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.pose import Pose2

__all__ = ["BackUp", "DriveOnHeading"]


class DriveParameters(PluginParameters):
    """Nav2's parameters of BackUp and DriveOnHeading, and a clearance."""

    cycle_frequency: float = Field(default=10.0, gt=0.0, description="calls per second [Hz]")
    simulate_ahead_time: float = Field(default=2.0, gt=0.0, description="how far ahead to look [s]")
    acceleration_limit: float = Field(default=2.5, gt=0.0, description="speeding up [m/s^2]")
    deceleration_limit: float = Field(default=-2.5, lt=0.0, description="slowing down, negative [m/s^2]")
    minimum_speed: float = Field(default=0.10, gt=0.0, description="smallest speed on the way [m/s]")
    clearance: float = Field(default=0.0, ge=0.0, description="distance to keep from obstacles [m]")


class DriveCommand(PluginParameters):
    """How far, how fast, how long."""

    target: float = Field(description="distance along the heading [m]")
    speed: float = Field(description="largest speed on the way [m/s]")
    time_allowance: float = Field(default=10.0, ge=0.0, description="time it may take [s]; 0: no limit")
    disable_collision_checks: bool = Field(default=False, description="drive blind")


class StraightMotion:
    """One run of a straight motion; the first cycle's pose is its origin.

    Args:
        codes: Error codes of the behavior.
        parameters: Limits.
        command: Target and speed of equal sign.
        deadline: Running.
        checker: Collision check, or None to drive blind.
    """

    def __init__(
        self,
        codes: Codes,
        parameters: DriveParameters,
        command: DriveCommand,
        deadline: Deadline,
        checker: CollisionChecker | None,
    ) -> None:
        self._codes, self._parameters, self._command = codes, parameters, command
        self._deadline, self._checker = deadline, checker
        self._origin: Pose2 | None = None
        self._speed = 0.0

    def cycle(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:
        """How it stands, and the command to send."""
        if self._deadline.passed():
            return stopped(failed(self._codes.timeout, "time allowance exceeded before the target was reached"))
        if self._origin is None:
            self._origin = pose
            self._speed = max(0.0, math.copysign(1.0, self._command.speed) * velocity.linear)
        remaining = abs(self._command.target) - self._origin.distance_to(pose)
        if remaining <= 0.0:
            return stopped(SUCCEEDED)
        self._speed = self._next_speed(remaining)
        twist = Twist2(math.copysign(self._speed, self._command.speed))
        refusal = self._checker.refusal(pose, twist, self._look_ahead(remaining)) if self._checker else ""
        if refusal:
            return stopped(failed(self._codes.collision_ahead, refusal))
        return RUNNING, twist

    def _next_speed(self, remaining: float) -> float:
        """Towards the commanded speed, such that the braking distance fits into what remains."""
        p = self._parameters
        faster = self._speed + p.acceleration_limit / p.cycle_frequency
        braking = math.sqrt(2.0 * -p.deceleration_limit * remaining)
        arriving = remaining * p.cycle_frequency
        wanted = min(abs(self._command.speed), faster, braking, arriving)
        return max(wanted, min(p.minimum_speed, abs(self._command.speed)))

    def _look_ahead(self, remaining: float) -> float:
        """Seconds to look ahead: until the target, and the last cycle beyond it."""
        p = self._parameters
        return min(p.simulate_ahead_time, remaining / self._speed + 1.0 / p.cycle_frequency)


class _StraightBehavior(Behavior, ABC):
    """What both have in common; a child says which commands it takes, and with which codes it fails."""

    Parameters = DriveParameters
    parameters: DriveParameters
    codes: ClassVar[Codes]

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._motion: StraightMotion | None = None

    @property
    def resource_info(self) -> CostmapInfoType:
        """Needs the local costmap."""
        return CostmapInfoType.LOCAL

    @abstractmethod
    def ruled(self, command: DriveCommand) -> DriveCommand:
        """The command as it will be driven.

        Raises:
            InvalidValue: It cannot be.
        """

    def on_run(self, command: Mapping[str, object]) -> BehaviorResult:
        """Begin; the command is a `DriveCommand`."""
        self._motion = None
        try:
            parsed = self.ruled(parse_parameters(DriveCommand, command, self.context.name))
        except InvalidValue as error:
            return failed(self.codes.invalid_input, str(error))
        try:
            checker = None if parsed.disable_collision_checks else self._checker()
        except BehaviorException as error:
            return failed(self.codes.unknown, str(error))
        deadline = Deadline.of_allowance(parsed.time_allowance, self.context.clock)
        self._motion = StraightMotion(self.codes, self.parameters, parsed, deadline, checker)
        return SUCCEEDED

    def on_cycle_update(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:
        """One cycle.

        Raises:
            BehaviorException: `on_run` has not succeeded.
        """
        if self._motion is None:
            raise BehaviorException(f"{type(self).__name__}: on_run must succeed before the cycles begin")
        return self._motion.cycle(pose, velocity)

    def _checker(self) -> CollisionChecker:
        return CollisionChecker(self.context, self.parameters.clearance, self.resource_info)


class DriveOnHeading(_StraightBehavior):
    """Drives `target` metres along the heading, forwards or (both negative) backwards, as Nav2's behavior.

    Codes: TIMEOUT 721, COLLISION_AHEAD 723, INVALID_INPUT 724, UNKNOWN 720.

    Args:
        **parameters: Fields of `DriveParameters`.
    """

    codes = DRIVE_ON_HEADING

    def ruled(self, command: DriveCommand) -> DriveCommand:
        """Target and speed have the same sign, which is the direction of travel.

        Raises:
            InvalidValue: They have not, or one is 0.
        """
        if not command.target * command.speed > 0.0:
            raise InvalidValue(
                f"DriveOnHeading: target and speed must have the same sign, not 0, got {command.target} and "
                f"{command.speed}"
            )
        return command


class BackUp(_StraightBehavior):
    """Reverses by `target` metres; the signs of target and speed do not matter, as in Nav2.

    Codes: TIMEOUT 711, INVALID_INPUT 713, COLLISION_AHEAD 714, UNKNOWN 710.

    Args:
        **parameters: Fields of `DriveParameters`.
    """

    codes = BACK_UP

    def ruled(self, command: DriveCommand) -> DriveCommand:
        """Both made negative.

        Raises:
            InvalidValue: One is 0.
        """
        if command.target == 0.0 or command.speed == 0.0:
            raise InvalidValue(f"BackUp: target and speed must not be 0, got {command.target} and {command.speed}")
        return command.model_copy(update={"target": -abs(command.target), "speed": -abs(command.speed)})
