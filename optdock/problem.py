"""The docking problem: everything a planner, a smoother and the certificate need to know, as one frozen value."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import number
from optdock.obstacles import ObstacleSet

if TYPE_CHECKING:
    from optdock.costmap.costmap import Costmap
    from optdock.dock import Dock
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Pose2
    from optdock.robot import Robot

__all__ = ["ClearanceRule", "DockingProblem"]

# A robot that starts closer to an obstacle than required must leave it at least at this slope.
START_RELIEF_SLOPE = 0.5


@dataclass(frozen=True)
class ClearanceRule:
    """How far the footprint must stay from the nearest obstacle, the dock included.

    Args:
        required: Away from the goal [m].
        at_dock: At the goal [m].
        taper: Distance from the goal over which it grows linearly from `at_dock` to `required` [m].

    Raises:
        InvalidValue: A value is negative or not finite, or at_dock exceeds required.
    """

    required: float = 0.05
    at_dock: float = 0.0
    taper: float = 0.5

    def __post_init__(self) -> None:
        for name in ("required", "at_dock", "taper"):
            value = number(getattr(self, name), f"clearance.{name}")
            object.__setattr__(self, name, value)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidValue(f"clearance.{name}: must be finite and >= 0 m, got {value}")
        if self.at_dock > self.required:
            raise InvalidValue(f"clearance.at_dock: must be <= required = {self.required} m, got {self.at_dock}")

    def required_at(self, from_goal: FloatArray, from_start: FloatArray, start_clearance: float) -> FloatArray:
        """Required clearance, Shape (n,) [m].

        Args:
            from_goal: Distances of the poses from the goal position, Shape (n,) [m].
            from_start: Distances from the start position, Shape (n,) [m].
            start_clearance: Clearance of the start pose itself [m].
        """
        share = np.minimum(1.0, from_goal / self.taper) if self.taper > 0.0 else np.where(from_goal > 0.0, 1.0, 0.0)
        near_goal = self.at_dock + (self.required - self.at_dock) * share
        near_start = max(0.0, start_clearance) + START_RELIEF_SLOPE * from_start
        return np.minimum(near_goal, near_start)


@dataclass(frozen=True, eq=False)
class DockingProblem:
    """From where, to where, with what, among what.

    Args:
        start: Where the robot is.
        dock: Where it must end.
        robot: What drives.
        obstacles: What it must not touch; the dock's own footprint is added to it.
        clearance: How far it must stay away.
        start_speed: Speed at the start, signed, negative in reverse [m/s].
        start_curvature: Curvature at the start along the travel [1/m]; None leaves it free.
        costmap: The grid that the obstacles came from, for planners that read costs; may be None.
        frame: Name of the coordinate frame.

    Attributes:
        all_obstacles: The obstacles and the dock's footprint.

    Raises:
        InvalidValue: start_speed or start_curvature is not finite.
    """

    start: Pose2
    dock: Dock
    robot: Robot
    obstacles: ObstacleSet = field(default_factory=ObstacleSet.empty)
    clearance: ClearanceRule = field(default_factory=ClearanceRule)
    start_speed: float = 0.0
    start_curvature: float | None = None
    costmap: Costmap | None = None
    frame: str = "map"
    all_obstacles: ObstacleSet = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not math.isfinite(self.start_speed):
            raise InvalidValue(f"start.speed: must be finite, got {self.start_speed}")
        if self.start_curvature is not None and not math.isfinite(self.start_curvature):
            raise InvalidValue(f"start.curvature: must be finite, got {self.start_curvature}")
        everything = self.obstacles
        if self.dock.footprint is not None:
            everything = everything + ObstacleSet.from_footprint(self.dock.footprint, self.dock.pose, "dock")
        object.__setattr__(self, "all_obstacles", everything)

    @property
    def goal(self) -> Pose2:
        """The pose of the robot when docked."""
        return self.dock.pose
