"""Spin: turn in place by an angle, with a collision check ahead."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from optdock.deadline import Deadline
from optdock.errors import BehaviorException, InvalidValue
from optdock.geometry.pose import Twist2, normalize_angle
from optdock.nav2.behaviors.collision import CollisionChecker
from optdock.nav2.behaviors.results import RUNNING, SPIN, SUCCEEDED, failed, stopped
from optdock.plugins.interfaces import Behavior, BehaviorResult, CostmapInfoType
from optdock.plugins.parameters import PluginParameters, parse_parameters

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optdock.geometry.pose import Pose2

__all__ = ["Spin", "SpinCommand", "SpinParameters"]


class SpinParameters(PluginParameters):
    """Nav2's parameters of Spin, and a clearance."""

    cycle_frequency: float = Field(default=10.0, gt=0.0, description="calls per second [Hz]")
    simulate_ahead_time: float = Field(default=2.0, gt=0.0, description="how far ahead to look [s]")
    max_rotational_vel: float = Field(default=1.0, gt=0.0, description="largest yaw rate [rad/s]")
    min_rotational_vel: float = Field(default=0.4, gt=0.0, description="smallest yaw rate [rad/s]")
    rotational_acc_lim: float = Field(default=3.2, gt=0.0, description="slowing down [rad/s^2]")
    clearance: float = Field(default=0.0, ge=0.0, description="distance to keep from obstacles [m]")


class SpinCommand(PluginParameters):
    """How far and how long."""

    target_yaw: float = Field(description="angle to turn by, left positive, more than a full turn allowed [rad]")
    time_allowance: float = Field(default=10.0, ge=0.0, description="time it may take [s]; 0: no limit")
    disable_collision_checks: bool = Field(default=False, description="turn blind")


class _Turn:
    """The state of one run."""

    def __init__(self, command: SpinCommand, deadline: Deadline, checker: CollisionChecker | None) -> None:
        self.command, self.deadline, self.checker = command, deadline, checker
        self.turned = 0.0
        self.last_yaw: float | None = None


class Spin(Behavior):
    """Turns in place by `target_yaw`, slowing down such that it can stop there, as Nav2's behavior.

    Codes: TIMEOUT 701, COLLISION_AHEAD 703, UNKNOWN 700 (also for a command that cannot be understood).

    Args:
        **parameters: Fields of `SpinParameters`.
    """

    Parameters = SpinParameters
    parameters: SpinParameters

    def __init__(self, **parameters: object) -> None:
        super().__init__(**parameters)
        self._turn: _Turn | None = None

    @property
    def resource_info(self) -> CostmapInfoType:
        """Needs the local costmap."""
        return CostmapInfoType.LOCAL

    def on_run(self, command: Mapping[str, object]) -> BehaviorResult:
        """Begin; the command is a `SpinCommand`."""
        self._turn = None
        try:
            parsed = parse_parameters(SpinCommand, command, "Spin")
            checker = None if parsed.disable_collision_checks else self._checker()
        except (InvalidValue, BehaviorException) as error:
            return failed(SPIN.unknown, str(error))
        self._turn = _Turn(parsed, Deadline.of_allowance(parsed.time_allowance, self.context.clock), checker)
        return SUCCEEDED

    def on_cycle_update(self, pose: Pose2, velocity: Twist2) -> tuple[BehaviorResult, Twist2]:  # noqa: ARG002 - part of the interface
        """One cycle.

        Raises:
            BehaviorException: `on_run` has not succeeded.
        """
        turn = self._turn
        if turn is None:
            raise BehaviorException("Spin: on_run must succeed before the cycles begin")
        if turn.deadline.passed():
            return stopped(failed(SPIN.timeout, "time allowance exceeded before the angle was reached"))
        turn.turned += normalize_angle(pose.yaw - turn.last_yaw) if turn.last_yaw is not None else 0.0
        turn.last_yaw = pose.yaw
        remaining = abs(turn.command.target_yaw) - math.copysign(1.0, turn.command.target_yaw) * turn.turned
        if remaining <= 1e-6:
            return stopped(SUCCEEDED)
        twist = Twist2(0.0, math.copysign(self._rate(remaining), turn.command.target_yaw))
        refusal = turn.checker.refusal(pose, twist, self._look_ahead(remaining, twist)) if turn.checker else ""
        return stopped(failed(SPIN.collision_ahead, refusal)) if refusal else (RUNNING, twist)

    def _checker(self) -> CollisionChecker:
        return CollisionChecker(self.context, self.parameters.clearance, self.resource_info)

    def _rate(self, remaining: float) -> float:
        """Yaw rate [rad/s] from which the robot can stop within what remains; never one a drive may ignore."""
        p = self.parameters
        wanted = min(math.sqrt(2.0 * p.rotational_acc_lim * remaining), remaining * p.cycle_frequency)
        return min(max(wanted, p.min_rotational_vel), p.max_rotational_vel)

    def _look_ahead(self, remaining: float, twist: Twist2) -> float:
        """Seconds to look ahead: until the angle, and the last cycle beyond it."""
        p = self.parameters
        return min(p.simulate_ahead_time, remaining / abs(twist.angular) + 1.0 / p.cycle_frequency)
