"""Nav2's docking law with a velocity smoother, as run by its docking server, in the field world.

Ambiguous settings of the server are resolved in its favour: the dock is kept in the odometry frame, a detection is
placed by the robot pose at the time of the picture, the last filtered dock is kept while none is detected, and the
robot drives on until the switch or a stall signals contact instead of stopping within 5 cm.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from experiments.docking.field.outcome import SteeringResult
from experiments.graceful_law import nav2_command, nav2_filtered
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.dock import DockDirection
from optdock.model.path import Direction

if TYPE_CHECKING:
    from experiments.docking.cases import Layout
    from experiments.docking.field.world import FieldRobot
    from optdock.model.measurements import Detection, Measurements

__all__ = ["VelocitySmoother", "by_nav2"]

FORGOTTEN = 1.0  # [s]: external_detection_timeout, after which the filter is reset
PERCEPTION = 5.0  # [s]: initial_perception_timeout
STALL, PATIENCE = 0.005, 1.0  # [m/s], [s]: contact by stall
NEAR = 0.05  # [m]: docking_threshold, within which a stall counts as contact
TIMEOUT, SETTLING = 60.0, 1.0  # [s]
SMOOTHING_PERIOD = 0.05  # [s]: smoothing_frequency of 20 Hz
HISTORY = 1.0  # [s] of stored poses, for the placement of detections
DOCKED = "docked"
_INSTANT = 1e-9  # [s]: rounding of times that are sums of periods


class VelocitySmoother:
    """Nav2's velocity smoother, open loop, with its default accelerations, which limit the change per period."""

    def __init__(
        self, acceleration: float = 2.5, yaw_acceleration: float = 3.2, period: float = SMOOTHING_PERIOD
    ) -> None:
        self._steps = acceleration * period, yaw_acceleration * period
        self._last = Twist2()

    def smoothed(self, command: Twist2) -> Twist2:
        """Return the next command on the way to `command`."""
        (linear, angular), last = self._steps, self._last
        self._last = Twist2(
            last.linear + min(max(command.linear - last.linear, -linear), linear),
            last.angular + min(max(command.angular - last.angular, -angular), angular),
        )
        return self._last


class _SeenDock:
    """Filtered dock pose in the server's frame; None before the first detection at `found_at` [s]."""

    def __init__(self) -> None:
        self._history: deque[tuple[float, Pose2]] = deque()
        self._seen_at = -math.inf
        self.found_at = math.inf
        self.pose: Pose2 | None = None

    def update(self, stamp: float, robot: Pose2, detections: tuple[Detection, ...]) -> None:
        """Process detections; `robot`: current robot pose in the server's frame."""
        self._history.append((stamp, robot))
        while self._history[0][0] < stamp - HISTORY:
            self._history.popleft()
        for one in detections:
            then = min(self._history, key=lambda entry: abs(entry[0] - one.stamp))[1]
            self._see(then @ one.pose, stamp)

    def _see(self, seen: Pose2, stamp: float) -> None:
        before, fresh = self.pose, stamp - self._seen_at > FORGOTTEN
        self._seen_at = stamp
        if before is None or fresh:
            self.pose, self.found_at = seen, min(self.found_at, stamp)
            return
        self.pose = nav2_filtered(before, seen)


class _Server:
    """Docking server: computes commands and detects the end."""

    def __init__(self, layout: Layout) -> None:
        self._dock = _SeenDock()
        self._gear = Direction.FORWARD if layout.direction is DockDirection.FORWARD else Direction.REVERSE
        self._still_since: float | None = None
        self.ending: str | None = None

    def step(self, now: Measurements) -> Twist2:
        """Return the next command; `ending` is set if it is the last one."""
        robot = now.odometry.pose if now.odometry is not None else now.pose
        if robot is not None:
            self._dock.update(now.stamp if now.odometry is None else now.odometry.stamp, robot, now.detections)
        self.ending = self._ending(now, robot)
        dock = self._dock.pose
        if self.ending is not None or robot is None or dock is None:
            return Twist2()
        return nav2_command(dock, robot, self._gear)

    def _ending(self, now: Measurements, robot: Pose2 | None) -> str | None:
        """Return the ending; None while docking continues."""
        dock = self._dock.pose
        if now.contact:
            return DOCKED
        if now.stamp > TIMEOUT:
            return "timeout"
        if dock is None or robot is None:
            return "failed to detect the dock" if now.stamp > PERCEPTION else None
        if self._stalled(now):
            return DOCKED if robot.distance_to(dock) < NEAR else "stalled away from the dock"
        return None

    def _stalled(self, now: Measurements) -> bool:
        """Return whether the wheels have stood still against commands for `PATIENCE`."""
        if abs(now.twist.linear) >= STALL:
            self._still_since = None
        elif self._still_since is None:
            self._still_since = now.stamp
        since = self._still_since if self._dock.pose is not None else None
        return since is not None and now.stamp - max(since, self._dock.found_at) > PATIENCE


def by_nav2(layout: Layout, robot: FieldRobot, rate: float) -> SteeringResult:
    """Drive a robot into its dock."""
    server, smoother = _Server(layout), VelocitySmoother()
    stamps: list[float] = []
    commands: list[tuple[float, float]] = []
    ended: float | None = None
    while ended is None or robot.time < ended + SETTLING:
        wanted = server.step(robot.measurements) if ended is None else Twist2()
        if ended is None and server.ending is not None:
            ended = robot.time
        until = robot.time + robot.cycle(rate)
        while (due := len(stamps) * SMOOTHING_PERIOD) < until - _INSTANT:
            robot.run(due)
            command = smoother.smoothed(wanted)
            robot.drive.send(command)
            stamps.append(due)
            commands.append((command.linear, command.angular))
        robot.run(until)
        robot.measure()
    ending = server.ending or ""
    unknown = math.nan  # it reports neither plans nor estimates
    return SteeringResult(
        ending, "", ending == DOCKED, ended, unknown, 0, unknown, unknown, unknown, unknown, np.array(commands),
        np.array(stamps),
    )  # fmt: skip
