"""The dock: goal pose, approach and outline of the station."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import exactly, finite_number, member, non_negative, positive
from optdock.geometry.footprint import Footprint
from optdock.geometry.lazy import cached_property
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.limits import SpeedZone

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

__all__ = ["Dock", "DockDirection", "DockTolerances"]


class DockDirection(str, Enum):
    """Gear in which the robot enters the dock."""

    FORWARD = "forward"
    BACKWARD = "backward"
    AUTO = "auto"


@dataclass(frozen=True)
class DockTolerances:
    """Tolerances of the docked pose, in the dock frame.

    Args:
        along: Accepted |error| along the goal heading [m].
        cross: Accepted |error| across the goal heading [m].
        yaw: Accepted |heading error| [rad].

    Raises:
        InvalidValue: If a tolerance is not finite and > 0.
    """

    along: float = 0.02
    cross: float = 0.02
    yaw: float = 0.05

    def __post_init__(self) -> None:
        for name in ("along", "cross", "yaw"):
            vars(self)[name] = positive(getattr(self, name), f"dock.tolerances.{name}")

    def accept(self, found: Pose2, wanted: Pose2) -> bool:
        """Whether a robot at the pose `found` counts as docked at the pose `wanted`."""
        seen = found.in_frame_of(wanted)
        return abs(seen.x) <= self.along and abs(seen.y) <= self.cross and abs(seen.yaw) <= self.yaw


@dataclass(frozen=True, eq=False)
class Dock:
    """A docking station.

    Args:
        pose: Pose of the docked robot.
        footprint: Outline of the station in the frame of the docked robot, or None. The station is an obstacle.
        direction: Gear of the last motion, a `DockDirection` or its value; with AUTO the planner chooses the gear
            according to the side on which the start lies.
        final_straight: Length of the straight line at the end of the path [m].
        approach_speed: Largest speed [m/s] over the last `approach_distance` of the path, in either gear.
        approach_distance: Length of the speed zone at the end of the path [m]; 0 for no zone.
        tolerances: Tolerances of the docked pose.
        marker: Point that the robot's camera detects, (x, y) in the frame of the docked robot [m], or None. The
            orientation of the marker is not modelled.
        visible_distance: Length of the last part of the path on which the marker must be in the view of `Robot.camera`
            [m]. On a shorter path, the marker must be in view on the whole path; 0 means no requirement.
        blind_distance: Length of the last part of the path on which the marker may be invisible [m].

    Raises:
        InvalidValue: If final_straight or approach_distance is not finite and >= 0, approach_speed is not > 0, the
            direction is unknown, the marker is not a pair of finite numbers, visible_distance is > 0 without a marker,
            blind_distance is not >= 0 or, if > 0, not < visible_distance, or an argument has the wrong class.
    """

    pose: Pose2
    footprint: Footprint | None = None
    direction: DockDirection = DockDirection.AUTO
    final_straight: float = 0.0
    approach_speed: float = math.inf
    approach_distance: float = 0.0
    tolerances: DockTolerances = field(default_factory=DockTolerances)
    marker: tuple[float, float] | None = None
    visible_distance: float = 0.0
    blind_distance: float = 0.0

    def __post_init__(self) -> None:
        exactly(Pose2, self.pose, "dock.pose")
        if self.footprint is not None:
            exactly(Footprint, self.footprint, "dock.footprint")
        zone = self.approach
        vars(self).update(
            direction=member(DockDirection, self.direction, "dock.direction"),
            approach_speed=zone.speed,
            approach_distance=zone.distance,
            marker=None if self.marker is None else _point(self.marker, "dock.marker"),
        )
        exactly(DockTolerances, self.tolerances, "dock.tolerances")
        for name in ("final_straight", "visible_distance", "blind_distance"):
            vars(self)[name] = non_negative(getattr(self, name), f"dock.{name}", "m")
        if self.visible_distance > 0.0 and self.marker is None:
            raise InvalidValue(f"dock.visible_distance: needs dock.marker, got {self.visible_distance} m without")
        if self.blind_distance > 0.0 and not self.blind_distance < self.visible_distance:
            raise InvalidValue(
                f"dock.blind_distance: must be < visible_distance = {self.visible_distance} m, "
                f"got {self.blind_distance}"
            )

    @property
    def marker_in_world(self) -> FloatArray | None:
        """Position of the marker in the world, Shape (2,) [m]; None without a marker."""
        if self.marker is None:
            return None
        found: FloatArray = transform_points(self.pose.as_array()[None], np.array([self.marker]))[0, 0]
        return found

    @cached_property
    def approach(self) -> SpeedZone:
        """The speed zone at the end of the path."""
        return SpeedZone(self.approach_speed, self.approach_distance)


def _point(value: object, name: str) -> tuple[float, float]:
    """Return a point (x, y) [m] after checking that both numbers are finite and in the range of coordinates."""
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray) or len(value) != 2:
        raise InvalidValue(f"{name}: must be [x, y] in m, got {value!r}")
    place = Pose2(finite_number(value[0], name), finite_number(value[1], name), 0.0)  # checks the range
    return place.x, place.y
