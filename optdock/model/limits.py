"""Motion limits of the robot's drive.

`LIMITS` is the only table of the bounds in `MotionLimits`. The certificates, the checks of samples, the scenario files
and their reference, and the plots use the names, units and quantities of this table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import non_negative, number
from optdock.geometry.lazy import cached_property

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path

__all__ = [
    "DIMENSIONS",
    "LIMITS",
    "LIMIT_UNITS",
    "QUANTITY_UNITS",
    "STEERING_UNITS",
    "Limit",
    "LimitKind",
    "MotionLimits",
    "SpeedZone",
    "TurnLimits",
    "TurningMotion",
    "finite_limits",
]


class LimitKind(str, Enum):
    """Variables on which a limited quantity depends; they determine the certificate that proves the limit.

    Trajectory certificates prove the first two kinds, and path certificates prove the last kind.
    """

    TIME_LAW = "time law"
    TURNING = "time law and curvature"
    PATH = "path"


class TurningMotion(Protocol):
    """States of a motion along a curve at n instants, Shape (n,) each."""

    @property
    def v(self) -> FloatArray:
        """Speed along the travel [m/s]."""

    @property
    def a(self) -> FloatArray:
        """Acceleration along the travel [m/s^2]."""

    @property
    def k(self) -> FloatArray:
        """Curvature [1/m]."""

    @property
    def r(self) -> FloatArray:
        """Curvature rate [1/m^2]."""


class Limit(NamedTuple):
    """One bound of `MotionLimits`.

    Attributes:
        name: Field of `MotionLimits`.
        unit: SI.
        kind: Variables on which the quantity depends.
        formula: The bounded quantity in terms of speed v, its derivatives a and j, curvature k and its derivative k'
            per metre, track width b and wheelbase L.
        words: Description for the reference documentation.
        size: For `LimitKind.TURNING`: function that returns the absolute value of the quantity at instants of a motion,
            Shape (n,).
        steered: Whether the limit applies only to robots with steered wheels.
        finite: Whether the limit must be finite.
    """

    name: str
    unit: str
    kind: LimitKind
    formula: str
    words: str
    size: Callable[[TurningMotion, MotionLimits], FloatArray] | None = None
    steered: bool = False
    finite: bool = False

    @property
    def quantity(self) -> str:
        """Name of the quantity in ratios and violations of certificates; both gears share the name `speed`."""
        return "speed" if self.name == "max_reverse_speed" else self.name.removeprefix("max_")

    @property
    def label(self) -> str:
        """Name of the quantity with its unit."""
        return f"{self.quantity.replace('_', ' ')} [{self.unit}]"


_SIZES: dict[str, Callable[[TurningMotion, MotionLimits], FloatArray]] = {
    "max_yaw_rate": lambda at, _: np.abs(at.v * at.k),
    "max_yaw_acceleration": lambda at, _: np.abs(at.a * at.k + at.v * at.v * at.r),
    "max_lateral_acceleration": lambda at, _: at.v * at.v * np.abs(at.k),
    "max_lateral_jerk": lambda at, _: np.abs(at.v * (2.0 * at.a * at.k + at.v * at.v * at.r)),
    "max_wheel_speed": lambda at, drive: np.abs(at.v) * (1.0 + 0.5 * drive.track_width * np.abs(at.k)),
    "max_steering_rate": lambda at, drive: (
        np.abs(drive.wheelbase * at.r * at.v) / (1.0 + (drive.wheelbase * at.k) ** 2)
    ),
}
_LAW, _TURNING, _PATH = LimitKind.TIME_LAW, LimitKind.TURNING, LimitKind.PATH
_ANGLE = "of the wheels, |atan(wheelbase * curvature)|; bounds the curvature in addition to max_curvature"
_RATE = "at which the wheels turn, also at rest between two gears"
_TABLE = (
    Limit("max_speed", "m/s", _LAW, "v", "largest speed forward", finite=True),
    Limit("max_reverse_speed", "m/s", _LAW, "v", "largest speed in reverse", finite=True),
    Limit("max_acceleration", "m/s^2", _LAW, "a", "speeding up, in either gear", finite=True),
    Limit("max_deceleration", "m/s^2", _LAW, "-a", "slowing down, in either gear", finite=True),
    Limit("max_jerk", "m/s^3", _LAW, "|j|", "change of acceleration", finite=True),
    Limit("max_yaw_rate", "rad/s", _TURNING, "|v k|", "turning left or right"),
    Limit("max_yaw_acceleration", "rad/s^2", _TURNING, "|a k + v^2 k'|", "change of the yaw rate"),
    Limit("max_lateral_acceleration", "m/s^2", _TURNING, "v^2 |k|", "speed^2 * |curvature|"),
    Limit("max_lateral_jerk", "m/s^3", _TURNING, "|2 v a k + v^3 k'|", "change of the lateral acceleration"),
    Limit("max_wheel_speed", "m/s", _TURNING, "|v| (1 + b |k| / 2)", "rim speed of either wheel"),
    Limit("max_curvature", "1/m", _PATH, "|k|", "1 / smallest turning radius"),
    Limit("max_curvature_rate", "1/m^2", _PATH, "|k'|", "|d curvature / ds|: steering rate per metre of path"),
    Limit("max_steering_angle", "rad", _PATH, "|atan(L k)|", _ANGLE, steered=True),
    Limit("max_steering_rate", "rad/s", _TURNING, "L |k' v| / (1 + (L k)^2)", _RATE, steered=True),
)
LIMITS: Mapping[str, Limit] = MappingProxyType(
    {limit.name: limit._replace(size=_SIZES.get(limit.name)) for limit in _TABLE}
)
QUANTITY_UNITS = {limit.quantity: limit.unit for limit in _TABLE} | {"yaw_jerk": "rad/s^3"}
LIMIT_UNITS = {name: limit.unit for name, limit in LIMITS.items() if not limit.steered}
STEERING_UNITS = {name: limit.unit for name, limit in LIMITS.items() if limit.steered}
DIMENSIONS = {
    "track_width": "distance between the wheels, for max_wheel_speed",
    "wheelbase": "distance between the axles, for the limits of the steering",
}
"""Fields of `MotionLimits` that are dimensions [m] and not bounds, with their descriptions."""


class TurnLimits(NamedTuple):
    """Bounds on turning in place, in either direction: rate [rad/s], acceleration [rad/s^2], jerk [rad/s^3].

    `inf` means unlimited.
    """

    rate: float
    acceleration: float
    jerk: float


@dataclass(frozen=True)
class MotionLimits:
    """Bounds on motion along a path; `inf` means unlimited.

    Args:
        max_speed: Largest speed forward [m/s].
        max_reverse_speed: Largest speed in reverse, positive [m/s].
        max_acceleration: Largest acceleration, in either gear [m/s^2].
        max_deceleration: Largest deceleration, positive, in either gear [m/s^2].
        max_jerk: Largest jerk [m/s^3].
        max_yaw_rate: [rad/s].
        max_yaw_acceleration: [rad/s^2].
        max_lateral_acceleration: speed^2 * |curvature| [m/s^2].
        max_wheel_speed: Rim speed of either wheel, |v| * (1 + track_width / 2 * |curvature|) [m/s].
        track_width: Distance between the wheels [m]; used for max_wheel_speed and for turns in place.
        max_curvature: 1 / smallest turning radius [1/m]; reduced to the curvature at `max_steering_angle` if that is
            smaller.
        max_curvature_rate: |d curvature / ds| [1/m^2].
        wheelbase: Distance between the axles of a robot with steered wheels [m]; required by the two limits below.
        max_steering_angle: |atan(wheelbase * curvature)| [rad].
        max_steering_rate: Steering rate [rad/s]. It also applies at rest: the robot waits at jumps of the curvature,
            and at a start from rest with an unknown steering angle.
        max_lateral_jerk: |d/dt (speed^2 * curvature)| [m/s^3] [UN79]; 0 at rest and in turns in place.

    Raises:
        InvalidValue: If a bound is NaN or not > 0, a speed, acceleration or jerk limit is infinite, a steering angle is
            a quarter turn or more, or a steering limit is given without a wheelbase.
    """

    max_speed: float = 0.5
    max_reverse_speed: float = 0.3
    max_acceleration: float = 0.5
    max_deceleration: float = 0.6
    max_jerk: float = 2.0
    max_yaw_rate: float = math.inf
    max_yaw_acceleration: float = math.inf
    max_lateral_acceleration: float = math.inf
    max_wheel_speed: float = math.inf
    track_width: float = 0.0
    max_curvature: float = math.inf
    max_curvature_rate: float = math.inf
    wheelbase: float = 0.0
    max_steering_angle: float = math.inf
    max_steering_rate: float = math.inf
    max_lateral_jerk: float = math.inf

    def __post_init__(self) -> None:
        for spec in fields(self):
            value = vars(self)[spec.name] = number(getattr(self, spec.name), f"limits.{spec.name}")
            rule, holds = _rule(spec.name, value)
            if not holds:
                raise InvalidValue(f"limits.{spec.name}: must be {rule}, got {value}")
        for name, unit in STEERING_UNITS.items():
            if math.isfinite(getattr(self, name)) and self.wheelbase == 0.0:
                raise InvalidValue(f"limits.{name}: {getattr(self, name)} {unit} has no effect without wheelbase > 0 m")
        if math.isfinite(self.max_steering_angle):
            tightest = math.tan(self.max_steering_angle) / self.wheelbase
            vars(self).update(max_curvature=min(self.max_curvature, tightest))

    @cached_property
    def turning(self) -> TurnLimits:
        """Limits of a turn in place, in which the wheels run in opposite directions at track_width / 2 * yaw rate.

        If the track width is known, the wheels satisfy max_wheel_speed and the smaller of max_acceleration and
        max_deceleration. The yaw jerk is chosen such that the yaw acceleration builds up in the same time as the linear
        acceleration. This time is the larger of max_acceleration and max_deceleration, divided by max_jerk.
        """
        lever = 0.5 * self.track_width
        rate = min(self.max_yaw_rate, self.max_wheel_speed / lever if lever > 0.0 else math.inf)
        weaker, stronger = sorted((self.max_acceleration, self.max_deceleration))
        acceleration = min(self.max_yaw_acceleration, weaker / lever if lever > 0.0 else math.inf)
        return TurnLimits(rate, acceleration, acceleration * self.max_jerk / stronger)

    def steering_angle(self, curvature: FloatArray) -> FloatArray:
        """Return the steering angle on a path of this curvature, negated if driven in reverse. Shape (n,) [rad].

        In the bicycle model [DeLuca2001], the yaw rate is speed / wheelbase * tan(angle), with the sign of the speed.
        """
        angle: FloatArray = np.arctan(self.wheelbase * curvature)
        return angle

    def steering_per_metre(self, curvature: FloatArray, curvature_rate: FloatArray) -> FloatArray:
        """Return |d atan(wheelbase * curvature) / ds|, Shape (n,) [rad/m].

        Args:
            curvature: Shape (n,) [1/m].
            curvature_rate: Derivative of the curvature along the path, Shape (n,) [1/m^2].
        """
        turned: FloatArray = self.wheelbase * np.abs(curvature_rate) / (1.0 + (self.wheelbase * curvature) ** 2)
        return turned

    def steering_times(self, curvatures: FloatArray) -> FloatArray:
        """Return the times to steer between pairs of curvatures, Shape (n, 2) [1/m]. Shape (n,) [s].

        The signs of the curvatures are those for driving forward.
        """
        turned: FloatArray = np.abs(np.diff(self.steering_angle(curvatures), axis=1)[:, 0])
        return turned / self.max_steering_rate

    def start_wait(self, path: Path) -> float:
        """Return the longest time [s] to steer the wheels from an unknown angle to the angle at the start of `path`."""
        first, steers = path.segments[0], math.isfinite(self.max_steering_rate)
        return self.steering_time_to(abs(int(first.direction)) * float(first.curvature_at(0.0)[0])) if steers else 0.0

    def steering_time_to(self, curvature: float) -> float:
        """Return the longest time [s] to steer from an unknown angle to the angle for a curvature [1/m].

        The farthest initial angle is `max_steering_angle`. If this angle is unlimited, the farthest angle is the angle
        for `max_curvature`, or a quarter turn if both are unlimited. The time is 0 if `max_steering_rate` is unlimited.
        """
        if not math.isfinite(self.max_steering_rate):
            return 0.0
        begins = math.atan(self.wheelbase * abs(curvature))
        is_limited = math.isfinite(self.max_steering_angle)
        farthest = self.max_steering_angle if is_limited else math.atan(self.wheelbase * self.max_curvature)
        return (farthest + begins) / self.max_steering_rate


def finite_limits(limits: MotionLimits) -> dict[str, float]:
    """Return all finite bounds by name, including bounds that are not in `LIMITS` and those of a subclass."""
    values = {name: getattr(limits, name) for name in limits.__dataclass_fields__ if name not in DIMENSIONS}
    return {name: value for name, value in values.items() if -math.inf < value < math.inf}


def _rule(name: str, value: float) -> tuple[str, bool]:
    """Return the constraint on a field in words, and whether `value` satisfies it."""
    if name in DIMENSIONS:
        return "finite and >= 0 m", math.isfinite(value) and value >= 0.0
    limit = LIMITS.get(name)
    unit = f" {limit.unit}" if limit else ""
    if limit and limit.finite:
        finite = math.isfinite(value)
        return f"{'' if finite else 'finite and '}> 0{unit}", finite and value > 0.0
    if name == "max_steering_angle":
        return "> 0 and < pi / 2 rad, or inf", 0.0 < value < 0.5 * math.pi or value == math.inf
    return f"> 0{unit}", value > 0.0


@dataclass(frozen=True)
class SpeedZone:
    """A speed zone at the end of a path.

    Args:
        speed: Largest speed in the zone, in either gear [m/s].
        distance: Length of the zone [m]; 0 means no zone.

    Raises:
        InvalidValue: If the speed is not > 0 or the distance is not finite and >= 0.
    """

    speed: float = math.inf
    distance: float = 0.0

    def __post_init__(self) -> None:
        speed = number(self.speed, "speed zone: approach_speed")
        if not speed > 0.0:
            raise InvalidValue(f"speed zone: approach_speed must be > 0 m/s, got {speed}")
        vars(self).update(speed=speed, distance=non_negative(self.distance, "speed zone: approach_distance", "m"))
