"""A straight motion over a distance, ramped, timed and checked: what BackUp and DriveOnHeading share."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from optdock.behaviors._results import RUNNING, SUCCEEDED, Codes, failed, stopped
from optdock.geometry.pose import Twist2
from optdock.parameters import PluginParameters

if TYPE_CHECKING:
    from optdock.behaviors._collision import CollisionGate
    from optdock.deadline import Deadline
    from optdock.geometry.pose import Pose2
    from optdock.interfaces import BehaviorResult

__all__ = ["DriveCommand", "DriveParameters", "StraightMotion"]


class DriveParameters(PluginParameters):
    """Nav2's parameters of BackUp and DriveOnHeading, and a clearance."""

    cycle_frequency: float = Field(default=10.0, gt=0.0, description="[Hz]")
    simulate_ahead_time: float = Field(default=2.0, gt=0.0, description="how far ahead to look [s]")
    acceleration_limit: float = Field(default=2.5, gt=0.0, description="[m/s^2]")
    deceleration_limit: float = Field(default=-2.5, lt=0.0, description="negative [m/s^2]")
    minimum_speed: float = Field(default=0.10, gt=0.0, description="[m/s]")
    clearance: float = Field(default=0.0, ge=0.0, description="distance to keep from obstacles [m]")


class DriveCommand(PluginParameters):
    """How far, how fast, how long."""

    target: float = Field(description="distance along the heading [m]")
    speed: float = Field(description="[m/s]")
    time_allowance: float = Field(default=10.0, ge=0.0, description="[s]; 0: no limit")
    disable_collision_checks: bool = Field(default=False, description="drive blind")


class StraightMotion:
    """One run of a straight motion; the first cycle's pose is its origin.

    Args:
        codes: Error codes of the behavior.
        parameters: Limits.
        command: Target and speed of equal sign.
        deadline: Running.
        gate: Collision check, or None to drive blind.
    """

    def __init__(
        self,
        codes: Codes,
        parameters: DriveParameters,
        command: DriveCommand,
        deadline: Deadline,
        gate: CollisionGate | None,
    ) -> None:
        self._codes, self._parameters, self._command = codes, parameters, command
        self._deadline, self._gate = deadline, gate
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
        refusal = self._gate.refusal(pose, twist, self._look_ahead(remaining)) if self._gate else ""
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
