"""Motion of a plan file and its clearances as columns, for figures and pages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.geometry.arrays import FloatArray, IntArray
from optdock.model.limits import LIMITS, STEERING_UNITS
from optdock.model.trajectory import Trajectory
from optdock.plotting.profile_picture import MotionPanel, motion_panels
from optdock.verification import end_clearances, pose_clearances

if TYPE_CHECKING:
    from optdock.io.plan_file import PlanFile, TrajectoryColumns
    from optdock.model.clearance_rule import ClearanceRule
    from optdock.model.limits import MotionLimits
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem

__all__ = ["ClearanceCurve", "ShownMotion", "clearance_curve", "shown_motion", "thinned"]

_MOST_POINTS = 400  # of a curve, and poses of the player
_FAR = 2.0  # [m]: largest shown clearance


class ShownMotion(NamedTuple):
    """Motion along the horizontal axis of the figures: time, or arc length without a trajectory.

    Attributes:
        clock: `time` or `arc length`.
        unit: Unit of the clock.
        at: Clock at the poses, Shape (n,).
        poses: Shape (n, 3).
        panels: The quantities with their bounds.
        panels_at: Clock at the values of the panels, Shape (m,).
        cusps: Clock at the cusps.
    """

    clock: str
    unit: str
    at: FloatArray
    poses: FloatArray
    panels: Sequence[MotionPanel]
    panels_at: FloatArray
    cusps: FloatArray

    @property
    def label(self) -> str:
        """Label of the horizontal axis."""
        return f"{self.clock} [{self.unit}]"


def thinned(count: int, most: int = _MOST_POINTS) -> FloatArray:
    """Return at most `most` rows of `count` rows at equal distances, with the first and the last one."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def shown_motion(plan: PlanFile, path: Path, problem: DockingProblem | None) -> ShownMotion:
    """Return the motion of a plan file, or its path if it has no motion.

    Args:
        plan: The file.
        path: Its path.
        problem: Its problem; None if it is not known.
    """
    columns = plan.trajectory
    limits = None if problem is None else problem.robot.limits
    if columns is None:
        s = np.linspace(0.0, path.length, _MOST_POINTS)
        bent = MotionPanel(LIMITS["max_curvature"].label, path.curvature_at(s), *_bounds(limits, "max_curvature", s))
        panels = [bent, *_steering(limits, path, s)]
        return ShownMotion("arc length", "m", s, path.poses_at(s), panels, s, np.array(path.cusps))
    rows = thinned(columns.t.size)
    at, poses = columns.t[rows], np.column_stack((columns.x, columns.y, columns.yaw))[rows]
    if plan.time_law is None or problem is None or limits is None:
        return ShownMotion("time", "s", at, poses, _sampled_panels(columns, limits, rows), at, np.zeros(0))
    trajectory = Trajectory(path, plan.time_law)
    begun = np.concatenate(([0.0], np.cumsum(plan.time_law.durations)))
    times = np.union1d(
        np.clip(at - at[0], 0.0, trajectory.duration), np.clip([begun, begun - 1e-6], 0.0, trajectory.duration)
    )
    panels = motion_panels(trajectory, limits, problem.dock.approach, times)
    panels += _steering(limits, path, trajectory.sample_at(times).s)
    return ShownMotion("time", "s", at, poses, panels, times + at[0], trajectory.cusp_times + at[0])


def _sampled_panels(columns: TrajectoryColumns, limits: MotionLimits | None, rows: FloatArray) -> list[MotionPanel]:
    """Return the quantities of a motion that is known by samples."""
    names = {
        "speed": "max_speed", "acceleration": "max_acceleration", "jerk": "max_jerk", "yaw_rate": "max_yaw_rate",
        "yaw_acceleration": "max_yaw_acceleration",
    }  # fmt: skip
    return [
        MotionPanel(LIMITS[limit].label, getattr(columns, name)[rows], *_bounds(limits, limit, rows))
        for name, limit in names.items()
    ]


def _bounds(limits: MotionLimits | None, name: str, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    upper = np.full(len(rows), math.inf if limits is None else getattr(limits, name))
    below = upper if limits is None or name != "max_speed" else np.full(len(rows), limits.max_reverse_speed)
    return -below, upper


def _steering(limits: MotionLimits | None, path: Path, s: FloatArray) -> list[MotionPanel]:
    """Return the steering angle along the path, if the robot has a wheelbase."""
    if limits is None or limits.wheelbase == 0.0:
        return []
    angle = limits.steering_angle(path.curvature_at(s)) * path.direction_at(s)
    most = min(limits.max_steering_angle, math.atan(limits.wheelbase * limits.max_curvature))
    label = f"steering angle [{STEERING_UNITS['max_steering_angle']}]"
    return [MotionPanel(label, angle, np.full(s.size, -most), np.full(s.size, most))]


class ClearanceCurve(NamedTuple):
    """Clearances of poses, Shape (n,) each.

    `clearances`: signed clearance, at most 2 m [m]. `required`: required clearance [m]. `rows`: row of the nearest
    obstacle; -1 without one.
    """

    clearances: FloatArray
    required: FloatArray
    rows: IntArray

    @property
    def margins(self) -> FloatArray:
        """Clearance minus required clearance, Shape (n,) [m]."""
        margins: FloatArray = self.clearances - self.required
        return margins


def clearance_curve(
    poses: FloatArray, problem: DockingProblem, rule: ClearanceRule, relief: float = 0.0
) -> ClearanceCurve:
    """Return the clearances of poses and the required ones.

    Args:
        poses: Shape (n, 3).
        problem: The docking problem.
        rule: Clearance rule: that of the path, with the tracking tube, or that of driven poses.
        relief: Start relief of the rule [m].
    """
    clearances, rows = pose_clearances(poses, problem.robot.footprint, problem.all_obstacles, within=_FAR)
    required = rule.required_for(poses, problem.goal, problem.start, end_clearances(problem).start, relief)
    return ClearanceCurve(clearances, required, rows)
