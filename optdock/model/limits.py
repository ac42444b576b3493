"""What the robot's drive can do.

`LIMITS` is the one table of the bounds in `MotionLimits`: certificates, checks of samples, scenario files, their
reference and the pictures read names, units and quantities there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import number

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from optdock.geometry.arrays import FloatArray
    from optdock.model.path import Path

__all__ = [
    "DIMENSIONS",
    "LIMITS",
    "LIMIT_UNITS",
    "STEERING_UNITS",
    "Limit",
    "LimitKind",
    "MotionLimits",
    "SpeedZone",
    "TurnLimits",
    "TurningMotion",
    "check_steering",
    "finite_limits",
]


class LimitKind(str, Enum):
    """On what a limited quantity depends, and so which certificate proves it.

    The first two are proven of trajectories, the last of paths.
    """

    TIME_LAW = "time law"
    TURNING = "time law and curvature"
    PATH = "path"


class TurningMotion(Protocol):
    """Instants of a motion along a curve, Shape (n,) each."""

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
        """Its rate [1/m^2]."""


class Limit(NamedTuple):
    """One bound of `MotionLimits`.

    Attributes:
        name: Field of `MotionLimits`.
        unit: SI.
        kind: On what the quantity depends.
        formula: The bounded quantity: speed v, its rates a and j, curvature k and its rate k' per metre, track width b,
            wheelbase L; empty where the words say it.
        words: What it is, for references.
        size: Of `LimitKind.TURNING`: the bounded quantity, without its sign, at instants of a motion. Shape (n,).
        steered: Whether only robots that steer their wheels have it.
        finite: Whether it must be finite.
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
        """What is bounded, by its name in ratios and violations of certificates; both gears have a speed."""
        return "speed" if self.name == "max_reverse_speed" else self.name.removeprefix("max_")

    @property
    def label(self) -> str:
        """The quantity in words, with its unit."""
        return f"{self.quantity.replace('_', ' ')} [{self.unit}]"


_LAW, _TURNING, _PATH = LimitKind.TIME_LAW, LimitKind.TURNING, LimitKind.PATH
_TABLE = (
    Limit("max_speed", "m/s", _LAW, "v", "largest speed forward", finite=True),
    Limit("max_reverse_speed", "m/s", _LAW, "v", "largest speed in reverse", finite=True),
    Limit("max_acceleration", "m/s^2", _LAW, "a", "speeding up, in either gear", finite=True),
    Limit("max_deceleration", "m/s^2", _LAW, "-a", "slowing down, in either gear", finite=True),
    Limit("max_jerk", "m/s^3", _LAW, "|j|", "change of acceleration", finite=True),
    Limit(
        "max_yaw_rate",
        "rad/s",
        _TURNING,
        "|v k|",
        "turning left or right",
        lambda at, _: np.abs(at.v * at.k),
    ),
    Limit(
        "max_yaw_acceleration",
        "rad/s^2",
        _TURNING,
        "|a k + v^2 k'|",
        "change of the yaw rate",
        lambda at, _: np.abs(at.a * at.k + at.v * at.v * at.r),
    ),
    Limit(
        "max_lateral_acceleration",
        "m/s^2",
        _TURNING,
        "v^2 |k|",
        "speed^2 * |curvature|",
        lambda at, _: at.v * at.v * np.abs(at.k),
    ),
    Limit(
        "max_lateral_jerk",
        "m/s^3",
        _TURNING,
        "|2 v a k + v^3 k'|",
        "change of the lateral acceleration",
        lambda at, _: np.abs(at.v * (2.0 * at.a * at.k + at.v * at.v * at.r)),
    ),
    Limit(
        "max_wheel_speed",
        "m/s",
        _TURNING,
        "|v| (1 + b |k| / 2)",
        "rim speed of either wheel",
        lambda at, drive: np.abs(at.v) * (1.0 + 0.5 * drive.track_width * np.abs(at.k)),
    ),
    Limit("max_curvature", "1/m", _PATH, "|k|", "1 / smallest turning radius"),
    Limit(
        "max_curvature_rate",
        "1/m^2",
        _PATH,
        "|k'|",
        "|d curvature / ds|: how fast the steering turns along the path",
    ),
    Limit(
        "max_steering_angle",
        "rad",
        _PATH,
        "|atan(L k)|",
        "of the wheels, |atan(wheelbase * curvature)|; bounds the curvature beside max_curvature",
        steered=True,
    ),
    Limit(
        "max_steering_rate",
        "rad/s",
        _TURNING,
        "L |k' v| / (1 + (L k)^2)",
        "at which the wheels turn, also at rest between two gears",
        lambda at, drive: np.abs(drive.wheelbase * at.r * at.v) / (1.0 + (drive.wheelbase * at.k) ** 2),
        steered=True,
    ),
)
LIMITS: Mapping[str, Limit] = MappingProxyType({limit.name: limit for limit in _TABLE})
LIMIT_UNITS = {name: limit.unit for name, limit in LIMITS.items() if not limit.steered}
STEERING_UNITS = {name: limit.unit for name, limit in LIMITS.items() if limit.steered}
DIMENSIONS = {
    "track_width": "distance between the wheels, for max_wheel_speed",
    "wheelbase": "distance between the axles, for the limits of the steering",
}
"""The fields of `MotionLimits` that bound nothing [m], and what they are."""


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
        max_speed: Forward [m/s].
        max_reverse_speed: Backward, positive [m/s].
        max_acceleration: Speeding up, in either gear [m/s^2].
        max_deceleration: Slowing down, positive [m/s^2].
        max_jerk: [m/s^3].
        max_yaw_rate: [rad/s].
        max_yaw_acceleration: [rad/s^2].
        max_lateral_acceleration: speed^2 * |curvature| [m/s^2].
        max_wheel_speed: Rim speed of either wheel, |v| * (1 + track_width / 2 * |curvature|) [m/s].
        track_width: Distance between the wheels [m]; used with max_wheel_speed, and where the robot turns in place.
        max_curvature: 1 / smallest turning radius [1/m]; never more than what `max_steering_angle` allows.
        max_curvature_rate: |d curvature / ds| [1/m^2].
        wheelbase: Distance between the axles of a robot that steers its wheels [m]; needed by the two below.
        max_steering_angle: Of the wheels, |atan(wheelbase * curvature)| [rad].
        max_steering_rate: At which they turn [rad/s], at rest too: the robot waits for them where the curvature jumps,
            and at a start from rest where their angle is unknown.
        max_lateral_jerk: Change of the lateral acceleration, |d/dt (speed^2 * curvature)| [m/s^3] [UN79]; none at rest
            and in turns in place, where there is no speed.

    Raises:
        InvalidValue: A bound is not > 0, NaN, or speeds, accelerations or jerk are infinite; a steering angle of a
            quarter turn or more; an angle or a rate without a wheelbase.
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
            value = number(getattr(self, spec.name), f"limits.{spec.name}")
            object.__setattr__(self, spec.name, value)
            rule, holds = _rule(spec.name, value)
            if not holds:
                raise InvalidValue(f"limits.{spec.name}: must be {rule}, got {value}")
        check_steering(self.wheelbase, self.max_steering_angle, self.max_steering_rate)
        if math.isfinite(self.max_steering_angle):
            tightest = math.tan(self.max_steering_angle) / self.wheelbase
            object.__setattr__(self, "max_curvature", min(self.max_curvature, tightest))

    @property
    def turning(self) -> TurnLimits:
        """The limits of a turn in place, where the wheels run against each other at +-track_width / 2 * yaw rate.

        Their rims keep the wheel speed, and accelerate no faster than straight on, where the track width is known. The
        yaw acceleration takes as long to build up as the drive's own does straight on, max_acceleration / max_jerk (or
        deceleration, if that is larger): this is what bounds its jerk, as no limit names one.
        """
        lever = 0.5 * self.track_width
        rate = min(self.max_yaw_rate, self.max_wheel_speed / lever if lever > 0.0 else math.inf)
        weaker, stronger = sorted((self.max_acceleration, self.max_deceleration))
        acceleration = min(self.max_yaw_acceleration, weaker / lever if lever > 0.0 else math.inf)
        return TurnLimits(rate, acceleration, acceleration * self.max_jerk / stronger)

    def steering_angle(self, curvature: FloatArray) -> FloatArray:
        """Angle of the wheels on a path of this curvature, driven forward; in reverse the opposite. Shape (n,) [rad].

        The bicycle model [DeLuca2001]: the yaw rate is speed / wheelbase * tan(angle), with the sign of the speed.
        """
        angle: FloatArray = np.arctan(self.wheelbase * curvature)
        return angle

    def steering_per_metre(self, curvature: FloatArray, curvature_rate: FloatArray) -> FloatArray:
        """How far the wheels turn per metre of the way, |d atan(wheelbase * curvature) / ds|, Shape (n,) [rad/m].

        Args:
            curvature: Shape (n,) [1/m].
            curvature_rate: Its derivative along the way, likewise [1/m^2].
        """
        turned: FloatArray = self.wheelbase * np.abs(curvature_rate) / (1.0 + (self.wheelbase * curvature) ** 2)
        return turned

    def steering_times(self, curvatures: FloatArray) -> FloatArray:
        """How long the wheels take to turn between curvatures as driven forward, Shape (n, 2) [1/m]. Shape (n,) [s]."""
        turned: FloatArray = np.abs(np.diff(self.steering_angle(curvatures), axis=1)[:, 0])
        return turned / self.max_steering_rate

    def start_wait(self, path: Path) -> float:
        """How long a robot whose wheels may stand at any angle rests at the start of `path` until they are turned [s].

        See `steering_time_to`.
        """
        first = path.segments[0]
        return self.steering_time_to(abs(int(first.direction)) * float(first.curvature_at(0.0)[0]))

    def steering_time_to(self, curvature: float) -> float:
        """How long wheels that may stand at any angle take to turn to that of a curvature [1/m], at most [s].

        The farthest angle is `max_steering_angle`; where that is unlimited, the one of `max_curvature`, or else a
        quarter turn. 0 where `max_steering_rate` is unlimited.
        """
        if not math.isfinite(self.max_steering_rate):
            return 0.0
        begins = math.atan(self.wheelbase * abs(curvature))
        is_limited = math.isfinite(self.max_steering_angle)
        farthest = self.max_steering_angle if is_limited else math.atan(self.wheelbase * self.max_curvature)
        return (farthest + begins) / self.max_steering_rate


def finite_limits(limits: MotionLimits) -> dict[str, float]:
    """Every bound that is finite, by its name, one that `LIMITS` does not know included."""
    values = {spec.name: getattr(limits, spec.name) for spec in fields(limits) if spec.name not in DIMENSIONS}
    return {name: value for name, value in values.items() if math.isfinite(value)}


def check_steering(wheelbase: float, angle: float, rate: float) -> None:
    """Refuse limits of a steering whose geometry is unknown.

    Args:
        wheelbase: Distance between the axles [m]; 0 where it is not known.
        angle: Largest steering angle [rad]; inf without a limit.
        rate: Largest steering rate [rad/s]; likewise.

    Raises:
        InvalidValue: One of them is limited, and the wheelbase is 0.
    """
    for name, value in (("max_steering_angle", angle), ("max_steering_rate", rate)):
        if math.isfinite(value) and wheelbase == 0.0:
            raise InvalidValue(f"limits.{name}: {value} {LIMITS[name].unit} means nothing without wheelbase > 0 m")


def _rule(name: str, value: float) -> tuple[str, bool]:
    """What the value of a field must be, in words, and whether it is."""
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
    """A slower stretch at the end of a path.

    Args:
        speed: Largest speed there, in either gear [m/s].
        distance: How far before the end it begins [m]; 0 means no zone.

    Raises:
        InvalidValue: Speed not > 0 or distance not finite and >= 0.
    """

    speed: float = math.inf
    distance: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "speed", number(self.speed, "speed zone: approach_speed"))
        object.__setattr__(self, "distance", number(self.distance, "speed zone: approach_distance"))
        if not self.speed > 0.0:
            raise InvalidValue(f"speed zone: approach_speed must be > 0 m/s, got {self.speed}")
        if not (math.isfinite(self.distance) and self.distance >= 0.0):
            raise InvalidValue(f"speed zone: approach_distance must be finite and >= 0 m, got {self.distance}")
