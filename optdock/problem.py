"""The docking problem: everything a planner, a smoother and the certificate need to know, as one frozen value."""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optdock.costmap.cell_obstacles import mapped_obstacles
from optdock.costmap.costmap import Costmap
from optdock.dock import Dock
from optdock.errors import InvalidValue
from optdock.fingerprint import ProblemFingerprint, digest
from optdock.geometry.arrays import FrozenArrays
from optdock.geometry.checked import finite_number, instance, number
from optdock.geometry.pose import Pose2
from optdock.obstacles import ObstacleSet
from optdock.robot import Robot

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray

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
class DockingProblem(FrozenArrays):
    """From where, to where, with what, among what.

    What the robot must not touch is everything that is given: the obstacles, the occupied and unknown cells of the
    costmap and the world beyond its edge, and the station. None of them replaces another.

    Args:
        start: Where the robot is.
        dock: Where it must end; its station is an obstacle.
        robot: What drives.
        obstacles: What it must not touch.
        clearance: How far it must stay away.
        start_speed: Speed at the start, signed, negative in reverse [m/s].
        start_curvature: Curvature at the start along the travel [1/m]; None leaves it free.
        costmap: What is known of the surroundings as a grid; None where only obstacles are. Read when the problem is
            made, a grid that layers write into is copied.
        frame: Name of the coordinate frame.
        unknown_is_obstacle: Whether the cells of the costmap that nobody has seen are obstacles.

    Attributes:
        all_obstacles: The obstacles, the cells of the costmap, and the station last.

    Raises:
        InvalidValue: start_speed or start_curvature is not finite, or a part is of another class.
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
    unknown_is_obstacle: bool = True
    all_obstacles: ObstacleSet = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._check_parts()
        everything = self.obstacles
        if self.costmap is not None:
            # A grid that can be written could change under the proof.
            known = self.costmap.frozen() if self.costmap.data.flags.writeable else self.costmap
            object.__setattr__(self, "costmap", known)
            mapped = mapped_obstacles(known, unknown_is_obstacle=self.unknown_is_obstacle)
            everything = (everything + mapped).distinct() if len(everything) else mapped
        if self.dock.footprint is not None:
            everything = everything + ObstacleSet.from_footprint(self.dock.footprint, self.dock.pose, "dock")
        object.__setattr__(self, "all_obstacles", everything)

    def _check_parts(self) -> None:
        parts = (
            (Pose2, "start"),
            (Dock, "dock"),
            (Robot, "robot"),
            (ObstacleSet, "obstacles"),
            (ClearanceRule, "clearance"),
            (str, "frame"),
            (bool, "unknown_is_obstacle"),
        )
        for kind, name in parts:
            instance(kind, getattr(self, name), f"problem.{name}")
        if self.costmap is not None:
            instance(Costmap, self.costmap, "problem.costmap")
        object.__setattr__(self, "start_speed", finite_number(self.start_speed, "start.speed"))
        if self.start_curvature is not None:
            object.__setattr__(self, "start_curvature", finite_number(self.start_curvature, "start.curvature"))

    @property
    def goal(self) -> Pose2:
        """The pose of the robot when docked."""
        return self.dock.pose

    def among(self, costmap: Costmap) -> DockingProblem:
        """The same problem with a costmap's cells among its obstacles, beside whatever it knows already."""
        if costmap is self.costmap:
            return self
        if self.costmap is None:
            return dataclasses.replace(self, costmap=costmap)
        more = mapped_obstacles(costmap.frozen(), unknown_is_obstacle=self.unknown_is_obstacle)
        return dataclasses.replace(self, obstacles=self.obstacles + more)

    @functools.cached_property
    def fingerprint(self) -> ProblemFingerprint:
        """Digests of what a certificate for this problem is proven against."""
        dock, rule = self.dock, self.clearance
        station = digest("none") if dock.footprint is None else digest(dock.footprint.vertices)
        steered = "free" if self.start_curvature is None else str(float(self.start_curvature))
        zone, accepted = dock.approach, dock.tolerances
        return ProblemFingerprint(
            *self.robot.fingerprint,
            obstacles=self.all_obstacles.digest,
            clearance=digest(dataclasses.astuple(rule)),
            dock=digest(
                dock.pose.as_array(),
                station,
                dock.direction.value,
                (dock.final_straight, zone.speed, zone.distance, accepted.along, accepted.cross, accepted.yaw),
            ),
            start=digest(self.start.as_array(), self.start_speed, steered),
            frame=self.frame,
        )
