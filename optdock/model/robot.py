"""The robot: footprint, drive and limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import Enum
from typing import NamedTuple

from optdock.errors import InvalidValue
from optdock.geometry.arrays import digest
from optdock.geometry.checked import exactly, instance, member, non_negative, number
from optdock.geometry.footprint import Footprint
from optdock.geometry.lazy import cached_property
from optdock.geometry.pose import Twist2, displacement
from optdock.model.camera import Camera
from optdock.model.limits import STEERING_UNITS, MotionLimits

__all__ = ["Drive", "Robot", "RobotFingerprint", "TrackingTube", "admissible", "check_drive", "check_price"]

_DIGESTED = 15  # leading fields of `MotionLimits` that are always digested; later ones only if not default


class Drive(str, Enum):
    """Steering principle of the robot."""

    DIFFERENTIAL = "differential"
    ACKERMANN = "ackermann"


@dataclass(frozen=True)
class TrackingTube:
    """Largest deviation of the robot from its path; a certificate holds for every pose within the tube.

    A position error `cross` and a heading error `yaw` move no point of the footprint by more than cross + 2 R sin(yaw /
    2), where R is the circumscribed radius. The path has this distance from obstacles in addition to the required
    clearance. Near the dock the tube tapers like the clearance, because the robot comes to rest in contact. `optdock
    simulate` prints the width of the tube that a drive needs.

    Args:
        cross: Largest distance from the path [m].
        yaw: Largest heading error [rad].

    Raises:
        InvalidValue: If a value is negative or not finite, or `yaw` is more than half a turn.
    """

    cross: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        for name, unit, most in (("cross", "m", math.inf), ("yaw", "rad", math.pi)):
            value = vars(self)[name] = number(getattr(self, name), f"robot.tracking.{name}")
            if not (math.isfinite(value) and 0.0 <= value <= most):
                up_to = f" and <= {most:.4f}" if math.isfinite(most) else ""
                raise InvalidValue(f"robot.tracking.{name}: must be finite and >= 0{up_to} {unit}, got {value}")

    def width(self, footprint: Footprint) -> float:
        """Return the largest displacement [m] of a footprint point within the tube."""
        return float(displacement(self.cross, self.yaw, footprint.circumscribed_radius))


@dataclass(frozen=True, eq=False)
class Robot:
    """Outline, drive and limits of the robot.

    Args:
        footprint: Outline in the robot frame; the origin of the frame is the point that follows the path.
        limits: Motion limits.
        drive: A `Drive` or its value.
        turns_in_place: Whether paths may contain turns in place (`TurnSegment`); requires a differential drive and
            limits.
        tracking: Largest deviation from the path.
        camera: Camera that detects the dock's marker, or None; see `Dock.visible_distance`.
        reverse_price: Cost of a metre in reverse in addition to its duration, for the comparison of plans [s/m].

    Raises:
        InvalidValue: If the drive is unknown, an argument has the wrong class, the price is negative or not finite, a
            differential drive has a steering limit, or a robot turns in place without a differential drive or without
            turn limits.
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
        exactly(MotionLimits, self.limits, "robot.limits")  # additional bounds of a subclass would not be proven
        vars(self).update(drive=member(Drive, self.drive, "robot.drive"), reverse_price=check_price(self.reverse_price))
        instance(bool, self.turns_in_place, "robot.turns_in_place")
        exactly(TrackingTube, self.tracking, "robot.tracking")
        if self.camera is not None:
            exactly(Camera, self.camera, "robot.camera")
        check_drive(self.drive, self.limits, turns_in_place=self.turns_in_place)

    @cached_property
    def fingerprint(self) -> RobotFingerprint:
        """Digests by which a certificate identifies the robot."""
        # Unused features are not digested, so certificates stay valid when optdock gains new limits.
        steering = {"wheelbase", *STEERING_UNITS} if self.limits.wheelbase == 0.0 else set()
        values = {spec.name: getattr(self.limits, spec.name) for spec in fields(self.limits)}
        defaults = {spec.name: spec.default for spec in fields(self.limits)}
        first, later = list(values)[:_DIGESTED], list(values)[_DIGESTED:]
        limits = tuple(values[name] for name in first if name not in steering)
        turns = ("turns in place",) if self.turns_in_place else ()
        others = [(name, values[name]) for name in later if values[name] != defaults[name]]
        camera = self.camera
        seen = (
            ("camera", camera.mount.as_array(), (camera.field_of_view, camera.min_range, camera.max_range))
            if camera is not None
            else ()
        )
        reversing = ("reverse price", (self.reverse_price,)) if self.reverse_price > 0.0 else ()
        parts = (limits, self.drive.value, *turns, *(part for pair in others for part in pair), *seen, *reversing)
        return RobotFingerprint(digest(self.footprint.vertices), digest(*parts))


class RobotFingerprint(NamedTuple):
    """Digest of the footprint, and common digest of limits, drive, camera and reverse price."""

    footprint: str
    limits: str


def check_price(price: float) -> float:
    """Return the cost of a metre in reverse as a float [s/m], after checking it.

    Raises:
        InvalidValue: If the price is not a finite number >= 0.
    """
    return non_negative(price, "robot.reverse_price", "s/m")


def check_drive(drive: Drive, limits: MotionLimits, *, turns_in_place: bool) -> None:
    """Check that the limits match the drive.

    Raises:
        InvalidValue: If a differential drive has a steering limit, another drive turns in place, or the yaw rate or yaw
            acceleration of turns in place is unlimited.
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


def admissible(command: Twist2, limits: MotionLimits, drive: Drive = Drive.DIFFERENTIAL) -> Twist2:
    """Return the command scaled down to the limits of the drive, with unchanged curvature.

    Speed, yaw rate, wheel speed and lateral acceleration satisfy the limits; for an Ackermann drive the curvature is
    first limited to max_curvature. The lateral speed is set to zero.
    """
    v, w = command.linear, command.angular
    if drive is Drive.ACKERMANN:
        most = limits.max_curvature * abs(v) if v != 0.0 else 0.0
        w = min(max(w, -most), most)
    top = limits.max_speed if v >= 0.0 else limits.max_reverse_speed
    speed, turn = abs(v), abs(w)
    rim, lateral = speed + 0.5 * limits.track_width * turn, speed * turn
    if (
        speed <= top
        and turn <= limits.max_yaw_rate
        and rim <= limits.max_wheel_speed
        and lateral <= limits.max_lateral_acceleration
    ):
        return command if w == command.angular and command.lateral == 0.0 else Twist2(v, w)
    scale = min(
        _share(top, speed),
        _share(limits.max_yaw_rate, turn),
        _share(limits.max_wheel_speed, rim),
        math.sqrt(_share(limits.max_lateral_acceleration, lateral)),
    )
    return Twist2(v * scale, w * scale)


def _share(limit: float, value: float) -> float:
    """Return the fraction of `value` that satisfies the limit, at most 1."""
    return 1.0 if value <= limit else limit / value
