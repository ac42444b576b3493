"""The robot: outline, drive and limits."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint
    from optdock.limits import MotionLimits

__all__ = ["Drive", "Robot"]


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
        drive: How it steers.
    """

    footprint: Footprint
    limits: MotionLimits
    drive: Drive = Drive.DIFFERENTIAL
