"""Numbers in files: what counts as one, and which are only plausible in another unit: degrees, millimetres, km/h.

Files and options are in SI units, and a yaw of 90 or a footprint of 800 is a slip that no later rule would name. So
such numbers are refused where they enter. Values inside the library may be whatever they are: yaws that went on
turning along a path have no bound.
"""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING, TypeGuard

from optdock.errors import InvalidValue

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint

__all__ = ["MOST_POLYGONS", "check_outline", "check_speed", "check_vertices", "check_yaw", "is_number", "unit_fault"]


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value read from a file is a number that a float can hold; booleans are none, NaN and infinity are.

    >>> is_number(3), is_number(True), is_number(10**400)
    (True, False, False)
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return isinstance(value, float) or abs(value) <= sys.float_info.max


# Cutting a polygon into convex pieces takes a time that grows with its square: 0.1 s for as many vertices as this in
# zigzag, 0.3 ms for a triangle. What is larger is a map, and better given as one.
_MOST_VERTICES = 300
MOST_POLYGONS = 2000  # in a file
MAX_YAW = 2.0 * math.pi  # [rad]
MAX_SPEED = 50.0  # [m/s]; nothing docks at 180 km/h
MAX_OUTLINE = 50.0  # [m] from the origin of the robot or the dock
_ROUNDING = 1e-3  # [rad]: people write a full turn as 6.2832 or 6.284


def unit_fault(value: float, unit: str) -> str:
    """What to ask about a number given in `rad`, `m/s` or `m` (of an outline); empty for a plausible one, or infinity.

    >>> unit_fault(90.0, "rad")
    '90 is beyond 2 pi; degrees? write radians, 1.5708'
    """
    size = abs(value)
    if unit == "rad" and size > MAX_YAW + _ROUNDING:
        return f"{value:g} is beyond 2 pi; degrees? write radians, {math.radians(value):.5g}"
    if unit == "m/s" and MAX_SPEED < size < math.inf:
        return f"{value:g} is beyond {MAX_SPEED:g} m/s; mm/s or km/h? write m/s, {value / 1e3:.5g} or {value / 3.6:.5g}"
    if unit == "m" and size > MAX_OUTLINE:
        return f"{value:g} is beyond {MAX_OUTLINE:g} m; mm or cm? write m, {value / 1e3:.5g} or {value / 1e2:.5g}"
    return ""


def check_yaw(yaw: float) -> None:
    """Refuse a yaw beyond a full turn [rad].

    Raises:
        InvalidValue: It is; the message asks whether it is in degrees.
    """
    _refuse("yaw", yaw, "rad")


def check_speed(speed: float) -> None:
    """Refuse a speed that no robot docks with [m/s]; infinity means that there is no limit.

    Raises:
        InvalidValue: It is beyond 50 m/s; the message asks for the unit.
    """
    _refuse("speed", speed, "m/s")


def check_outline(outline: Footprint) -> None:
    """Refuse an outline that reaches further than any robot or dock.

    Raises:
        InvalidValue: A vertex is more than 50 m from the origin; the message asks for the unit.
    """
    _refuse("a vertex at", outline.circumscribed_radius, "m")


def check_vertices(value: object) -> None:
    """Refuse a list of more vertices than an obstacle or an outline in a file may have.

    Raises:
        InvalidValue: There are more than 300.
    """
    if isinstance(value, list) and len(value) > _MOST_VERTICES:
        raise InvalidValue(f"must have at most {_MOST_VERTICES} vertices, got {len(value)}")


def _refuse(name: str, value: float, unit: str) -> None:
    fault = unit_fault(value, unit)
    if fault:
        raise InvalidValue(f"{name} {fault}")
