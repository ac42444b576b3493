"""The dock: where the robot must end, how it gets in, and what stands there."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

from optdock.errors import InvalidValue
from optdock.limits import SpeedZone

if TYPE_CHECKING:
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2

__all__ = ["Dock", "DockDirection", "DockTolerances"]


class DockDirection(str, Enum):
    """The gear of the last motion into the dock."""

    FORWARD = "forward"
    BACKWARD = "backward"
    AUTO = "auto"


@dataclass(frozen=True)
class DockTolerances:
    """When the robot counts as docked, in the dock's frame.

    Args:
        along: Accepted |error| along the goal heading [m].
        cross: Accepted |error| across it [m].
        yaw: Accepted |heading error| [rad].

    Raises:
        InvalidValue: A tolerance is not finite and > 0.
    """

    along: float = 0.02
    cross: float = 0.02
    yaw: float = 0.05

    def __post_init__(self) -> None:
        for name in ("along", "cross", "yaw"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidValue(f"dock.tolerances.{name}: must be finite and > 0, got {value}")


@dataclass(frozen=True, eq=False)
class Dock:
    """A docking station.

    Args:
        pose: The pose of the robot when docked.
        footprint: Outline of the station in the docked robot's frame, or None; it is an obstacle.
        direction: Gear of the last motion; AUTO lets the planner choose by the side of the start.
        final_straight: Length of the straight run at the end [m].
        approach: Slow stretch at the end of the path.
        tolerances: When the robot counts as docked.

    Raises:
        InvalidValue: final_straight is not finite and >= 0.
    """

    pose: Pose2
    footprint: Footprint | None = None
    direction: DockDirection = DockDirection.AUTO
    final_straight: float = 0.0
    approach: SpeedZone = field(default_factory=SpeedZone)
    tolerances: DockTolerances = field(default_factory=DockTolerances)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.final_straight) and self.final_straight >= 0.0):
            raise InvalidValue(f"dock.final_straight: must be finite and >= 0 m, got {self.final_straight}")
