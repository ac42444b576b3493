"""About how long a gear takes: decides which method is worth its work, and which motion is none."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from optdock.timing.course import Course

__all__ = ["LONGEST", "expected_duration"]

LONGEST = 3600.0  # [s]: a docking motion that takes longer is refused; memory and time grow with it


def expected_duration(course: Course) -> float:
    """Driving at the speed caps throughout, or from rest to rest under acceleration or jerk alone: the longest [s].

    The caps include that of the yaw acceleration at constant speed. Never more than a fraction above the true duration.
    """
    limits = course.limits
    rate = np.maximum(np.abs(course.rate_left), np.abs(course.rate_right))
    slowness = np.maximum(course.cell_slowness, np.sqrt(rate / limits.max_yaw_acceleration))
    at_caps = float(np.sum(np.diff(course.s) * slowness))
    by_drive = math.sqrt(2.0 * course.length * (1.0 / limits.max_acceleration + 1.0 / limits.max_deceleration))
    by_jerk = math.exp(math.log(32.0 * course.length / limits.max_jerk) / 3.0)
    return max(at_caps, by_drive, by_jerk)
