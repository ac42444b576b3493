"""BackUp and DriveOnHeading: straight motions with ramps, a time limit and a collision check ahead."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from optdock.deadline import Deadline
from optdock.errors import BehaviorException, InvalidValue
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import Twist2
from optdock.plugins.interfaces import Behavior, BehaviorResult, BehaviorStatus, CostmapInfoType
from optdock.plugins.parameters import PluginParameters, parse_parameters
from optdock.verification.time_of_impact import free_motion

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.pose import Pose2

__all__ = ["BackUp", "DriveOnHeading"]

_SUCCEEDED = BehaviorResult(BehaviorStatus.SUCCEEDED)


class Codes(NamedTuple):
    """Nav2's action error codes for a behavior."""

    unknown: int
    timeout: int
    collision_ahead: int
    invalid_input: int


class DriveParameters(PluginParameters):
    """Nav2's parameters of BackUp and DriveOnHeading, and a clearance."""

    cycle_frequency: float = Field(default=10.0, gt=0.0, description="calls per second [Hz]")
    simulate_ahead_time: float = Field(default=2.0, gt=0.0, description="duration of the collision check ahead [s]")
    acceleration_limit: float = Field(default=2.5, gt=0.0, description="largest acceleration [m/s^2]")
    deceleration_limit: float = Field(default=-2.5, lt=0.0, description="largest deceleration, negative [m/s^2]")
    minimum_speed: float = Field(default=0.10, gt=0.0, description="smallest speed before the target [m/s]")
    clearance: float = Field(default=0.0, ge=0.0, description="required distance from obstacles [m]")


class DriveCommand(PluginParameters):
    """Command to drive a straight motion."""

    target: float = Field(description="distance along the heading [m]")
    speed: float = Field(description="largest speed [m/s]")
    time_allowance: float = Field(default=10.0, ge=0.0, description="time limit [s]; 0: none")
    disable_collision_checks: bool = Field(default=False, description="skip the collision check")


@dataclass
class _Motion:
    """State of one straight motion."""

    command: DriveCommand
    deadline: Deadline
    origin: Pose2 | None = None
    speed: float = 0.0


class _StraightBehavior(Behavior, ABC):
    """Base class of both behaviors.

    Nav2 checks the edges of the footprint on a grid at single poses. This class checks the area swept by the whole
    footprint during the continuous motion.
    """

    Parameters = DriveParameters
    parameters: DriveParameters
    codes: ClassVar[Codes]

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._motion: _Motion | None = None

    @property
    def resource_info(self) -> CostmapInfoType:
        """Costmap that the collision check uses: the local costmap."""
        return CostmapInfoType.LOCAL

    @abstractmethod
    def directed(self, command: DriveCommand) -> DriveCommand:
        """Return the command with the signs of the motion.

        Raises:
            InvalidValue: If target and speed are invalid.
        """

    def on_run(self, command: Mapping[str, object]) -> BehaviorResult:
        """Start a motion; the command has the fields of `DriveCommand`."""
        self._motion = None
        context = self.context
        try:
            parsed = self.directed(parse_parameters(DriveCommand, command, context.name))
        except InvalidValue as error:
            return _failed(self.codes.invalid_input, str(error))
        can_check = context.footprint is not None and (
            context.problem is not None or context.costmaps(self.resource_info)
        )
        if not (parsed.disable_collision_checks or can_check):
            return _failed(
                self.codes.unknown,
                f"{context.name}: cannot check for collisions: configure it with a problem or with a costmap and a "
                "footprint, or set disable_collision_checks",
            )
        self._motion = _Motion(parsed, Deadline.of_allowance(parsed.time_allowance, context.clock))
        return _SUCCEEDED

    def on_cycle_update(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:
        """Return the result of one cycle and the command to send.

        Raises:
            BehaviorException: If `on_run` has not succeeded.
        """
        p, motion = self.parameters, self._motion
        if motion is None:
            raise BehaviorException(f"{type(self).__name__}: on_run must succeed before the cycles begin")
        if motion.deadline.passed():
            return _failed(self.codes.timeout, "time allowance exceeded before the target was reached"), Twist2()
        if motion.origin is None:
            motion.origin = pose
            motion.speed = max(0.0, math.copysign(1.0, motion.command.speed) * velocity.linear)
        remaining = abs(motion.command.target) - motion.origin.distance_to(pose)
        if remaining <= 0.0:
            return _SUCCEEDED, Twist2()
        motion.speed = self._next_speed(motion, remaining)
        twist = Twist2(math.copysign(motion.speed, motion.command.speed))
        # The check covers one cycle beyond the target, because the command is executed until the next cycle.
        ahead = min(p.simulate_ahead_time, remaining / motion.speed + 1.0 / p.cycle_frequency)
        refusal = "" if motion.command.disable_collision_checks else self._collision(pose, twist, ahead)
        if refusal:
            return _failed(self.codes.collision_ahead, refusal), Twist2()
        return BehaviorResult(BehaviorStatus.RUNNING), twist

    def _next_speed(self, motion: _Motion, remaining: float) -> float:
        """Return the next speed [m/s] towards the commanded speed that allows a stop within the remaining distance."""
        p, highest = self.parameters, abs(motion.command.speed)
        faster = motion.speed + p.acceleration_limit / p.cycle_frequency
        braking = math.sqrt(2.0 * -p.deceleration_limit * remaining)
        arriving = remaining * p.cycle_frequency
        return max(min(highest, faster, braking, arriving), min(p.minimum_speed, highest))

    def _collision(self, pose: Pose2, twist: Twist2, duration: float) -> str:
        """Return the description of a collision within `duration` [s], or an empty string."""
        footprint, clearance = self.context.footprint, self.parameters.clearance
        assert footprint is not None
        reach = footprint.circumscribed_radius + math.hypot(twist.linear, twist.lateral) * duration + clearance
        centre = np.array([pose.x, pose.y])
        obstacles = self.context.obstacles_near(centre - reach, centre + reach, self.resource_info)
        found = free_motion(footprint, obstacles, pose, twist, duration, clearance)
        if found.row < 0:
            return ""
        return f"collision ahead: {in_words(obstacles.name_of(found.row))} in {found.free:.2f} s"


class DriveOnHeading(_StraightBehavior):
    """Drive `target` metres along the heading, forwards or (both negative) backwards, like Nav2's behavior.

    Codes: TIMEOUT 721, COLLISION_AHEAD 723, INVALID_INPUT 724, UNKNOWN 720.

    Args:
        **parameters: Fields of `DriveParameters`.
    """

    codes = Codes(unknown=720, timeout=721, collision_ahead=723, invalid_input=724)

    def directed(self, command: DriveCommand) -> DriveCommand:
        """Return the command unchanged; the sign of target and speed gives the direction of travel.

        Raises:
            InvalidValue: If the signs differ, or one of the two is 0.
        """
        if not command.target * command.speed > 0.0:
            raise InvalidValue(
                f"DriveOnHeading: target and speed must have the same sign, not 0, got {command.target} and "
                f"{command.speed}"
            )
        return command


class BackUp(_StraightBehavior):
    """Reverse by `target` metres; the signs of target and speed do not matter, as in Nav2.

    Codes: TIMEOUT 711, INVALID_INPUT 713, COLLISION_AHEAD 714, UNKNOWN 710.

    Args:
        **parameters: Fields of `DriveParameters`.
    """

    codes = Codes(unknown=710, timeout=711, collision_ahead=714, invalid_input=713)

    def directed(self, command: DriveCommand) -> DriveCommand:
        """Return the command with both signs negative.

        Raises:
            InvalidValue: If target or speed is 0.
        """
        if command.target == 0.0 or command.speed == 0.0:
            raise InvalidValue(f"BackUp: target and speed must not be 0, got {command.target} and {command.speed}")
        return command.model_copy(update={"target": -abs(command.target), "speed": -abs(command.speed)})


def _failed(code: int, message: str) -> BehaviorResult:
    return BehaviorResult(BehaviorStatus.FAILED, code, message)
