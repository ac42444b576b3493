"""Checks of numbers in files and options: type, and values that indicate another unit (degrees, millimetres, km/h).

Files and options use SI units; a yaw of 90 or a footprint of 800 is rejected on input. Values inside the library are
not bounded, because the yaw along a path may exceed a full turn.
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
    """Whether a value of a file is a number in the range of float; NaN and infinity are numbers, booleans are not.

    >>> is_number(3), is_number(True), is_number(10**400)
    (True, False, False)
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return isinstance(value, float) or abs(value) <= sys.float_info.max


# Convex decomposition takes quadratic time: 0.1 s for a zigzag of 300 vertices, 0.3 ms for a triangle.
_MOST_VERTICES = 300
MOST_POLYGONS = 2000  # in a file
MAX_YAW = 2.0 * math.pi  # [rad]
MAX_SPEED = 50.0  # [m/s]
MAX_OUTLINE = 50.0  # [m] from the origin of the robot or the dock
_ROUNDING = 1e-3  # [rad]: a full turn may be written as 6.2832 or 6.284


def unit_fault(value: float, unit: str) -> str:
    """Return the reason why a number in `rad`, `m/s` or `m` (of an outline) is implausible, or an empty string.

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
    """Check that a yaw [rad] is within a full turn.

    Raises:
        InvalidValue: If the yaw exceeds a full turn; the message suggests degrees.
    """
    _refuse("yaw", yaw, "rad")


def check_speed(speed: float) -> None:
    """Check that a speed [m/s] is plausible; infinity means unlimited.

    Raises:
        InvalidValue: If the speed exceeds 50 m/s; the message suggests other units.
    """
    _refuse("speed", speed, "m/s")


def check_outline(outline: Footprint) -> None:
    """Check that the size of an outline is plausible.

    Raises:
        InvalidValue: If a vertex is more than 50 m from the origin; the message suggests other units.
    """
    _refuse("a vertex at", outline.circumscribed_radius, "m")


def check_vertices(value: object) -> None:
    """Check the number of vertices of an obstacle or outline.

    Raises:
        InvalidValue: If there are more than 300 vertices.
    """
    if isinstance(value, list) and len(value) > _MOST_VERTICES:
        raise InvalidValue(f"must have at most {_MOST_VERTICES} vertices, got {len(value)}")


def _refuse(name: str, value: float, unit: str) -> None:
    fault = unit_fault(value, unit)
    if fault:
        raise InvalidValue(f"{name} {fault}")
