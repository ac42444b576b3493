"""Where a robot is on the path that it drives, and whether it is within the tube that was proven around the path."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.pose import Pose2, displacement, normalize_angle
from optdock.samples.tube import Tube

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor.planning import DrivenMotion
    from optdock.model.path import Path
    from optdock.model.robot import Robot

__all__ = ["TubeMonitor"]

_WATCHED = 0.005  # [m]: a tube that is narrower, where it begins and ends in contact, is left by any noise
_LAST_REPLAN = 0.15  # [m] before the dock: nearer, no robot can be moved sideways by more than a millimetre
_LEAP = 0.25  # [m] from its reference, farther off another stretch of the path may be nearer
_SAMPLES = 0.01  # [m] between two poses of a path: between them it bends by micrometres


class TubeMonitor:
    """The place of the robot on one motion, brought up to date in every cycle.

    Args:
        motion: That is driven.
        robot: Its footprint, and the errors of tracking that were proven to be harmless.
        is_stop: Whether the motion is a stop, around which no tube is proven.
        report: Takes the name of an event and its detail.

    Attributes:
        deviation: The robot in the frame of the nearest pose of the path; None before the first update.
        time: When the plan would be where the robot is, on the trajectory's own clock, which never goes back [s].
    """

    def __init__(
        self, motion: DrivenMotion, robot: Robot, *, is_stop: bool, report: Callable[[str, str], None]
    ) -> None:
        self._trajectory, self._robot, self._report = motion.trajectory, robot, report
        self._poses = _SampledPath(motion.trajectory.path)
        law = motion.trajectory.time_law
        self._times_of_places = law.states[:, 0], law.times
        self.time = 0.0
        self.deviation: Pose2 | None = None
        proven = not is_stop and (robot.tracking.cross > 0.0 or robot.tracking.yaw > 0.0)
        self._tube = Tube(motion.trajectory.path, motion.problem, motion.start_relief) if proven else None
        self._is_outside = False

    def time_at(self, s: float) -> float:
        """When the plan is at a place [m] of the path [s]."""
        return float(np.interp(s, *self._times_of_places))

    def update(self, robot: Pose2, time: float) -> bool:
        """Find the place of the robot.

        Args:
            robot: Its pose in the fixed frame.
            time: Of the reference, on the trajectory's own clock, >= 0 [s].

        Returns:
            Whether the robot has just left the tube, where leaving it is worth a new plan.
        """
        path = self._trajectory.path
        begin = float(self._trajectory.time_law.at(time)[0, 0])
        place, gear = self._poses.at(begin)
        ahead = gear * robot.in_frame_of(place).x
        s = min(max(begin + min(max(ahead, -_LEAP), _LEAP), 0.0), path.length)
        self.deviation = off = robot.in_frame_of(self._poses.at(s)[0])
        self.time = max(time, self.time_at(s))
        if self._tube is None:
            return False
        radius = self._robot.footprint.circumscribed_radius
        moved = float(displacement(math.hypot(off.x, off.y), off.yaw, radius))
        width = float(self._tube.width_at(np.array([s]))[0])
        if moved > width:  # from there; another place may be the better one
            found = self._tube.deviations(robot.as_array()[None], near=s, within=_LEAP)
            moved, width = float(found.displacement[0]), float(found.width[0])
        is_outside = moved > width
        if is_outside == self._is_outside:
            return False
        self._is_outside = is_outside
        said = f"{off.y:.4f} m and {off.yaw:.4f} rad off, {moved:.4f} m with its outline; proven: {width:.4f} m"
        self._report("tube left" if is_outside else "tube entered", said)
        return is_outside and width >= _WATCHED and path.length - s > _LAST_REPLAN


class _SampledPath:
    """The poses of a path at equal distances, to find one quickly."""

    def __init__(self, path: Path) -> None:
        count = max(1, math.ceil(path.length / _SAMPLES))
        places = np.linspace(0.0, path.length, count + 1)
        self._step = path.length / count
        self._poses: list[list[float]] = path.poses_at(places).tolist()
        self._gears: list[float] = path.direction_at(places).astype(np.float64).tolist()

    def at(self, s: float) -> tuple[Pose2, float]:
        """The pose at a place [m] of the path, and the gear."""
        i = min(max(int(s / self._step), 0), len(self._poses) - 2)
        share = s / self._step - i
        (x, y, yaw), (far_x, far_y, far_yaw) = self._poses[i : i + 2]
        turned = normalize_angle(far_yaw - yaw)
        pose = Pose2(x + share * (far_x - x), y + share * (far_y - y), yaw + share * turned)
        return pose, self._gears[i]
