"""What the robot's drive can do."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from optdock.errors import InvalidValue
from optdock.geometry.checked import number

__all__ = ["LIMIT_UNITS", "MotionLimits", "SpeedZone"]


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
        track_width: Distance between the wheels [m]; used with max_wheel_speed only.
        max_curvature: 1 / smallest turning radius [1/m].
        max_curvature_rate: |d curvature / ds| [1/m^2].

    Raises:
        InvalidValue: A bound is not > 0, NaN, or speeds, accelerations or jerk are infinite.
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

    def __post_init__(self) -> None:
        for spec in fields(self):
            value = number(getattr(self, spec.name), f"limits.{spec.name}")
            object.__setattr__(self, spec.name, value)
            rule, holds = _rule(spec.name, value)
            if not holds:
                raise InvalidValue(f"limits.{spec.name}: must be {rule}, got {value}")


LIMIT_UNITS = {
    "max_speed": "m/s",
    "max_reverse_speed": "m/s",
    "max_acceleration": "m/s^2",
    "max_deceleration": "m/s^2",
    "max_jerk": "m/s^3",
    "max_yaw_rate": "rad/s",
    "max_yaw_acceleration": "rad/s^2",
    "max_lateral_acceleration": "m/s^2",
    "max_wheel_speed": "m/s",
    "max_curvature": "1/m",
    "max_curvature_rate": "1/m^2",
}
_FINITE = ("max_speed", "max_reverse_speed", "max_acceleration", "max_deceleration", "max_jerk")


def _rule(name: str, value: float) -> tuple[str, bool]:
    if name == "track_width":
        return "finite and >= 0 m", math.isfinite(value) and value >= 0.0
    if name in _FINITE:
        finite = math.isfinite(value)
        return f"{'' if finite else 'finite and '}> 0 {LIMIT_UNITS[name]}", finite and value > 0.0
    return f"> 0 {LIMIT_UNITS[name]}", value > 0.0


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
