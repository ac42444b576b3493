"""Differential drive with command latency, wheel lag, slip and wrong kinematic parameters.

Time advances in sub-steps of 5 ms. The commanded wheel speed is constant within a sub-step, so the first-order lag is
exact; the motion of the robot is the arc of the mean wheel speeds, exact for constant speeds.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from optdock.geometry.pose import Pose2, Twist2

__all__ = ["SUBSTEP", "Drive", "DriveState"]

SUBSTEP = 0.005  # [s]: 1/20 of the time constant of the wheels, and half the period of the odometry
_INSTANT = 1e-9  # [s]: rounding of times that are sums of sub-steps
_STRAIGHT = 1e-9  # [rad]: the chord of a smaller turn equals its arc


@dataclass(frozen=True)
class Drive:
    """Parameters of the drive. Ranges are (lowest, highest) of a uniform distribution.

    Args:
        track_width: Track width assumed by the base [m].
        wheel_radius: Wheel radius assumed by the base [m].
        radius_spread: Largest relative deviation of each true radius, drawn per run [1].
        track_spread: Largest relative deviation of the true track width, drawn per run [1].
        lag: Time constant of each wheel's speed [s].
        dead_band: Commanded speed below which a wheel stands still, drawn per wheel and run [m/s].
        latency: Latency of each command [s]; commands stay in order.
        command_loss: Share of lost commands [1].
        watchdog: Time without a command after which the base stops [s].
        slip_rate: Slip bursts per second [1/s].
        slip_duration: Duration of each burst [s].
        slip_share: Lost share of the rim's distance during a burst [1], on the left wheel, the right wheel, or both.
    """

    track_width: float = 0.4
    wheel_radius: float = 0.1
    radius_spread: float = 0.01
    track_spread: float = 0.01
    lag: float = 0.1
    dead_band: tuple[float, float] = (0.0, 0.0)
    latency: tuple[float, float] = (0.04, 0.12)
    command_loss: float = 0.01
    watchdog: float = 0.5
    slip_rate: float = 0.25
    slip_duration: tuple[float, float] = (0.2, 0.4)
    slip_share: tuple[float, float] = (0.2, 0.6)


class DriveState:
    """State of one driving robot.

    Args:
        drive: Drive parameters.
        start: True pose, at rest.
        seeds: Seeds of wheel properties, commands and slip.

    Attributes:
        time: [s].
        x: True [m].
        y: True [m].
        yaw: True, continuous [rad].
        left: Rotation angle of the left wheel [rad].
        right: Rotation angle of the right wheel [rad].
        radii: True radii, left and right [m].
        width: True track width [m].
        dead_bands: Left and right [m/s].
    """

    def __init__(
        self,
        drive: Drive,
        start: Pose2,
        seeds: tuple[np.random.Generator, np.random.Generator, np.random.Generator],
    ) -> None:
        wheels, self._commands, self._slips = seeds
        self.drive = drive
        self.x, self.y, self.yaw = start.x, start.y, start.yaw
        self.time = 0.0
        self._count = 0
        left, right, track = wheels.uniform(-1.0, 1.0, 3).tolist()
        self.radii = (
            drive.wheel_radius * (1.0 + drive.radius_spread * left),
            drive.wheel_radius * (1.0 + drive.radius_spread * right),
        )
        self.width = drive.track_width * (1.0 + drive.track_spread * track)
        self.dead_bands = tuple(wheels.uniform(*drive.dead_band, 2).tolist())
        self.left = self.right = 0.0
        self._speeds = (0.0, 0.0)  # of the wheels [rad/s]
        self._targets = (0.0, 0.0)
        self._under_way: deque[tuple[float, float, float]] = deque()
        self._last_arrival = 0.0
        self._keep = math.exp(-SUBSTEP / drive.lag) if drive.lag > 0.0 else 0.0
        self._slip_end, self._slip = 0.0, (0.0, 0.0)
        self._next_slip = self._wait()

    @property
    def wheel_speeds(self) -> tuple[float, float]:
        """Angular speeds of the left and the right wheel [rad/s]."""
        return self._speeds

    @property
    def at_rest(self) -> bool:
        """Whether both rims are slower than 1 mm/s."""
        return max(abs(speed) for speed in self._speeds) * self.drive.wheel_radius < 1e-3

    def send(self, command: Twist2) -> None:
        """Send a velocity command; it arrives later or is lost."""
        lowest, highest = self.drive.latency
        lost, share = self._commands.random(2).tolist()
        if lost < self.drive.command_loss:
            return
        arrival = self.time + lowest + share * (highest - lowest)
        if self._under_way:
            arrival = max(arrival, self._under_way[-1][0])
        self._under_way.append((arrival, command.linear, command.angular))

    def advance(self) -> None:
        """Advance one sub-step."""
        self._receive()
        keep = self._keep
        (left, right), (to_left, to_right) = self._speeds, self._targets
        ends = to_left + keep * (left - to_left), to_right + keep * (right - to_right)
        # Integral of a speed that approaches its target exponentially.
        spent = self.drive.lag * (1.0 - keep)
        turned_left = to_left * SUBSTEP + (left - to_left) * spent
        turned_right = to_right * SUBSTEP + (right - to_right) * spent
        self._speeds = ends
        self.left += turned_left
        self.right += turned_right
        self._count += 1
        self.time = self._count * SUBSTEP
        slip = self._slip if self.time <= self._slip_end else self._next_burst()
        self._roll(turned_left * self.radii[0] * (1.0 - slip[0]), turned_right * self.radii[1] * (1.0 - slip[1]))

    def stall(self, x: float, y: float, yaw: float) -> None:
        """Hold the robot and its wheels at a pose."""
        self.x, self.y, self.yaw = x, y, yaw
        self._speeds = (0.0, 0.0)

    def _receive(self) -> None:
        """Set the commands that have arrived as targets of the wheels."""
        while self._under_way and self._under_way[0][0] <= self.time + _INSTANT:
            self._last_arrival, linear, angular = self._under_way.popleft()
            turn = 0.5 * self.drive.track_width * angular
            self._targets = self._target(linear - turn, 0), self._target(linear + turn, 1)
        if self.time - self._last_arrival > self.drive.watchdog:
            self._targets = (0.0, 0.0)

    def _target(self, rim: float, wheel: int) -> float:
        """Return the angular speed for a rim speed `rim` [m/s] with the assumed radius [rad/s]."""
        return 0.0 if abs(rim) < self.dead_bands[wheel] else rim / self.drive.wheel_radius

    def _roll(self, left: float, right: float) -> None:
        """Move along the arc given by the distances of both rims [m]."""
        way, turn = 0.5 * (left + right), (right - left) / self.width
        half = 0.5 * turn
        chord = way * math.sin(half) / half if abs(half) > _STRAIGHT else way
        self.x += chord * math.cos(self.yaw + half)
        self.y += chord * math.sin(self.yaw + half)
        self.yaw += turn

    def _wait(self) -> float:
        rate = self.drive.slip_rate
        return float(self._slips.exponential(1.0 / rate)) if rate > 0.0 else math.inf

    def _next_burst(self) -> tuple[float, float]:
        """Start the next slip burst if it is due."""
        if self.time < self._next_slip:
            return (0.0, 0.0)
        duration, share = (
            self._slips.uniform(*self.drive.slip_duration),
            float(self._slips.uniform(*self.drive.slip_share)),
        )
        side = int(self._slips.integers(3))
        self._slip_end = self.time + float(duration)
        self._slip = ((share, 0.0), (0.0, share), (share, share))[side]
        self._next_slip = self._slip_end + self._wait()
        return self._slip
