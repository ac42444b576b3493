"""The dock: where the robot must end, how it gets in, and what stands there."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import exactly, finite_number, member, number
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.limits import SpeedZone

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

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
            value = number(getattr(self, name), f"dock.tolerances.{name}")
            object.__setattr__(self, name, value)
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidValue(f"dock.tolerances.{name}: must be finite and > 0, got {value}")

    def accept(self, found: Pose2, wanted: Pose2) -> bool:
        """Whether a robot at one pose counts as docked at another."""
        seen = found.in_frame_of(wanted)
        return abs(seen.x) <= self.along and abs(seen.y) <= self.cross and abs(seen.yaw) <= self.yaw


@dataclass(frozen=True, eq=False)
class Dock:
    """A docking station.

    Args:
        pose: The pose of the robot when docked.
        footprint: Outline of the station in the docked robot's frame, or None; it is an obstacle.
        direction: Gear of the last motion, a `DockDirection` or its word; AUTO lets the planner choose by the side of
            the start.
        final_straight: Length of the straight run at the end [m].
        approach_speed: Largest speed over the last `approach_distance` of the path, in either gear [m/s].
        approach_distance: How far before the end that begins [m]; 0: nowhere.
        tolerances: When the robot counts as docked.
        marker: The point that the robot's camera detects, (x, y) in the docked robot's frame, as the footprint [m]; or
            None. Only its position counts, not which way it faces.
        visible_distance: The marker must be in the view of `Robot.camera` from so far before the end of the path on,
            along the path [m]; 0: nowhere. A shorter path must see it from its start on.
        blind_distance: But not over the last so many metres of the path [m], where the camera is too near to see the
            marker, or the robot has turned its back to it.

    Raises:
        InvalidValue: final_straight or approach_distance is not finite and >= 0, approach_speed is not > 0, the
            direction is none, the marker is not a pair of finite numbers, visible_distance is > 0 without a marker,
            blind_distance is not >= 0 and, where there is one, < visible_distance; or a part is of another class.
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
        object.__setattr__(self, "direction", member(DockDirection, self.direction, "dock.direction"))
        object.__setattr__(self, "approach_speed", self.approach.speed)
        object.__setattr__(self, "approach_distance", self.approach.distance)
        exactly(DockTolerances, self.tolerances, "dock.tolerances")
        object.__setattr__(self, "final_straight", finite_number(self.final_straight, "dock.final_straight"))
        if not self.final_straight >= 0.0:
            raise InvalidValue(f"dock.final_straight: must be finite and >= 0 m, got {self.final_straight}")
        if self.marker is not None:
            object.__setattr__(self, "marker", _point(self.marker, "dock.marker"))
        self._check_view()

    @property
    def marker_in_world(self) -> FloatArray | None:
        """The marker where the dock stands, Shape (2,) [m]; None without one."""
        if self.marker is None:
            return None
        found: FloatArray = transform_points(self.pose.as_array()[None], np.array([self.marker]))[0, 0]
        return found

    def _check_view(self) -> None:
        for name in ("visible_distance", "blind_distance"):
            value = finite_number(getattr(self, name), f"dock.{name}")
            object.__setattr__(self, name, value)
            if not value >= 0.0:
                raise InvalidValue(f"dock.{name}: must be finite and >= 0 m, got {value}")
        if self.visible_distance > 0.0 and self.marker is None:
            raise InvalidValue(f"dock.visible_distance: needs dock.marker, got {self.visible_distance} m without")
        if self.blind_distance > 0.0 and not self.blind_distance < self.visible_distance:
            raise InvalidValue(
                f"dock.blind_distance: must be < visible_distance = {self.visible_distance} m, "
                f"got {self.blind_distance}"
            )

    @functools.cached_property
    def approach(self) -> SpeedZone:
        """The slow stretch at the end of the path."""
        return SpeedZone(self.approach_speed, self.approach_distance)

    @property
    def without_view(self) -> Dock:
        """The same dock, which need not be seen on the way."""
        return dataclasses.replace(self, visible_distance=0.0, blind_distance=0.0)


def _point(value: object, name: str) -> tuple[float, float]:
    """A point (x, y) of finite numbers [m].

    Raises:
        InvalidValue: It is none.
    """
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray) or len(value) != 2:
        raise InvalidValue(f"{name}: must be [x, y] in m, got {value!r}")
    place = Pose2(finite_number(value[0], name), finite_number(value[1], name), 0.0)  # with the range of coordinates
    return place.x, place.y
