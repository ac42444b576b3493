"""The executor's measurements from the newest messages, without ROS.

Subscriptions only store messages; the control loop processes them once per cycle. Invalid or old values are left out
and their causes are listed in `Measuring.faults`.
"""

from __future__ import annotations

import math
from collections import deque
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

from optdock import ros
from optdock.errors import InvalidMessage, OptdockError
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.measurements import Detection, Measurements, OdometryPose

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from optdock.model.costmap import Costmap
    from optdock.ros import Transform, TransformTree

__all__ = ["MeasurementRules", "Measuring"]

_QUEUED = 200  # messages between two cycles: 4 s of odometry at 50 Hz
_AHEAD = 0.1  # [s]: tolerance for the clocks of two computers
_TRANSFORM_WAIT = 0.2  # [s] for the transform of a detection to arrive, as in Nav2
_AT_REST = 0.01  # [m/s], [rad/s]: noise of the encoders of a robot at rest


class MeasurementRules(NamedTuple):
    """Frames, and largest ages of transform, velocity, costmap (None: no costmap is used) and detection [s]."""

    fixed_frame: str
    base_frame: str
    transform_tolerance: float
    odom_tolerance: float
    costmap_timeout: float | None
    detection_timeout: float


class Measuring:
    """The measurements of one task.

    Args:
        rules: Frames and largest ages.
        frames: Transforms.
        detect: Function that returns the detection of a message, given the pose of its frame in the robot's; None: no
            detections.
        contact: Function that returns the contact at a time [s]; None if unknown.
        current: Function that returns the current into the battery [A] at a time [s]; None if unknown.

    Attributes:
        faults: Causes of missing measurements: `transform`, `odometry`, `costmap`, `detection`.
    """

    def __init__(
        self,
        rules: MeasurementRules,
        frames: TransformTree,
        detect: Callable[[Any, Transform], Detection] | None,
        contact: Callable[[float], bool | None],
        current: Callable[[float], float | None] = lambda _: None,
    ) -> None:
        self._rules, self._frames, self._detect = rules, frames, detect
        self._contact, self._current = contact, current
        self._odometry: deque[Any] = deque(maxlen=_QUEUED)
        self._seen: deque[Any] = deque(maxlen=_QUEUED)
        self._surroundings: tuple[Costmap, float] | None = None
        self._twist: tuple[float, Twist2] | None = None
        self._odometry_pose: OdometryPose | None = None
        self._heard, self._heard_at = Twist2(), -math.inf
        self._pose_stamp = -math.inf
        self.faults: Mapping[str, str] = {}
        self._now, self._measured_at = -math.inf, math.inf
        self._began: float | None = None

    @property
    def detects(self) -> bool:
        """Whether detections are used."""
        return self._detect is not None

    def take_odometry(self, message: Any) -> None:
        """Store a message. Callable from any thread."""
        self._odometry.append((monotonic(), message))

    def take_detection(self, message: Any) -> None:
        """Store a message. Callable from any thread."""
        if self._detect is not None:
            self._seen.append(message)

    def take_surroundings(self, costmap: Costmap, stamp: float) -> None:
        """Replace the costmap in the fixed frame and its stamp [s]. Callable from any thread."""
        self._surroundings = costmap, stamp

    def measurements(self, now: float) -> Measurements:
        """Return the measurements at a time [s]; for the thread of the control loop."""
        if now < self._now:  # the clock was set back: later stamps would be accepted for too long
            self._twist = self._odometry_pose = None
            self._pose_stamp = -math.inf
        self._now, is_first = now, self._began is None
        measured_before, self._measured_at = self._measured_at, monotonic()
        if self._began is None:
            self._began = now
        faults: dict[str, str] = {}
        twist = self._velocity(now, faults)
        pose, pose_stamp = self._pose(now, faults) if twist is not None else (None, None)
        detections = self._detections(now, faults)
        costmap = self._costmap(now, faults)
        self.faults = faults
        if is_first and twist is not None and max(abs(twist.linear), abs(twist.angular)) < _AT_REST:
            twist = Twist2()
        if twist is None:
            # A stop must begin with the velocity just received, even if its stamp is of another clock, but not with a
            # velocity that was received before this process was suspended.
            is_new = monotonic() - min(self._heard_at, measured_before) <= self._rules.odom_tolerance
            twist = self._heard if is_new else Twist2()
        contact, odometry = self._contact(now), self._odometry_pose
        current = self._current(now)
        return Measurements(now, pose, twist, detections, contact, costmap, odometry, pose_stamp, current=current)

    def _velocity(self, now: float, faults: dict[str, str]) -> Twist2 | None:
        """Return the newest body velocity; None if it is too old."""
        while self._odometry:
            heard_at, message = self._odometry.popleft()
            try:
                odometry = ros.odometry(message)
            except InvalidMessage as error:
                faults["odometry"] = str(error)
                continue
            self._heard, self._heard_at = odometry.twist, heard_at
            if odometry.stamp > now + _AHEAD:
                faults["odometry"] = f"it is stamped {odometry.stamp - now:.3f} s ahead of this clock"
            elif self._twist is None or odometry.stamp > self._twist[0]:  # neither a duplicate nor out of order
                self._twist = odometry.stamp, odometry.twist
                self._odometry_pose = self._base_odometry(odometry, faults)
        if self._twist is None:
            faults.setdefault("odometry", "none has come")
            return None
        age = now - self._twist[0]
        if age > self._rules.odom_tolerance:
            faults.setdefault("odometry", f"the last one is {age:.2f} s old")
            return None
        return self._twist[1]

    def _base_odometry(self, odometry: ros.StampedOdometry, faults: dict[str, str]) -> OdometryPose | None:
        """Return the pose of the base from odometry, possibly of another frame of the robot."""
        child, base = odometry.child_frame, self._rules.base_frame
        if child in ("", base):
            return OdometryPose(odometry.stamp, odometry.pose)
        try:
            return OdometryPose(odometry.stamp, odometry.pose @ self._frames.lookup(child, base).planar())
        except OptdockError as error:
            faults["odometry"] = str(error)
            return None

    def _pose(self, now: float, faults: dict[str, str]) -> tuple[Pose2 | None, float | None]:
        """Return the pose of the newest transform and its stamp; None if it is too old or has been returned before."""
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
        assert self._twist is not None
        if found.stamp == self._pose_stamp or now - self._twist[0] > rules.transform_tolerance:
            return None, None  # with an old velocity the motion since then is too uncertain
        self._pose_stamp = found.stamp
        return pose, min(found.stamp, now)

    def _detections(self, now: float, faults: dict[str, str]) -> tuple[Detection, ...]:
        """Return the new detections in the order of their stamps."""
        found: list[Detection] = []
        for _ in range(len(self._seen)):
            message = self._seen.popleft()
            try:
                # The motion of the robot before the first cycle is unknown.
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
        """Return the detection of a message; None while its transform may arrive; raise if invalid or too old."""
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
        """Return the costmap in every cycle in which it is new enough."""
        timeout, seen = self._rules.costmap_timeout, self._surroundings
        if timeout is None:
            return None
        age = math.inf if seen is None else now - seen[1]
        if seen is None or abs(age) > timeout:
            faults["costmap"] = "none has come" if seen is None else f"the last one is {age:.2f} s old"
            return None
        return seen[0]
