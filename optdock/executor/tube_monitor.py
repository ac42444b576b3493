"""Position of the robot along a path, and a check that it stays within the certified tube."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.pose import Pose2, displacement, normalize_angle
from optdock.model.clearance_rule import START_RELIEF_SLOPE
from optdock.samples.tube import Tube

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor.planning import DrivenMotion
    from optdock.model.clearance_rule import ClearanceRule
    from optdock.model.path import Path
    from optdock.model.robot import Robot

__all__ = ["TubeMonitor"]

_WATCHED = 0.005  # [m]: leaving a narrower tube, such as at contact, does not start a plan, as noise may be the cause
_LAST_REPLAN = 0.15  # [m] in front of the dock; closer, no path moves a robot sideways by more than a millimetre
_LEAP = 0.25  # [m] from the reference in which the nearest pose of the path is searched
_ROUNDING = 1e-9  # [m]
_SAMPLES = 0.01  # [m] between two sampled poses of a path


class TubeMonitor:
    """Position of the robot along a path, and a check that the robot is within the certified tube.

    Attributes:
        deviation: Pose of the robot relative to the nearest pose of the path; None before the first update.
        time: Time at which the plan passes the position of the robot, on the clock of the trajectory; non-decreasing
            [s].
    """

    def __init__(
        self, motion: DrivenMotion, robot: Robot, *, is_stop: bool, report: Callable[[str, str], None]
    ) -> None:
        self._trajectory, self._report = motion.trajectory, report
        self._radius = robot.footprint.circumscribed_radius
        self._poses = _SampledPath(motion.trajectory.path)
        law = motion.trajectory.time_law
        self._times_of_places = np.ascontiguousarray(law.states[:, 0]), law.times
        self.time = 0.0
        self.deviation: Pose2 | None = None
        self._motion, self._is_proven = motion, not is_stop and (robot.tracking.cross > 0.0 or robot.tracking.yaw > 0.0)
        self._is_outside = False

    @functools.cached_property
    def _tube(self) -> Tube:
        """The tube, which is sampled in the first cycle of the drive and not in the cycle that takes over."""
        return Tube(self._trajectory.path, self._motion.problem, self._motion.start_relief)

    @functools.cached_property
    def _least_widths(self) -> list[float]:
        """Lower bounds of the width of the tube between the sampled poses [m]."""
        problem, places = self._motion.problem, self._poses.places
        widths, step = self._tube.width_at(places), float(places[1])
        steepest = sum(_steepest(rule) for rule in (problem.path_clearance, problem.clearance))
        least: list[float] = (0.5 * (widths[:-1] + widths[1:]) - 0.5 * step * steepest - _ROUNDING).tolist()
        return least

    def time_at(self, s: float) -> float:
        """Return the time [s] at which the plan passes an arc length [m] of the path."""
        return float(np.interp(s, *self._times_of_places))

    def update(self, robot: Pose2, time: float) -> bool:
        """Update the robot's position along the path from its pose.

        `time` is the trajectory time of the current reference, >= 0 [s].

        Returns: Whether the robot has just left the tube at a position where a new plan is useful.
        """
        path = self._trajectory.path
        begin = self._trajectory.time_law.state_at(time)[0]
        place, gear = self._poses.at(begin)
        ahead = gear * robot.in_frame_of(place).x
        s = min(max(begin + min(max(ahead, -_LEAP), _LEAP), 0.0), path.length)
        self.deviation = off = robot.in_frame_of(self._poses.at(s)[0])
        self.time = max(time, self.time_at(s))
        if not self._is_proven:
            return False
        moved = float(displacement(math.hypot(off.x, off.y), off.yaw, self._radius))
        if not self._is_outside and (
            moved <= self._least_widths[self._poses.interval_of(s)]
            or moved <= float(self._tube.width_at(np.array([s]))[0])
        ):
            return False
        # The deviation above is relative to this pose; another pose of the path may be nearer.
        found = self._tube.deviations(robot.as_array()[None], near=s, within=_LEAP)
        moved, width = float(found.displacement[0]), float(found.width[0])
        is_outside = moved > width
        if is_outside == self._is_outside:
            return False
        self._is_outside = is_outside
        detail = f"{off.y:.4f} m and {off.yaw:.4f} rad off, {moved:.4f} m of the footprint; certified: {width:.4f} m"
        self._report("tube left" if is_outside else "tube entered", detail)
        return is_outside and width >= _WATCHED and path.length - s > _LAST_REPLAN


class _SampledPath:
    """The poses of a path at equal distances, for fast interpolation.

    Attributes:
        places: Arc lengths of the poses, Shape (n,) [m].
    """

    def __init__(self, path: Path) -> None:
        count = max(1, math.ceil(path.length / _SAMPLES))
        self.places = np.linspace(0.0, path.length, count + 1)
        self._step = path.length / count
        self._poses: list[list[float]] = path.poses_at(self.places).tolist()
        self._last = count - 1
        self._gears: list[float] = path.direction_at(self.places).astype(np.float64).tolist()

    def interval_of(self, s: float) -> int:
        """Return the number of the interval between two sampled poses that contains an arc length [m]."""
        found = int(s / self._step)
        return 0 if found < 0 else self._last if found > self._last else found

    def at(self, s: float) -> tuple[Pose2, float]:
        """Return the pose and the gear at an arc length [m] of the path."""
        i = self.interval_of(s)
        share = s / self._step - i
        (x, y, yaw), (far_x, far_y, far_yaw) = self._poses[i : i + 2]
        turned = normalize_angle(far_yaw - yaw)
        pose = Pose2(x + share * (far_x - x), y + share * (far_y - y), yaw + share * turned)
        return pose, self._gears[i]


def _steepest(rule: ClearanceRule) -> float:
    """Return the largest change of the required clearance per distance [1]."""
    growth = rule.required - min(rule.at_dock, rule.required if rule.at_start is None else rule.at_start)
    by_taper = growth / rule.taper if rule.taper > 0.0 else math.inf if growth > 0.0 else 0.0
    return max(by_taper, START_RELIEF_SLOPE)
