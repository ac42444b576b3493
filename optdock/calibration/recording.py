"""Recordings: measurements and commands of one drive, from logs, run files and recordings of ROS 2."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from optdock.errors import InvalidFile, InvalidMessage, OptdockError
from optdock.executor.checked_inputs import CheckedDockType
from optdock.executor.log import LOG_FORMAT
from optdock.geometry.arrays import readonly
from optdock.geometry.pose import Pose2, normalize_angle, pose_errors, unwrap_yaw
from optdock.io.guarded_file import MostBytes, read_text
from optdock.io.run_file import RUN_FORMAT, load_run
from optdock.plugins.interfaces import DockType
from optdock.plugins.registry import create_plugin
from optdock.ros.bag import open_bag
from optdock.ros.motion import odometry, pose, twist

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.executor.log import DockingLog
    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.io.run_file import RunColumns
    from optdock.model.measurements import Measurements
    from optdock.model.robot import Robot
    from optdock.ros.bag import BagRecording
    from optdock.ros.messages import Message

__all__ = ["OdometryPath", "ReadFile", "Recording", "read_recording", "recording_of_log"]

_SAME = 1e-6  # [m], [rad]: corrections of the odometry that differ by less are equal up to rounding

_ODOMETRY = ("/odom", "/odometry/filtered")  # Nav2's names
_COMMANDS = ("/cmd_vel", "/cmd_vel_smoothed", "/cmd_vel_nav")
_COMMAND_TYPES = ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist")
_DETECTED = ("/detected_dock_pose",)
_Value = TypeVar("_Value")

_NONE, _NO_POSES, _NO_DETECTIONS = (readonly(np.zeros(shape)) for shape in ((0,), (0, 4), (0, 6)))


class OdometryPath(NamedTuple):
    """Path by dead reckoning, in an arbitrary frame.

    Attributes:
        times: Times in ascending order, Shape (n,) [s].
        poses: Poses with continuous yaw, Shape (n, 3).
    """

    times: FloatArray
    poses: FloatArray

    @property
    def increments(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distances along and across the mean heading [m] and turn [rad] of every step, Shape (n - 1,) each."""
        step = np.diff(self.poses, axis=0)
        middle = self.poses[:-1, 2] + 0.5 * step[:, 2]
        c, s = np.cos(middle), np.sin(middle)
        return c * step[:, 0] + s * step[:, 1], c * step[:, 1] - s * step[:, 0], step[:, 2]

    @property
    def ways(self) -> tuple[FloatArray, FloatArray]:
        """Distance along the heading [m] and turn [rad] since the beginning, Shape (n,) each."""
        return np.concatenate(([0.0], np.cumsum(self.increments[0]))), self.poses[:, 2] - self.poses[0, 2]


class Recording(NamedTuple):
    """One drive, with stamps [s] on the clock of the measurements, and poses as rows of x [m], y [m], yaw [rad].

    Attributes:
        source: File name.
        times: Times of the control cycles, Shape (n,).
        commands: Linear and angular commands of the cycles, Shape (n, 2) [m/s, rad/s].
        twists: Linear and angular speeds measured in the cycles, Shape (n, 2).
        odometry: Stamps and poses of the odometry, without duplicates, Shape (m, 4); empty if there were only twists.
        odometry_twists: Speeds measured with these poses, Shape (m, 2).
        odometry_ages: Age of the newest pose in each cycle, Shape (n,) or empty [s].
        localization: Stamps and poses in the map, each estimate once, Shape (k, 4).
        detections: Stamps, docked poses in the robot's frame, reported sigmas, Shape (d, 6).
        stored: Stored pose of the docked robot in the map; None if there is none.
        docked_at: Time at which docking succeeded [s]; None if docking did not succeed.
        robot: Robot for which the plans were made; None if unknown.
    """

    source: str
    times: FloatArray
    commands: FloatArray
    twists: FloatArray
    odometry: FloatArray
    odometry_twists: FloatArray
    odometry_ages: FloatArray = _NONE
    localization: FloatArray = _NO_POSES
    detections: FloatArray = _NO_DETECTIONS
    stored: Pose2 | None = None
    docked_at: float | None = None
    robot: Robot | None = None

    @property
    def track_width(self) -> float:
        """Distance between the wheels [m]; 0 if unknown."""
        return 0.0 if self.robot is None else self.robot.limits.track_width

    @property
    def path(self) -> OdometryPath:
        """Poses of the odometry, or the integral of the twists if there are no poses."""
        if len(self.odometry) > 1:
            poses = np.column_stack((self.odometry[:, 1:3], unwrap_yaw(self.odometry[:, 3])))
            return OdometryPath(self.odometry[:, 0], poses)
        steps, mean = np.diff(self.times), 0.5 * (self.twists[1:] + self.twists[:-1])
        yaw = np.concatenate(([0.0], np.cumsum(mean[:, 1] * steps)))
        middle, way = 0.5 * (yaw[1:] + yaw[:-1]), mean[:, 0] * steps
        x, y = (np.concatenate(([0.0], np.cumsum(way * part))) for part in (np.cos(middle), np.sin(middle)))
        return OdometryPath(self.times, np.column_stack((x, y, yaw)))


class ReadFile(NamedTuple):
    """Content of one recording, log or run file.

    Attributes:
        recording: The drive.
        deviation: Largest lateral [m] and heading [rad] deviation from the path during the docking; None if the file
            contains no completed docking along a path, or if the replay of the log gave different commands.
    """

    recording: Recording
    deviation: tuple[float, float] | None


def read_recording(source: str | Path) -> ReadFile:
    """Read a log, a run file or a recording of ROS 2.

    Raises:
        InvalidFile: If the file cannot be read, is of the wrong kind, or is damaged.
        MissingExtra: If a recording of ROS 2 is read without the extra `bag`.
    """
    source = Path(source)
    if source.is_dir() or source.suffix in (".mcap", ".db3"):
        return ReadFile(_recording_of_bag(source), None)
    kind = _format_of(source)
    if kind == RUN_FORMAT:
        run = load_run(source)
        return ReadFile(_recording_of_run(str(source), run), _deviation_of_run(run))
    if kind != LOG_FORMAT:
        raise InvalidFile(
            f"{source}: must be a log ({LOG_FORMAT}), a run file ({RUN_FORMAT}) or a recording (.mcap, .db3)"
        )
    from optdock.executor.log import read_log

    log = read_log(source)
    return ReadFile(recording_of_log(log), _deviation_of_log(log))


def _format_of(source: Path) -> str:
    """Return the name of the format, read from the first line or from the whole JSON file; empty if there is none."""
    text = read_text(source, MostBytes.LOG)
    for part in (text.partition("\n")[0], text):
        try:
            found = json.loads(part)
        except ValueError:
            continue
        if isinstance(found, dict):
            return str(found.get("format", ""))
    return ""


# Simulated runs: the true motion serves as odometry, the measured poses as localization.


def _recording_of_run(source: str, run: RunColumns) -> Recording:
    return Recording(
        source=source,
        times=run.times,
        commands=run.commands,
        twists=run.twists,
        odometry=np.column_stack((run.times, run.poses)),
        odometry_twists=run.twists,
        localization=np.column_stack((run.times, run.measured)),
        docked_at=float(run.times[-1]) if run.docked else None,
    )


def _deviation_of_run(run: RunColumns) -> tuple[float, float] | None:
    if not run.docked:
        return None
    off = np.abs(pose_errors(run.poses, run.planned))
    return float(np.max(off[:, 1])), float(np.max(off[:, 2]))


# Logs of dockings.


def recording_of_log(log: DockingLog) -> Recording:
    """Return the drive of a docking log, with the detections accepted by its dock type.

    Raises:
        PluginError: If the dock type is not installed or returns an invalid value.
        InvalidValue: If the installed dock type refuses its parameters.
    """
    cycles = [cycle for cycle in log.cycles if np.isfinite(cycle.measurements.stamp)]
    measured = [cycle.measurements for cycle in cycles]
    times = np.array([one.stamp for one in measured])
    rising = _are_rising(times)
    odometry_rows, odometry_twists = _log_odometry(measured)
    ages = [one.stamp - one.odometry.stamp for one in measured if one.odometry is not None]
    ending = log.cycles[-1].ending
    is_docked = log.task.task == "dock" and ending is not None and ending.kind.succeeded
    return Recording(
        source=log.source,
        times=times[rising],
        commands=_rows([(cycle.command.linear, cycle.command.angular) for cycle in cycles], 2)[rising],
        twists=_rows([(one.twist.linear, one.twist.angular) for one in measured], 2)[rising],
        odometry=odometry_rows,
        odometry_twists=odometry_twists,
        odometry_ages=np.array([age for age in ages if math.isfinite(age)]),
        localization=_log_localization(measured),
        detections=_log_detections(log, measured),
        stored=log.task.problem.goal,
        docked_at=ending.stamp if is_docked and ending is not None else None,
        robot=log.task.problem.robot,
    )


def _log_odometry(measured: list[Measurements]) -> tuple[FloatArray, FloatArray]:
    """Return the odometry stamps and poses and the twists of the same cycles, in order and without duplicates."""
    rows, twists, newest = [], [], -np.inf
    for one in measured:
        if one.odometry is not None and one.odometry.stamp > newest:
            newest = one.odometry.stamp
            rows.append((newest, *one.odometry.pose.as_array()))
            twists.append((one.twist.linear, one.twist.angular))
    return _rows(rows, 4), _rows(twists, 2)


def _log_localization(measured: list[Measurements]) -> FloatArray:
    """Return stamps and poses of the localization, each estimate once.

    Poses without stamps are obtained from transforms in every cycle, which apply a correction to the odometry. Each
    change of the correction counts as one estimate.
    """
    newest = {one.pose_stamp: one.pose for one in measured if one.pose is not None and one.pose_stamp is not None}
    if newest:
        return _rows([(stamp, *at.as_array()) for stamp, at in sorted(newest.items())], 4)
    poses = [(one.stamp, one.pose, one.odometry) for one in measured if one.pose is not None]
    if all(from_wheels is None for _, _, from_wheels in poses):
        return _rows([(stamp, *at.as_array()) for stamp, at, _ in poses], 4)
    rows, before = [], None
    for _, at, from_wheels in poses:
        if from_wheels is None:
            continue
        correction = at @ from_wheels.pose.inverse()
        if before is None or not _is_same(correction, before):
            rows.append((from_wheels.stamp, *at.as_array()))
        before = correction
    return _rows(rows, 4)


def _is_same(one: Pose2, other: Pose2) -> bool:
    return max(abs(one.x - other.x), abs(one.y - other.y), abs(normalize_angle(one.yaw - other.yaw))) < _SAME


def _log_detections(log: DockingLog, measured: list[Measurements]) -> FloatArray:
    """Return the detections that the dock type passed to the executor, in order of stamps, without duplicates."""
    choice = log.task.dock_type
    if choice is not None:
        kind = CheckedDockType(create_plugin(DockType, choice.name, choice.parameters))
        measured = [one._replace(detections=kind.detections(one)) for one in measured]
    rows = {
        (one.stamp, one.pose.x, one.pose.y): (one.stamp, *one.pose.as_array(), one.position_sigma, one.yaw_sigma)
        for each in measured
        for one in each.detections
    }
    return _rows([rows[key] for key in sorted(rows)], 6)


def _deviation_of_log(log: DockingLog) -> tuple[float, float] | None:
    from optdock.executor.replay import replay

    if log.task.task != "dock" or log.cycles[-1].ending is None:
        return None
    try:
        again = replay(log)
    except OptdockError:  # a plugin is not installed, or in another version
        return None
    return again.off_path if again and again.off_path != (0.0, 0.0) else None


# Recordings of ROS 2.


def _recording_of_bag(source: Path) -> Recording:
    """Return the drive in a recording of ROS 2.

    Detections must be in the robot's frame, for example in a file written by `optdock bag`.
    """
    with open_bag(source) as bag:
        odom = _topic(bag, _ODOMETRY, ("nav_msgs/msg/Odometry",), "odometry")
        cmd = _topic(bag, _COMMANDS, _COMMAND_TYPES, "commands")
        measured = [one for _, one in _values(bag, odom, odometry)]
        if len(measured) < 2:
            raise InvalidFile(f"{source}: {odom}: must have at least two messages, has {len(measured)}")
        begin, base = measured[0].stamp, measured[0].child_frame
        commands = [(time - begin, one.twist.linear, one.twist.angular) for time, one in _values(bag, cmd, twist)]
        seen = []
        topic = bag.find(_DETECTED, ("geometry_msgs/msg/PoseStamped",))
        for _, found in _values(bag, topic, pose):
            if found.frame != base:
                raise InvalidFile(f"{source}: {topic}: must be in frame {base}, is in {found.frame}")
            seen.append((found.stamp - begin, *found.pose.as_array(), 0.0, 0.0))
    rows = _rows([(one.stamp - begin, *one.pose.as_array()) for one in measured], 4)
    rising = _are_rising(np.array([one.stamp for one in measured]))
    rows, twists = rows[rising], _rows([(one.twist.linear, one.twist.angular) for one in measured], 2)[rising]
    command_rows = _rows(commands, 3)
    command_rows = command_rows[_are_rising(command_rows[:, 0])]
    near = np.clip(np.searchsorted(rows[:, 0], command_rows[:, 0]), 0, len(rows) - 1)
    return Recording(
        source=str(source),
        times=command_rows[:, 0],
        commands=command_rows[:, 1:],
        twists=twists[near],
        odometry=rows,
        odometry_twists=twists,
        detections=_rows(sorted(seen), 6),
    )


def _topic(bag: BagRecording, names: tuple[str, ...], kinds: tuple[str, ...], what: str) -> str:
    found = bag.find(names, kinds)
    if not found:
        raise InvalidFile(f"{bag.source}: has no {what}: none of the topics {', '.join(names)}")
    return found


def _values(bag: BagRecording, topic: str, convert: Callable[[Message], _Value]) -> Iterator[tuple[float, _Value]]:
    """Yield the times of reception [s] and the values of a topic's messages; errors contain file and topic."""
    for time, message in bag.messages(topic, 0.0, math.inf):
        try:
            value = convert(message)
        except InvalidMessage as error:
            raise InvalidFile(f"{bag.source}: {topic}: {error}") from error
        yield time, value


def _rows(rows: object, columns: int) -> FloatArray:
    """Return rows as an array, Shape (n, columns); n may be 0."""
    return np.array(rows, dtype=np.float64).reshape(-1, columns)


def _are_rising(stamps: FloatArray) -> BoolArray:
    """Return a mask of the stamps that are later than all previous stamps, Shape (n,)."""
    if not len(stamps):
        return np.zeros(0, dtype=np.bool_)
    return np.concatenate(([True], stamps[1:] > np.maximum.accumulate(stamps)[:-1]))
