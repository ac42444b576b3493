"""The robot: outline, drive and limits."""

from __future__ import annotations

import functools
import math
from dataclasses import astuple, dataclass
from enum import Enum
from typing import NamedTuple

from optdock.fingerprint import digest
from optdock.geometry.checked import instance, member
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Twist2
from optdock.limits import MotionLimits

__all__ = ["Drive", "Robot", "RobotFingerprint", "admissible"]


class Drive(str, Enum):
    """How the robot steers."""

    DIFFERENTIAL = "differential"
    ACKERMANN = "ackermann"


@dataclass(frozen=True, eq=False)
class Robot:
    """What drives: outline, steering and limits.

    Args:
        footprint: Outline in the robot's frame; the frame's origin is the point that follows the path.
        limits: Bounds on its motion.
        drive: How it steers, a `Drive` or its word.

    Raises:
        InvalidValue: The drive is none, or a part is of another class.
    """

    footprint: Footprint
    limits: MotionLimits
    drive: Drive = Drive.DIFFERENTIAL

    def __post_init__(self) -> None:
        instance(Footprint, self.footprint, "robot.footprint")
        instance(MotionLimits, self.limits, "robot.limits")
        object.__setattr__(self, "drive", member(Drive, self.drive, "robot.drive"))

    @functools.cached_property
    def fingerprint(self) -> RobotFingerprint:
        """Digests of its outline, and of its limits and drive."""
        limits = digest(astuple(self.limits), self.drive.value)
        return RobotFingerprint(digest(self.footprint.vertices), limits)


class RobotFingerprint(NamedTuple):
    """Digests of a robot's outline, and of its limits and drive; see `ProblemFingerprint`."""

    footprint: str
    limits: str


def admissible(command: Twist2, limits: MotionLimits, drive: Drive = Drive.DIFFERENTIAL) -> Twist2:
    """The command that the drive can follow: slowed down as a whole, so that its curvature stays.

    Speed, yaw rate, wheel speed and lateral acceleration are brought within the limits; an Ackermann drive first
    gives up the part of the turn that its smallest radius forbids. Sideways speed is dropped.
    """
    v, w = command.linear, command.angular
    if drive is Drive.ACKERMANN:
        most = limits.max_curvature * abs(v) if v != 0.0 else 0.0
        w = min(max(w, -most), most)
    top = limits.max_speed if v >= 0.0 else limits.max_reverse_speed
    scale = min(
        _share(top, abs(v)),
        _share(limits.max_yaw_rate, abs(w)),
        _share(limits.max_wheel_speed, abs(v) + 0.5 * limits.track_width * abs(w)),
        math.sqrt(_share(limits.max_lateral_acceleration, abs(v * w))),
    )
    return Twist2(v * scale, w * scale)


def _share(limit: float, value: float) -> float:
    """How much of `value` the limit allows, at most 1."""
    return 1.0 if value <= limit else limit / value
