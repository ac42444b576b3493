"""Position of the robot along a path, and a check that it stays within the certified tube."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.geometry.pose import Pose2, normalize_angle
from optdock.kernels import Kernel, twin_of
from optdock.model.clearance_rule import START_RELIEF_SLOPE
from optdock.samples.tube import Tube

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.executor.planning import DrivenMotion
    from optdock.geometry.arrays import FloatArray
    from optdock.model.clearance_rule import ClearanceRule
    from optdock.model.path import Path
    from optdock.model.robot import Robot

__all__ = ["TubeMonitor", "least_excess"]

_WATCHED = 0.005  # [m]: leaving a narrower tube, such as at contact, does not start a plan, as noise may be the cause
_LAST_REPLAN = 0.15  # [m] in front of the dock; closer, no path moves a robot sideways by more than a millimetre
_LEAP = 0.25  # [m] from the reference in which the nearest pose of the path is searched
_ROUNDING = 1e-9  # [m]
_PARTS = 8  # of an interval of the path that may be inside the tube
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
    def _mean_widths(self) -> FloatArray:
        """Mean widths of the tube between its sampled poses, Shape (n,) [m]."""
        widths: FloatArray = 0.5 * (self._tube.widths[:-1] + self._tube.widths[1:])
        return widths

    @functools.cached_property
    def _step(self) -> float:
        """Distance between the sampled poses of the tube [m]."""
        return self._tube.places.item(1)

    @functools.cached_property
    def _least_widths(self) -> list[float]:
        """Lower bounds of the width of the tube between its sampled poses [m]."""
        least: list[float] = (self._mean_widths - 0.5 * self._step * self._steepest - _ROUNDING).tolist()
        return least

    def _least_width_at(self, s: float) -> float:
        """Return a lower bound of the width of the tube at an arc length [m]."""
        least = self._least_widths
        return least[min(max(int(s / self._step), 0), len(least) - 1)]

    @functools.cached_property
    def _steepest(self) -> float:
        """Bound of the change of the tube's width per distance [1]."""
        problem = self._motion.problem
        return _steepest(problem.path_clearance) + _steepest(problem.clearance)

    @functools.cached_property
    def _samples(self) -> FloatArray:
        """Samples of the tube for `least_excess`, Shape (n + 1, 4)."""
        tube, step = self._tube, self._step
        chords = np.hypot(*np.diff(tube.poses[:, :2], axis=0).T)
        # A curve between two points lies in the ellipse around them whose long axis is the length of the curve.
        sag = 0.5 * np.sqrt(np.maximum(step * step - chords * chords, 0.0))
        # Between two samples, the width changes at most as much as beside them, and the yaw by a part of each change.
        change, turn = np.abs(np.diff(tube.widths)), np.diff(tube.poses[:, 2])
        bent = 0.5 * self._radius * _largest_beside(np.abs(np.diff(turn, append=turn[-1])))
        bound = self._mean_widths + 0.5 * _largest_beside(change) + sag + bent + _ROUNDING
        return np.column_stack((tube.poses, np.append(bound, 0.0)))

    def _is_surely_outside(self, robot: Pose2, s: float) -> bool:
        """Whether no pose of the path within 0.25 m of an arc length [m] has the robot in its tube; False: unknown."""
        step, last = self._step, len(self._samples) - 1
        first = min(max(math.floor((s - _LEAP) / step) - 1, 0), last - 1)
        end = min(math.ceil((s + _LEAP) / step) + 1, last)
        return least_excess(self._samples[first : end + 1], (robot.x, robot.y, robot.yaw), self._radius) > 0.0

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
        ahead = gear * (math.cos(place.yaw) * (robot.x - place.x) + math.sin(place.yaw) * (robot.y - place.y))
        s = min(max(begin + min(max(ahead, -_LEAP), _LEAP), 0.0), path.length)
        self.deviation = off = robot.in_frame_of(self._poses.at(s)[0])
        self.time = max(time, self.time_at(s))
        if not self._is_proven:
            return False
        moved = math.hypot(off.x, off.y) + 2.0 * self._radius * abs(math.sin(0.5 * off.yaw))  # see `displacement`
        if not self._is_outside and (
            moved <= self._least_width_at(s) or moved <= float(self._tube.width_at(np.array([s]))[0])
        ):
            return False
        if self._is_outside and self._is_surely_outside(robot, s):
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


_LEAST = Kernel("optdock_least_excess", sizes=1, numbers=4)


def _least_excess_natively(samples: FloatArray, pose: tuple[float, float, float], radius: float) -> float:
    n, out = len(samples) - 1, np.empty(1)
    _LEAST((n,), (*pose, radius), ((samples, 4 * n + 4), (out, 1)))
    return out.item()


@twin_of(_least_excess_natively)
def least_excess(samples: FloatArray, pose: tuple[float, float, float], radius: float) -> float:
    """Return a lower bound of the displacement of a footprint from the poses of a path, beyond the width of the tube.

    Args:
        samples: Shape (n + 1, 4): x [m], y [m], yaw [rad] of sampled poses; of the part of the path that begins there,
            a bound of the tube's width plus the displacement from linear motion [m].
        pose: x [m], y [m], yaw [rad] of the footprint.
        radius: Its circumscribed radius [m].
    """
    whole = _displacements(samples, pose, radius, 1)[0] - samples[:-1, 3]
    parts = _displacements(samples, pose, radius, _PARTS).min(axis=0) - samples[:-1, 3]
    return float(np.where(whole <= 0.0, parts, whole).min())


def _displacements(samples: FloatArray, pose: tuple[float, float, float], radius: float, parts: int) -> FloatArray:
    """Return lower bounds of the displacement from linear motion in every part of every interval, Shape (parts, n)."""
    (x, y, yaw), begin, step = pose, samples[:-1, :3], np.diff(samples[:, :3], axis=0)
    off, square = (x, y) - begin[:, :2], (step[:, :2] ** 2).sum(axis=1)
    borders = np.linspace(0.0, 1.0, parts + 1)[:, None]
    share = (off * step[:, :2]).sum(axis=1) / np.where(square > 0.0, square, np.inf)
    share = np.minimum(np.maximum(share, borders[:-1]), borders[1:])
    distance = np.sqrt((off[:, 0] - share * step[:, 0]) ** 2 + (off[:, 1] - share * step[:, 1]) ** 2)
    turned = np.sin(0.5 * (begin[:, 2] - yaw + borders * step[:, 2]))
    least = np.where(turned[:-1] * turned[1:] > 0.0, np.minimum(np.abs(turned[:-1]), np.abs(turned[1:])), 0.0)
    found: FloatArray = distance + 2.0 * radius * least
    return found


def _largest_beside(changes: FloatArray) -> FloatArray:
    """Return the largest of every value and the values beside it. Shape (n,) each."""
    padded = np.concatenate((changes[:1], changes, changes[-1:]))
    return np.maximum(np.maximum(padded[:-2], changes), padded[2:])


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
