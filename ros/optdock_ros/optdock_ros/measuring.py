"""The newest messages as what the executor measures, without ROS.

Subscriptions only put messages away; the control loop takes them, once in every cycle. What is not fit to be believed
is left out under a name: `faults` says what is missing, and the executor stops the robot by its own patience.
"""

from __future__ import annotations

import math
from collections import deque
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from optdock import ros
from optdock.errors import InvalidMessage, OptdockError
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.measurements import Detection, Measurements, OdometryPose

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from optdock.model.costmap import Costmap
    from optdock.ros.transforms import Transform

__all__ = ["DatedCostmap", "Frames", "MeasurementRules", "Measuring"]

_QUEUED = 200  # messages between two cycles: at most 4 s of odometry at 50 Hz are worth having
_AHEAD = 0.1  # [s] that a stamp may lie ahead of this clock: two computers agree better than that, or not at all
_TRANSFORM_WAIT = 0.2  # [s] that a detection waits for its transform, as Nav2's
_AT_REST = 0.01  # [m/s], [rad/s] by encoders: a robot that stands


class Frames(Protocol):
    """Where frames stand to each other: a `TransformBuffer`."""

    def lookup(self, target: str, source: str, stamp: float | None = None, tolerance: float = 0.0) -> Transform:
        """The pose of `source` seen from `target`."""


class DatedCostmap(NamedTuple):
    """A costmap in the fixed frame, and when what it shows was seen [s]."""

    costmap: Costmap
    stamp: float


class MeasurementRules(NamedTuple):
    """Which measurements are used, and how long.

    Attributes:
        fixed_frame: In which the robot is located.
        base_frame: Of the robot.
        transform_tolerance: An older transform of the two is none [s].
        odom_tolerance: An older velocity is none [s].
        costmap_timeout: An older costmap is none [s]; None: there is no costmap.
        detection_timeout: An older detection is none [s].
    """

    fixed_frame: str
    base_frame: str
    transform_tolerance: float
    odom_tolerance: float
    costmap_timeout: float | None
    detection_timeout: float


class Measuring:
    """The measurements of one task; made anew for every task, so that none of the last one is used.

    Args:
        rules: What is believed.
        frames: Where the robot is.
        detect: Makes a detection of a message and of its frame as seen from the robot; None: nothing is detected.
        contact: Says at a time [s] whether the dock is felt; None where nothing tells.
        current: Says at a time [s] the current into the battery [A]; None where nothing tells.

    Attributes:
        faults: What is missing now, and why: `transform`, `odometry`, `costmap`, `detection`.
    """

    def __init__(
        self,
        rules: MeasurementRules,
        frames: Frames,
        detect: Callable[[Any, Transform], Detection] | None,
        contact: Callable[[float], bool | None],
        current: Callable[[float], float | None] = lambda _: None,
    ) -> None:
        self._rules, self._frames, self._detect, self._contact = rules, frames, detect, contact
        self._current = current
        self._odometry: deque[Any] = deque(maxlen=_QUEUED)
        self._seen: deque[Any] = deque(maxlen=_QUEUED)
        self._surroundings: DatedCostmap | None = None
        self._twist: tuple[float, Twist2] | None = None
        self._odometry_pose: OdometryPose | None = None
        self._heard, self._heard_at = Twist2(), -math.inf
        self._pose_stamp = -math.inf
        self.faults: Mapping[str, str] = {}
        self._now, self._asked_at = -math.inf, math.inf
        self._began: float | None = None

    @property
    def detects(self) -> bool:
        """Whether detections count."""
        return self._detect is not None

    def take_odometry(self, message: Any) -> None:
        """A new one; from any thread."""
        self._odometry.append((monotonic(), message))

    def take_detection(self, message: Any) -> None:
        """A new one; from any thread."""
        if self._detect is not None:
            self._seen.append(message)

    def take_surroundings(self, surroundings: DatedCostmap) -> None:
        """A new picture; from any thread."""
        self._surroundings = surroundings

    def measurements(self, now: float) -> Measurements:
        """What is known at a time [s]; in the thread of the control loop."""
        if now < self._now:  # whatever is stamped later than that would be believed for too long
            self._twist = self._odometry_pose = None
            self._pose_stamp = -math.inf
        self._now, is_first = now, self._began is None
        asked_before, self._asked_at = self._asked_at, monotonic()
        if self._began is None:
            self._began = now  # what was seen before cannot be placed on the way that the robot makes from now on
        faults: dict[str, str] = {}
        twist = self._velocity(now, faults)
        pose, pose_stamp = self._pose(now, faults) if twist is not None else (None, None)
        detections = self._detections(now, faults)
        costmap = self._costmap(now, faults)
        self.faults = faults
        if is_first and twist is not None and max(abs(twist.linear), abs(twist.angular)) < _AT_REST:
            twist = Twist2()  # encoders are never quite at rest; a robot that stands is commanded nothing to begin with
        if twist is None:
            # Stamps of another clock, or a clock that was set, place nothing; but what has just been heard is what the
            # robot does, and what a stop must begin with; but not what has waited for a process that was suspended.
            is_new = monotonic() - min(self._heard_at, asked_before) <= self._rules.odom_tolerance
            twist = self._heard if is_new else Twist2()
        contact, odometry = self._contact(now), self._odometry_pose
        current = self._current(now)
        return Measurements(now, pose, twist, detections, contact, costmap, odometry, pose_stamp, current=current)

    def _velocity(self, now: float, faults: dict[str, str]) -> Twist2 | None:
        """The newest body velocity; None where it is too old."""
        while self._odometry:
            heard_at, message = self._odometry.popleft()
            try:
                told = ros.odometry(message)
            except InvalidMessage as error:
                faults["odometry"] = str(error)
                continue
            self._heard, self._heard_at = told.twist, heard_at
            if told.stamp > now + _AHEAD:
                faults["odometry"] = f"it is stamped {told.stamp - now:.3f} s ahead of this clock"
                continue
            if self._twist is None or told.stamp > self._twist[0]:  # else delivered twice, or too late
                self._twist = told.stamp, told.twist
                self._odometry_pose = self._robot_by_odometry(told, faults)
        if self._twist is None:
            faults.setdefault("odometry", "none has come")
            return None
        age = now - self._twist[0]
        if age > self._rules.odom_tolerance:
            faults.setdefault("odometry", f"the last one is {age:.2f} s old")
            return None
        return self._twist[1]

    def _robot_by_odometry(self, told: ros.StampedOdometry, faults: dict[str, str]) -> OdometryPose | None:
        """The pose of the base, of which the odometry may tell that of another frame of the robot."""
        child, base = told.child_frame, self._rules.base_frame
        if child in ("", base):
            return OdometryPose(told.stamp, told.pose)
        try:
            return OdometryPose(told.stamp, told.pose @ self._frames.lookup(child, base).planar())
        except OptdockError as error:
            faults["odometry"] = str(error)
            return None

    def _pose(self, now: float, faults: dict[str, str]) -> tuple[Pose2 | None, float | None]:
        """Where the newest transform says that the robot is, and its stamp; one that has been used says nothing new."""
        rules = self._rules
        try:
            found = self._frames.lookup(rules.fixed_frame, rules.base_frame)
            pose = found.planar()
        except OptdockError as error:
            faults["transform"] = str(error)
            return None, None
        age = now - found.stamp
        if age > rules.transform_tolerance or age < -_AHEAD:
            faults["transform"] = f"{rules.fixed_frame} <- {rules.base_frame}: the last one is {age:.3f} s old"
            return None, None
        if found.stamp == self._pose_stamp:
            return None, None
        assert self._twist is not None
        if now - self._twist[0] > rules.transform_tolerance:
            return None, None  # the way since then is not known well enough
        self._pose_stamp = found.stamp
        return pose, min(found.stamp, now)

    def _detections(self, now: float, faults: dict[str, str]) -> tuple[Detection, ...]:
        """New ones, the oldest first."""
        found: list[Detection] = []
        for _ in range(len(self._seen)):
            message = self._seen.popleft()
            try:
                if self._began is not None and ros.seconds(message.header.stamp) < self._began:
                    continue
                detection = self._detection(message, now)
            except OptdockError as error:
                faults["detection"] = str(error)
                continue
            if detection is None:
                self._seen.append(message)
            else:
                found.append(detection)
        found.sort(key=lambda one: one.stamp)
        return tuple(found)

    def _detection(self, message: Any, now: float) -> Detection | None:
        """What a message says; None where its transform may be on its way.

        Raises:
            OptdockError: It is too old, or wrong.
        """
        stamp, frame = ros.seconds(message.header.stamp), message.header.frame_id
        age = now - stamp
        if age > self._rules.detection_timeout or age < -_AHEAD:
            raise InvalidMessage(f"PoseStamped: it is {age:.3f} s old")
        if not frame:
            raise InvalidMessage("PoseStamped: header.frame_id: must be the name of a frame, got ''")
        try:
            base = self._frames.lookup(self._rules.base_frame, frame, stamp)
        except OptdockError:
            if age < _TRANSFORM_WAIT:
                return None
            raise
        assert self._detect is not None
        return self._detect(message, base)

    def _costmap(self, now: float, faults: dict[str, str]) -> Costmap | None:
        """The surroundings, in every cycle as long as they are new enough: so their age is that of their stamp."""
        timeout, seen = self._rules.costmap_timeout, self._surroundings
        if timeout is None:
            return None
        if seen is None:
            faults["costmap"] = "none has come"
            return None
        age = now - seen.stamp
        if age > timeout or age < -timeout:
            faults["costmap"] = f"the last one is {age:.2f} s old"
            return None
        return seen.costmap
