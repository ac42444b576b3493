"""What was measured and commanded on one drive, as arrays, whichever file it comes from."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.executor.checked_inputs import CheckedDockType
from optdock.geometry.pose import Pose2, normalize_angle, unwrap_yaw
from optdock.plugins.interfaces import DockType
from optdock.plugins.registry import create_plugin

if TYPE_CHECKING:
    from optdock.executor.log import DockingLog
    from optdock.geometry.arrays import FloatArray
    from optdock.model.measurements import Measurements
    from optdock.model.robot import Robot

__all__ = ["Path2", "Recording", "recording_of_log"]

_SAME = 1e-6  # [m], [rad]: a correction of the odometry that has not changed, to rounding


class Path2(NamedTuple):
    """Dead reckoning: times, Shape (n,), rising [s], poses, Shape (n, 3), yaw continuous, in a frame of its own."""

    times: FloatArray
    poses: FloatArray


class Recording(NamedTuple):
    """One drive. Stamps are on the clock of its measurements [s], poses in rows of x, y [m], yaw [rad].

    Attributes:
        source: The file.
        times: Of the control cycles, Shape (n,).
        commands: Linear and angular, given then, Shape (n, 2) [m/s, rad/s].
        twists: Linear and angular, told then, Shape (n, 2).
        odometry: Stamps and poses of the odometry, each once, Shape (m, 4); empty where only twists were told.
        odometry_twists: Told with those poses, Shape (m, 2).
        odometry_ages: Of the newest pose in each cycle, Shape (n,) or empty [s].
        localization: Stamps and poses in the map, each estimate once, Shape (k, 4).
        detections: Stamps, poses of the docked robot seen from the robot, told sigmas, Shape (d, 6).
        stored: Where the dock is stored in the map; None: there is none.
        docked_at: When it was said to be docked [s]; None: it was not.
        robot: As it was planned for; None: not known.
    """

    source: str
    times: FloatArray
    commands: FloatArray
    twists: FloatArray
    odometry: FloatArray
    odometry_twists: FloatArray
    odometry_ages: FloatArray
    localization: FloatArray
    detections: FloatArray
    stored: Pose2 | None
    docked_at: float | None
    robot: Robot | None

    @property
    def track_width(self) -> float:
        """Distance between the wheels [m]; 0: not known."""
        return 0.0 if self.robot is None else self.robot.limits.track_width

    @property
    def path(self) -> Path2:
        """The way of the robot by its odometry: its poses, or else the integral of its twists."""
        if len(self.odometry) > 1:
            return Path2(self.odometry[:, 0], np.column_stack((self.odometry[:, 1:3], unwrap_yaw(self.odometry[:, 3]))))
        steps, mean = np.diff(self.times), 0.5 * (self.twists[1:] + self.twists[:-1])
        yaw = np.concatenate(([0.0], np.cumsum(mean[:, 1] * steps)))
        middle, way = 0.5 * (yaw[1:] + yaw[:-1]), mean[:, 0] * steps
        x, y = (np.concatenate(([0.0], np.cumsum(way * part))) for part in (np.cos(middle), np.sin(middle)))
        return Path2(self.times, np.column_stack((x, y, yaw)))


def recording_of_log(log: DockingLog) -> Recording:
    """The drive of a docking log; its detections are those that its dock type took for its own.

    Raises:
        PluginError: The dock type is not installed, or answers something else than it is asked.
        InvalidValue: Its parameters are not those of the installed one.
    """
    cycles = [cycle for cycle in log.cycles if np.isfinite(cycle.measurements.stamp)]
    measured = [cycle.measurements for cycle in cycles]
    times = np.array([one.stamp for one in measured])
    rising = np.concatenate(([True], times[1:] > np.maximum.accumulate(times)[:-1]))
    commands = np.array([(cycle.command.linear, cycle.command.angular) for cycle in cycles]).reshape(-1, 2)
    twists = np.array([(one.twist.linear, one.twist.angular) for one in measured]).reshape(-1, 2)
    odometry, odometry_twists = _odometry(measured)
    ages = [one.stamp - one.odometry.stamp for one in measured if one.odometry is not None]
    ages = [age for age in ages if math.isfinite(age)]
    ending = log.cycles[-1].ending
    is_docked = log.task.task == "dock" and ending is not None and ending.kind.succeeded
    return Recording(
        log.source,
        times[rising],
        commands[rising],
        twists[rising],
        odometry,
        odometry_twists,
        np.array(ages),
        _localization(measured),
        _detections(_of_dock(log, measured)),
        log.task.problem.goal,
        ending.stamp if is_docked and ending is not None else None,
        log.task.problem.robot,
    )


def _odometry(measured: list[Measurements]) -> tuple[FloatArray, FloatArray]:
    """Stamps and poses of the odometry, and the twists beside them, each once and in order."""
    rows, twists, newest = [], [], -np.inf
    for one in measured:
        if one.odometry is not None and one.odometry.stamp > newest:
            newest, pose = one.odometry.stamp, one.odometry.pose
            rows.append((newest, pose.x, pose.y, pose.yaw))
            twists.append((one.twist.linear, one.twist.angular))
    return np.array(rows).reshape(-1, 4), np.array(twists).reshape(-1, 2)


def _localization(measured: list[Measurements]) -> FloatArray:
    """Every estimate of the localization once.

    Where a pose is told in every cycle, it is the odometry's moved by a correction that changes now and then, as
    transforms from map to odom to base are looked up: each change is an estimate.
    """
    stamped = [(one.pose_stamp, one.pose) for one in measured if one.pose is not None and one.pose_stamp is not None]
    if stamped:
        newest = {stamp: pose for stamp, pose in stamped if stamp is not None}
        return np.array([(stamp, *pose.as_array()) for stamp, pose in sorted(newest.items())]).reshape(-1, 4)
    told = [(one.stamp, one.pose, one.odometry) for one in measured if one.pose is not None]
    if all(odometry is None for _, _, odometry in told):
        return np.array([(stamp, *pose.as_array()) for stamp, pose, _ in told]).reshape(-1, 4)
    rows, before = [], None
    for _, pose, odometry in told:
        if odometry is None:
            continue
        correction = pose @ odometry.pose.inverse()
        if before is None or not _is_same(correction, before):
            rows.append((odometry.stamp, *pose.as_array()))
        before = correction
    return np.array(rows).reshape(-1, 4)


def _is_same(one: Pose2, other: Pose2) -> bool:
    return max(abs(one.x - other.x), abs(one.y - other.y), abs(normalize_angle(one.yaw - other.yaw))) < _SAME


def _of_dock(log: DockingLog, measured: list[Measurements]) -> list[Measurements]:
    """The measurements as the executor received them: a log keeps detections in their order."""
    asked = log.task.dock_type
    if asked is None:
        return measured
    kind = CheckedDockType(create_plugin(DockType, asked.name, asked.parameters))
    return [one._replace(detections=kind.detections(one)) for one in measured]


def _detections(measured: list[Measurements]) -> FloatArray:
    """Detections in the order of their stamps, each once."""
    rows = {
        (one.stamp, one.pose.x, one.pose.y): (one.stamp, *one.pose.as_array(), one.position_sigma, one.yaw_sigma)
        for each in measured
        for one in each.detections
    }
    return np.array([rows[key] for key in sorted(rows)]).reshape(-1, 6)
