"""The robot: outline, drive and limits."""

from __future__ import annotations

import functools
import math
from dataclasses import asdict, dataclass
from enum import Enum
from typing import NamedTuple

from optdock.errors import InvalidValue
from optdock.fingerprint import digest
from optdock.geometry.checked import instance, member
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Twist2
from optdock.limits import STEERING_UNITS, MotionLimits

__all__ = ["Drive", "Robot", "RobotFingerprint", "admissible", "check_drive"]


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
        InvalidValue: The drive is none, a part is of another class, or a differential drive has a steering angle or
            rate.
    """

    footprint: Footprint
    limits: MotionLimits
    drive: Drive = Drive.DIFFERENTIAL

    def __post_init__(self) -> None:
        instance(Footprint, self.footprint, "robot.footprint")
        instance(MotionLimits, self.limits, "robot.limits")
        object.__setattr__(self, "drive", member(Drive, self.drive, "robot.drive"))
        check_drive(self.drive, self.limits)

    @functools.cached_property
    def fingerprint(self) -> RobotFingerprint:
        """Digests of its outline, and of its limits and drive."""
        # What a robot does not use is no part of its digest: certificates outlive the limits that came after them.
        steering = {"wheelbase", *STEERING_UNITS} if self.limits.wheelbase == 0.0 else set()
        limits = tuple(value for name, value in asdict(self.limits).items() if name not in steering)
        return RobotFingerprint(digest(self.footprint.vertices), digest(limits, self.drive.value))


def check_drive(drive: Drive, limits: MotionLimits) -> None:
    """Refuse limits that a drive does not have.

    Raises:
        InvalidValue: A differential drive, which has no wheels to steer, has a steering angle or rate.
    """
    for name, unit in STEERING_UNITS.items():
        value = getattr(limits, name)
        if drive is Drive.DIFFERENTIAL and math.isfinite(value):
            raise InvalidValue(f"robot.limits.{name}: {value} {unit} is for drive: ackermann; this one is differential")


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
