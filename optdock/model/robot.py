"""The robot: outline, drive and limits."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, fields
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

from optdock.errors import InvalidValue
from optdock.geometry.checked import exactly, finite_number, instance, member, number
from optdock.geometry.fingerprint import digest
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Twist2, displacement
from optdock.model.camera import Camera
from optdock.model.limits import STEERING_UNITS, MotionLimits

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["Drive", "Robot", "RobotFingerprint", "TrackingTube", "admissible", "check_drive", "check_price"]

_DIGESTED = 15  # fields of `MotionLimits` that digests have counted from the beginning; later ones where they are set


class Drive(str, Enum):
    """How the robot steers."""

    DIFFERENTIAL = "differential"
    ACKERMANN = "ackermann"


@dataclass(frozen=True)
class TrackingTube:
    """How far the robot may be off its path; a certificate holds for every pose within.

    A pose that is off by `cross` and turned by `yaw` moves no point of the footprint by more than
    cross + 2 R sin(yaw / 2), R the circumscribed radius: so much more clearance is kept along the path. It tapers at
    the dock as the clearance does, where the robot comes to rest and is to touch. `optdock simulate` prints the tube
    that a drive needs.

    Args:
        cross: Largest distance from the path [m].
        yaw: Largest heading error [rad].

    Raises:
        InvalidValue: One is negative or not finite, or `yaw` is more than half a turn.
    """

    cross: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        for name, unit, most in (("cross", "m", math.inf), ("yaw", "rad", math.pi)):
            value = number(getattr(self, name), f"robot.tracking.{name}")
            object.__setattr__(self, name, value)
            if not (math.isfinite(value) and 0.0 <= value <= most):
                up_to = f" and <= {most:.4f}" if math.isfinite(most) else ""
                raise InvalidValue(f"robot.tracking.{name}: must be finite and >= 0{up_to} {unit}, got {value}")

    def width(self, footprint: Footprint) -> float:
        """Largest displacement of a point of the footprint [m]."""
        return float(displacement(self.cross, self.yaw, footprint.circumscribed_radius))


@dataclass(frozen=True, eq=False)
class Robot:
    """What drives: outline, steering and limits.

    Args:
        footprint: Outline in the robot's frame; the frame's origin is the point that follows the path.
        limits: Bounds on its motion.
        drive: How it steers, a `Drive` or its word.
        turns_in_place: Whether its paths may turn where it stands (`TurnSegment`); a differential drive that has limits
            for it.
        tracking: How far it may be off its path.
        camera: What it detects the dock's marker with, or None; see `Dock.visible_distance`.
        reverse_price: What a metre in reverse is worth beside its time when plans are compared [s/m].

    Raises:
        InvalidValue: The drive is none, a part is of another class, the price is negative or not finite, a differential
            drive has a steering angle or rate, or a robot turns in place that cannot or whose turns nothing limits.
    """

    footprint: Footprint
    limits: MotionLimits
    drive: Drive = Drive.DIFFERENTIAL
    turns_in_place: bool = False
    tracking: TrackingTube = TrackingTube()
    camera: Camera | None = None
    reverse_price: float = 0.0

    def __post_init__(self) -> None:
        exactly(Footprint, self.footprint, "robot.footprint")
        exactly(MotionLimits, self.limits, "robot.limits")  # of what a subclass bounds beside it nothing is proven
        object.__setattr__(self, "drive", member(Drive, self.drive, "robot.drive"))
        instance(bool, self.turns_in_place, "robot.turns_in_place")
        exactly(TrackingTube, self.tracking, "robot.tracking")
        if self.camera is not None:
            exactly(Camera, self.camera, "robot.camera")
        check_drive(self.drive, self.limits, turns_in_place=self.turns_in_place)
        object.__setattr__(self, "reverse_price", check_price(self.reverse_price))

    @functools.cached_property
    def fingerprint(self) -> RobotFingerprint:
        """Digests of its outline, and of its limits, drive, camera and price of reversing."""
        # What a robot does not use is not part of its digest: certificates outlive the limits that came after them.
        steering = {"wheelbase", *STEERING_UNITS} if self.limits.wheelbase == 0.0 else set()
        values = {spec.name: getattr(self.limits, spec.name) for spec in fields(self.limits)}
        defaults = {spec.name: spec.default for spec in fields(self.limits)}
        first, later = list(values)[:_DIGESTED], list(values)[_DIGESTED:]
        limits = tuple(values[name] for name in first if name not in steering)
        turns = ("turns in place",) if self.turns_in_place else ()
        others = [(name, values[name]) for name in later if values[name] != defaults[name]]
        seen = () if self.camera is None else _camera_parts(self.camera)
        reversing = ("reverse price", (self.reverse_price,)) if self.reverse_price > 0.0 else ()
        parts = (limits, self.drive.value, *turns, *(part for pair in others for part in pair), *seen, *reversing)
        return RobotFingerprint(digest(self.footprint.vertices), digest(*parts))


def _camera_parts(camera: Camera) -> tuple[str | FloatArray | tuple[float, ...], ...]:
    """What a digest counts of a camera."""
    return "camera", camera.mount.as_array(), (camera.field_of_view, camera.min_range, camera.max_range)


def check_price(price: float) -> float:
    """The price of a metre in reverse as a float [s/m].

    Raises:
        InvalidValue: It is not a number, negative or not finite.
    """
    found = finite_number(price, "robot.reverse_price")
    if found < 0.0:
        raise InvalidValue(f"robot.reverse_price: must be >= 0 s/m, got {found}")
    return found


def check_drive(drive: Drive, limits: MotionLimits, *, turns_in_place: bool) -> None:
    """Refuse limits that a drive does not have, and turns in place without theirs.

    Raises:
        InvalidValue: A differential drive, which has no wheels to steer, has a steering angle or rate; another one
            turns in place; or nothing limits the yaw rate or the yaw acceleration of such turns.
    """
    for name, unit in STEERING_UNITS.items():
        value = getattr(limits, name)
        if drive is Drive.DIFFERENTIAL and math.isfinite(value):
            raise InvalidValue(f"robot.limits.{name}: {value} {unit} is for drive: ackermann; this one is differential")
    if turns_in_place and drive is not Drive.DIFFERENTIAL:
        raise InvalidValue(f"robot.turns_in_place: is for drive: differential; drive: {drive.value} cannot")
    if turns_in_place and not all(map(math.isfinite, limits.turning)):
        needed = "max_yaw_rate and max_yaw_acceleration, or max_wheel_speed and track_width"
        raise InvalidValue(f"robot.turns_in_place: needs limits: {needed}")


class RobotFingerprint(NamedTuple):
    """Digests of a robot's outline, and of its limits, drive, camera and reverse price; see `ProblemFingerprint`."""

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
